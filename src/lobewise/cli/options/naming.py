"""Which file each input is written to: the name of one file, a folder, standard output, or a name of our own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Annotated

import typer

from lobewise.cli.options.writing import list_files
from lobewise.cli.terminal.help import file_detail
from lobewise.errors import InputError, LobewiseError

STREAM = "-"
"""Stands for standard input and output."""

Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="INPUT.exr...",
        help="EXR files, a folder, in.####.exr, or - to read.",
        show_default=False,
    ),
]
Target = Annotated[
    str | None,
    typer.Option(
        "--output",
        "-o",
        metavar="FILE",
        help="A file or folder; INPUT_clean.exr if left out.",
        show_default=False,
    ),
]
Tev = Annotated[bool, file_detail("--tev", help="Show results and inputs in tev.")]


def name_clean(source: Path) -> Path:
    """Return the name beside an input that its result gets by default: ``a_clean.exr``, ``shot_clean.####.exr``."""
    from lobewise.io.sequence import FramePattern, is_pattern

    if not is_pattern(source):
        return source.with_name(f"{source.stem}_clean{source.suffix}")
    pattern = FramePattern.parse(source)
    before = pattern.before.rstrip("._- ")
    start = f"{before}_clean{pattern.before[len(before) :]}" if before else "clean."
    return source.with_name(start + source.name[len(pattern.before) :])


def pair_files(sources: Sequence[str], target: str | None) -> list[tuple[Path, Path]]:
    """Return the inputs, files of folders one by one, each with its output.

    Raises InputError if a folder holds no EXR file, several inputs have one output file, or two have one name.
    """
    from lobewise.io.files import make_folder, require_file_name

    paths = [path for source in sources for path in _list_inputs(Path(source))]
    folders = [Path(source) for source in sources if os.path.isdir(source)]
    if target is None:
        # Results among their inputs would be denoised by the next run.
        by_folder = {folder: folder.with_name(f"{folder.resolve().name}_clean") for folder in folders}
        for folder in by_folder.values():
            make_folder(folder)
        return [
            (path, by_folder[path.parent] / path.name if path.parent in by_folder else name_clean(path))
            for path in paths
        ]
    is_folder = os.path.isdir(target) or target.endswith((os.sep, os.altsep or os.sep))
    if len(paths) == 1 and not folders and not is_folder:
        return [(paths[0], require_file_name(target))]
    if not is_folder and Path(target).suffix.lower() == ".exr":
        raise InputError(
            "--output",
            expected=f"a folder for the {len(paths)} inputs",
            got=f"the file {target!r}",
            action="name a folder",
        )
    names = [path.name for path in paths]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        got = f"two of the name {twice!r}"
        raise InputError("inputs", expected="names that differ, in one folder", got=got, action="give them one by one")
    folder = make_folder(target)
    return [(path, folder / path.name) for path in paths]


def _list_inputs(source: Path) -> list[Path]:
    # `Path.is_dir` would raise an error for a name that is too long.
    if not os.path.isdir(source):
        return [source]
    found = sorted(path for path in source.iterdir() if path.suffix.lower() == ".exr" and path.is_file())
    if not found:
        raise InputError(f"input {str(source)!r}", expected="EXR files in the folder", got="none", action="name files")
    return found


def run_each(pairs: Sequence[tuple[Path, Path]], run: Callable[[Path, Path], None]) -> None:
    """Run a verb on every pair of input and output.

    Of several inputs one that fails does not stop the others. Raises LobewiseError at the end if any failed.
    """
    from lobewise.cli.output import print_note

    if len(pairs) == 1:
        return run(*pairs[0])
    failed = []
    for source, output in pairs:
        try:
            run(source, output)
        except LobewiseError as problem:
            failed.append(source)
            print_note(f"{source}: {problem}")
    if failed:
        names = ", ".join(map(str, failed[:8])) + (f" and {len(failed) - 8} more" if len(failed) > 8 else "")
        raise LobewiseError(
            f"{len(failed)} of {len(pairs)} files could not be denoised ({names}); mend what is said above."
        )
    return None


@contextmanager
def open_streams(sources: Sequence[str], target: str | None) -> Iterator[tuple[list[str], str | None]]:
    """Put files in place of standard input and output; what is written to the file goes to standard output at the end.

    Raises InputError if one of several inputs is standard input, or several are to be written to standard output.
    """
    if STREAM not in sources and target != STREAM:
        yield list(sources), target
        return
    if len(sources) > 1:
        action = "give one input, and name its output with -o"
        raise InputError("input", expected=f"one input where {STREAM} is given", got=str(len(sources)), action=action)
    if sources[0] == STREAM and target is None:
        raise InputError("--output", expected=f"a file, or {STREAM}", got="none", action="add -o FILE")
    with tempfile.TemporaryDirectory(prefix="lobewise-") as folder:
        source, output = sources[0], target
        if source == STREAM:
            source = str(Path(folder) / "standard_input.exr")
            with Path(source).open("wb") as file:
                shutil.copyfileobj(sys.stdin.buffer, file)
        if target == STREAM:
            output = str(Path(folder) / "standard_output.exr")
        # What is said of the result must not stand among the bytes of the image.
        with redirect_stdout(sys.stderr) if target == STREAM else redirect_stdout(sys.stdout):
            yield [source], output
        if target == STREAM:
            with Path(str(output)).open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()


def prepare_tev(is_wanted: bool) -> Callable[[Sequence[tuple[Path, Path]]], None]:
    """Return a function that shows outputs and inputs in tev, which stays open.

    Raises InputError if tev is not installed, before anything is denoised.
    """
    program = shutil.which("tev")
    if is_wanted and program is None:
        action = "install it from https://github.com/Tom94/tev, or leave the option out"
        raise InputError("--tev", expected="the program tev", got="none on the PATH", action=action)

    def send(pairs: Sequence[tuple[Path, Path]]) -> None:
        if is_wanted and program is not None:
            names = [str(path) for source, output in pairs for path in list_files([output, source])]
            subprocess.Popen([program, *names], stdin=subprocess.DEVNULL, start_new_session=True)

    return send
