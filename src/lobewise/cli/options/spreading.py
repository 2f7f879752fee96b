"""Decorators that make the options of a verb from settings of the library and from dataclasses."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache, wraps
from typing import Annotated, Any, get_type_hints

import typer

from lobewise.settings import Knob, list_knobs

Verb = Callable[..., None]


def with_groups(verb: Verb) -> Verb:
    """Give a verb one option for each field of its parameters that are dataclasses.

    The fields are annotated as parameters of a verb are. The verb is called with an instance of each dataclass.
    """
    parameters = inspect.signature(verb, eval_str=True).parameters.values()
    groups = {one.name: one.annotation for one in parameters if _is_group(one.annotation)}

    def gather(values: dict[str, Any]) -> dict[str, Any]:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        return values

    return _replace_parameters(verb, {name: _list_fields(group) for name, group in groups.items()}, gather)


def with_settings(
    declared: type | Mapping[str, Knob],
    *names: str,
    only_given: bool = False,
    group: str | None = None,
    usual: Collection[str] = (),
    **defaults: Any,
) -> Callable[[Verb], Verb]:
    """Give a verb options for settings, in place of its parameter ``settings``, a dict of their values.

    Parameters
    ----------
    declared : class of settings, or mapping
        The class that declares the settings, or declarations by name.
    *names : str
        The settings that become options.
    only_given : bool
        Whether the dict holds only the settings that the user gives. The class of settings checks the values.
    group : str, optional
        Title of the options in the help, one of `lobewise.cli.terminal.help`.
    usual : collection of str
        Settings that stand under the title "Options" instead.
    **defaults
        Defaults of this verb that differ from the declaration. With ``only_given`` the help shows them, and they change
        nothing else.
    """
    knobs = declared if isinstance(declared, Mapping) else list_knobs(declared)
    chosen = {name: knobs[name] for name in names}
    options = [
        _make_option(
            knob, defaults.get(name, knob.default), optional=only_given, group=None if name in usual else group
        )
        for name, knob in chosen.items()
    ]

    def gather(values: dict[str, Any]) -> dict[str, Any]:
        settings = {name: _read(knob, values.pop(name), only_given) for name, knob in chosen.items()}
        return {**values, "settings": {name: value for name, value in settings.items() if value is not None}}

    return lambda verb: _replace_parameters(verb, {"settings": options}, gather)


def _replace_parameters(
    verb: Verb, options: Mapping[str, Sequence[inspect.Parameter]], gather: Callable[[dict[str, Any]], dict[str, Any]]
) -> Verb:
    """Return a verb whose parameters named in ``options`` are replaced by these options.

    ``gather`` turns the values of the options into the parameters of the original verb.
    """
    signature = inspect.signature(verb, eval_str=True)
    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        parameters += options.get(parameter.name, [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)])

    @wraps(verb)
    def run(**values: Any) -> None:
        verb(**gather(values))

    # Typer reads the options from the signature.
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def _is_group(kind: Any) -> bool:
    return is_dataclass(kind)


@cache
def _list_fields(group: type) -> list[inspect.Parameter]:
    kinds = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=kinds[field.name]
        )
        for field in fields(group)
    ]


def _make_option(knob: Knob, default: Any, *, optional: bool, group: str | None) -> inspect.Parameter:
    """Return the option of a setting. Its value is None where the user gives none."""
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
    option = typer.Option(
        *declared,
        metavar=_show_values(knob),
        help=text,
        show_default=shown,
        rich_help_panel=group,
        autocompletion=complete_from(knob.choices) if knob.choices else None,
    )
    return inspect.Parameter(
        knob.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option]
    )


def complete_from(choices: Sequence[str]) -> Callable[[str], list[str]]:
    """Return a function that lists the values that an unfinished word can become, for the completion of shells."""

    def list_beginning(incomplete: str) -> list[str]:
        return [each for each in choices if each.startswith(incomplete)]

    return list_beginning


def _show_values(knob: Knob) -> str | None:
    """Return the metavar of an option, the word for its value in the help; None for a switch."""
    if knob.kind is bool:
        return None
    if knob.kind is str:
        return "|".join(knob.choices) or "auto|NAME"
    if knob.high - knob.low < 10:
        return f"{knob.low:g}-{knob.high:g}"
    return "|".join([*knob.choices, "N" if knob.kind is int else "X"])


def _read(knob: Knob, value: Any, only_given: bool) -> Any:
    """Return a setting from its word on the command line."""
    if value is None:
        return None if only_given else knob.default
    if knob.kind is float:
        # The class of settings refuses a word that is no number, with a message that lists the values.
        with suppress(ValueError):
            return float(value)
    return value
