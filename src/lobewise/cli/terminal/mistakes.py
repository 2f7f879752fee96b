"""Errors of a command line: what the parser finds, and options that are named as settings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from lobewise.cli.terminal.help import get_metavar
from lobewise.errors import LobewiseError, choose_nearest, name_value

STAND_FOR = {
    "--half": "input",
    "--reference": "input",
    "--guides": "input",
    "--html": "output",
    "--json": "output",
    "--material": "lobe file",
    "--ocio": "file",
}
"""What errors call the files of options, where it is not the name of the option."""
SHORT = {"-o": "--output", "-r": "--reference", "-D": "--define"}
"""Short names of options whose values can be wrong."""


def name_option(problem: LobewiseError, arguments: Sequence[str]) -> LobewiseError:
    """Return an error that names an option where it named the setting of the option, or the file that is its value.

    Examples
    --------
    >>> name_option(LobewiseError("screen_sigma", expected="..."), ["--screen-sigma", "0"]).what
    '--screen-sigma'
    >>> name_option(LobewiseError("output 'a/b.json'", expected="..."), ["--json=a/b.json"]).what
    "--json 'a/b.json'"
    """
    field = "holder" if problem.holder else "what"
    named = problem.fields[field]
    for option, value in _list_options(arguments):
        setting = option[2:].replace("-", "_")
        file = STAND_FOR.get(option, setting.replace("_", " "))
        if named == setting:
            return problem.change(**{field: option})
        if named == f"{file} {value!r}":
            return problem.change(**{field: f"{option} {value!r}"})
    return problem


def _list_options(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the options of a command line, by their long names, and the words that may be their values."""
    for word, following in zip(arguments, [*arguments[1:], ""], strict=True):
        name, equals, behind = word.partition("=")
        if name in SHORT or name.startswith("--"):
            yield SHORT.get(name, name), behind if equals else following


def describe_mistake(problem: Any, arguments: Sequence[str]) -> LobewiseError:
    """Return the error for an error of the parser. The classes of its errors depend on typer's version.

    ``arguments`` are the words of the command line.
    """
    context, text = problem.ctx, problem.format_message().rstrip(".")
    if context is None:
        if not hasattr(problem, "option_name"):
            return LobewiseError(text, action="see lobewise --help")
        expected = "a value behind it" if "requires" in text else "no value behind it"
        verb = next((word for word in arguments if not word.startswith("-")), "")
        action = f"see lobewise {verb} --help"
        name = problem.option_name
        return LobewiseError(name, expected=expected, got=_look_up_value([name], arguments), action=action)
    path, command = context.command_path, context.command
    see = f"see {path} --help"
    surplus = re.search(r"extra arguments? \((.*)\)|extra argument\(s\) \((.*)\)", text)
    if hasattr(problem, "possibilities"):
        return _describe_unknown(problem.option_name, command, path)
    if type(problem).__name__ == "MissingParameter":
        metavar, name = get_metavar(problem.param), max(problem.param.opts, key=len)
        if problem.param.param_type_name == "argument":
            return LobewiseError(path, expected=f"{metavar} behind it", got="none", action=see)
        return LobewiseError(name, expected=metavar, got="none", action=f"add {name} {metavar}, or {see}")
    if getattr(problem, "param", None) is not None:
        name, got = max(problem.param.opts, key=len), _look_up_value(problem.param.opts, arguments)
        return LobewiseError(name, expected=_say_range(text), got=got, action=see)
    if surplus:
        wanted = [get_metavar(one) for one in command.params if one.param_type_name == "argument"]
        expected = f"only {' and '.join(wanted)}" if wanted else "only options"
        return LobewiseError(path, expected=expected, got=f"{surplus[1] or surplus[2]!r} as well", action=see)
    if verbs := getattr(command, "commands", None):
        return LobewiseError(path, expected=f"one of {', '.join(verbs)}", got="none", action=see)
    return LobewiseError(text, action=see)


def _describe_unknown(name: str, command: Any, path: str) -> LobewiseError:
    options = [each for one in command.params for each in (*one.opts, *one.secondary_opts) if each.startswith("-")]
    near = choose_nearest(name, options)
    if hasattr(command, "commands") and not near:
        action = "write it behind a verb"
    else:
        action = f"did you mean {near}?" if near else f"see {path} --help-all"
    return LobewiseError(name, expected=f"an option of {path}", got="none of that name", action=action)


def _look_up_value(names: Sequence[str], arguments: Sequence[str]) -> str:
    """Return the value that the command line gives an option, as a message shows it; "none" where it gives none."""
    value = [value for option, value in _list_options(arguments) if option in [SHORT.get(one, one) for one in names]]
    return name_value(value[-1]) if value and value[-1] else "none"


def _say_range(text: str) -> str:
    """Return what the parser expected for a value, from its message."""
    if "integer" in text:
        return "a whole number"
    bound = re.search(r"((?:less|greater) than .*|in the range .*)", text)
    return f"a number {bound[0]}" if bound else "a number"
