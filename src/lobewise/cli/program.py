"""Runs the verb of a command line, and turns its failures into one sentence and an exit code."""

from __future__ import annotations

import errno
import io
import os
import sys
import traceback
import warnings
from contextlib import suppress
from copy import copy
from importlib import import_module

import typer
from typer.models import CommandInfo

import lobewise
from lobewise.cli.terminal.interrupts import EXIT_INTERRUPTED, INTERRUPTED, interrupts
from lobewise.cli.terminal.lines import choose_progress, write_line, writes_lines
from lobewise.errors import LobewiseError, make_printable

EXIT_OK, EXIT_INTERNAL_ERROR = 0, 1
_show_warning_by_default = warnings.showwarning
COMPLETION_VARIABLE = "_LOBEWISE_COMPLETE"
"""Set by the shell that asks how a command line may go on (`lobewise --install-completion`)."""
MODULES = {
    "render": "rendering",
    "view": "viewing",
    **dict.fromkeys(("denoise", "upsample"), "filtering"),
    "fit": "fitting",
    "compare": "comparing",
    "doctor": "diagnosing",
    **dict.fromkeys(("demo", "inspect", "devices"), "commands"),
}
"""Modules of the verbs."""
SYSTEM_REFUSALS = (errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN)
"""Errors by which the system says that a limit of this process is reached: memory, open files, threads."""
BUG_REPORT_URL = "https://github.com/lobewise/lobewise/issues"


def run(arguments: list[str]) -> int:
    """Run the program and return its exit code."""
    from lobewise.cli.terminal.help import EXIT_USER_ERROR, asks_for_all
    from lobewise.cli.terminal.mistakes import describe_mistake, name_option

    for stream in (sys.stdout, sys.stderr):
        # File names may hold bytes, and messages letters, that the terminal's encoding lacks.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # Accept --debug anywhere: users append it to the command line that has just failed.
    end = arguments.index("--") if "--" in arguments else len(arguments)
    debug = "--debug" in arguments[:end]
    arguments = [word for place, word in enumerate(arguments) if word != "--debug" or place >= end]
    if "--moving-objects" in arguments:
        from lobewise.cli.rendering import give_switches_values

        arguments = give_switches_values(arguments)
    command = typer.main.get_command(_open_app(arguments))
    if COMPLETION_VARIABLE in os.environ:
        command.main(prog_name="lobewise", complete_var=COMPLETION_VARIABLE)  # prints words for the shell, and exits
    warnings.showwarning = _show_warning
    choose_progress("auto")
    try:
        # Typer's own `main` handles exit codes, interrupts and closed pipes differently.
        with command.make_context("lobewise", arguments or ["--help"], obj=asks_for_all(arguments[:end])) as context:
            command.invoke(context)
        if sys.stdout is not None:
            sys.stdout.flush()
        return EXIT_OK
    except typer.Exit as leave:
        return int(leave.exit_code)
    except LobewiseError as problem:
        return _fail(name_option(problem, arguments), EXIT_USER_ERROR, debug)
    except BrokenPipeError:
        # The reader closed the pipe. Python flushes stdout again at exit: give it an open file.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except (KeyboardInterrupt, typer.Abort):
        return _fail(INTERRUPTED, EXIT_INTERRUPTED, debug)
    except Exception as problem:
        if interrupts:
            return _fail(INTERRUPTED, EXIT_INTERRUPTED, debug)
        if hasattr(problem, "format_message"):
            return _fail(describe_mistake(problem, arguments), EXIT_USER_ERROR, debug)
        if isinstance(problem, MemoryError) or getattr(problem, "errno", None) in SYSTEM_REFUSALS:
            return _fail(_describe_refusal(problem), EXIT_USER_ERROR, debug)
        what = " ".join(f"{type(problem).__name__}: {problem}".split())[:300]
        text = f"something went wrong inside lobewise {lobewise.__version__} ({what})"
        action = f"run it again with --debug and report what it says at {BUG_REPORT_URL}"
        return _fail(LobewiseError(text, action=action), EXIT_INTERNAL_ERROR, debug)


def _open_app(arguments: list[str]) -> typer.Typer:
    """Return the program with the one verb that a command line begins with; without one the whole program.

    To import all verbs, and to make their options, takes longer than to read a command line. One that only lists the
    verbs needs no options of theirs.
    """
    from lobewise.cli.terminal.help import EXAMPLES, make_app

    verb = arguments[0] if arguments else ""
    if verb in MODULES:
        kept = make_app()
        kept.command(epilog=EXAMPLES.get(verb))(getattr(import_module(f"lobewise.cli.{MODULES[verb]}"), verb))
        return kept
    from lobewise.cli.commands import app

    if len(arguments) < 2 and COMPLETION_VARIABLE not in os.environ:
        app = copy(app)
        app.registered_commands = [_strip(one) for one in app.registered_commands]
    return app


def _strip(verb: CommandInfo) -> CommandInfo:
    """Return a verb without options, which can be listed."""
    listed, run = copy(verb), verb.callback
    if run is not None:
        listed.name, listed.help, listed.callback = run.__name__, run.__doc__, lambda: None
    return listed


def _describe_refusal(problem: Exception) -> LobewiseError:
    reason = getattr(problem, "strerror", None)
    return LobewiseError(
        "system",
        expected="memory, files and threads to work with",
        got=reason.lower() if reason else "not enough memory",
        action="free some, or raise the limits of this process (ulimit -a)",
    )


def _show_warning(message: Warning | str, category: type[Warning], *rest: object, **more: object) -> None:
    """Print a warning of this package like a remark; show all other warnings as Python does."""
    if category.__module__.startswith("lobewise."):
        _write_line(str(message))
    else:
        _show_warning_by_default(message, category, *rest, **more)  # type: ignore[arg-type]


def _fail(problem: LobewiseError | str, code: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    _write_line(str(problem), "error")
    return code


def _write_line(text: str, kind: str = "note") -> None:
    if writes_lines():
        write_line(**{kind: make_printable(text)})
    # A process can be started without standard error.
    elif sys.stderr is not None:
        with suppress(OSError):
            sys.stderr.write(f"lobewise: {make_printable(text)}\n")
