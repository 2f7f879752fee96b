"""Options of the verbs that are settings, made from their declarations."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import wraps
from typing import Annotated, Any

import typer

from lobewise.settings import Knob, list_knobs


def with_settings(
    declared: type | Mapping[str, Knob],
    *names: str,
    only_given: bool = False,
    group: str | None = None,
    usual: Collection[str] = (),
    **defaults: Any,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a verb options for settings, in place of its parameter ``settings``, a dict of their values.

    Parameters
    ----------
    declared : class of settings, or mapping
        Where they are declared, or declarations by name.
    *names : str
        Which of its fields.
    only_given : bool
        Whether the dict holds only what the user gives; else all of them. What it holds is checked by its class.
    group : str, optional
        The title that stands over them in the help, one of `lobewise.cli.terminal.help`.
    usual : collection of str
        Those that stand among the verb's usual options instead.
    **defaults
        Of this verb, where they are others than the declaration's; of what is not given, what the help says.
    """
    knobs = declared if isinstance(declared, Mapping) else list_knobs(declared)
    chosen = {name: knobs[name] for name in names}

    def decorate(verb: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(verb, eval_str=True)
        options = [
            _make_option(
                knob,
                defaults.get(name, knob.default),
                optional=only_given,
                group=None if name in usual else group,
            )
            for name, knob in chosen.items()
        ]
        parameters: list[inspect.Parameter] = []
        for parameter in signature.parameters.values():
            named = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
            parameters += options if parameter.name == "settings" else [named]

        @wraps(verb)
        def run(**values: Any) -> None:
            settings = {name: _read(knob, values.pop(name), only_given) for name, knob in chosen.items()}
            verb(**values, settings={name: value for name, value in settings.items() if value is not None})

        # What typer reads a command line from.
        run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return run

    return decorate


def _make_option(knob: Knob, default: Any, *, optional: bool, group: str | None) -> inspect.Parameter:
    """Return the parameter of a verb that stands for a setting; None is what nobody gave."""
    dashed = f"--{knob.name.replace('_', '-')}"
    declared: list[str] = []
    shown: Any = True
    kind: Any = knob.kind
    if kind is bool:
        if optional or knob.choices:
            opposite = f"--{knob.opposite}" if knob.opposite else f"--no-{dashed[2:]}"
            declared, kind = [f"{dashed}/{opposite}"], bool | None
            words = (opposite[2:], dashed[2:]) if optional else (default, default)
            shown, default = words[bool(default)], None
        else:
            declared = [dashed]
    elif knob.choices:
        kind = str
    if optional and knob.kind is not bool:
        shown, default, kind = str(default), None, kind | None
    text = knob.text.replace("`", "")
    option = typer.Option(*declared, metavar=_show_values(knob), help=text, show_default=shown, rich_help_panel=group)
    return inspect.Parameter(
        knob.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option]
    )


def _show_values(knob: Knob) -> str | None:
    """Return what stands in the help for a value."""
    if knob.kind is bool:
        return None
    if knob.kind is str:
        return "|".join(knob.choices) or "auto|NAME"
    if knob.high - knob.low < 10:
        return f"{knob.low:g}-{knob.high:g}"
    return "|".join([*knob.choices, "N" if knob.kind is int else "X"])


def _read(knob: Knob, value: Any, only_given: bool) -> Any:
    """Return a setting from what the command line gave."""
    if value is None:
        return None if only_given else knob.default
    if knob.kind is float:
        # What is no number is refused with the other values that the setting does not take.
        with suppress(ValueError):
            return float(value)
    return value
