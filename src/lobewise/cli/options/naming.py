"""Which file each input is written to: the name of one file, a folder, standard output, or a name of our own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lobewise.cli.options.writing import list_files
from lobewise.cli.terminal.help import file_detail
from lobewise.errors import InputError, LobewiseError

if TYPE_CHECKING:
    from lobewise.work.overlap import Overlap

MIN_FRAMES_OF_SEQUENCE = 3
"""Fewest files, named by one pattern, that may be an animation."""
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
    from lobewise.io.files import EXR_NAMES
    from lobewise.io.sequence import FramePattern, is_pattern

    if not is_pattern(source):
        return source.with_name(f"{source.stem}_clean{source.suffix if source.suffix in EXR_NAMES else '.exr'}")
    pattern = FramePattern.parse(source)
    before = pattern.before.rstrip("._- ")
    start = f"{before}_clean{pattern.before[len(before) :]}" if before else "clean."
    return source.with_name(start + source.name[len(pattern.before) :])


def expand_names(sources: Sequence[str]) -> list[str]:
    """Return inputs, with the files for a name such as ``*.exr``: some shells replace none.

    Capital and small letters are the same, as in shells that leave this to programs. A name without a file stays.
    """
    return [name for source in sources for name in _expand(Path(source)) or [source]]


def _expand(source: Path) -> list[str]:
    if not set(source.name) & set("*?") or os.path.exists(source):
        return []
    with suppress(OSError, ValueError):
        there = sorted(entry.name for entry in os.scandir(source.parent) if entry.is_file())
        return [str(source.parent / name) for name in there if fnmatchcase(name.lower(), source.name.lower())]
    return []


def describe_sequence(inputs: Sequence[Path]) -> str:
    """Return a sentence on several files that are frames of one sequence; empty where they are none."""
    from lobewise.io.sequence import name_pattern

    patterns = {name_pattern(path) for path in inputs}
    pattern = patterns.pop()
    if len(inputs) < MIN_FRAMES_OF_SEQUENCE or patterns or pattern is None:
        return ""
    return (
        f"Each file is denoised by itself. If they are an animation, {str(pattern)!r} with --window 2 has less flicker."
    )


def pair_files(sources: Sequence[str], target: str | None) -> tuple[list[tuple[Path, Path]], list[Path]]:
    """Return the inputs, files of folders one by one, each with its output, and the folders of outputs to be made.

    Raises FileError if a folder cannot be read, and InputError if a folder holds no EXR file, or several inputs have
    one output.
    """
    from lobewise.io.files import require_file_name

    listed = [(Path(source), _list_inputs(Path(source))) for source in sources]
    inputs = [path for _, paths in listed for path in paths]
    is_folder = target is not None and (os.path.isdir(target) or target.endswith((os.sep, os.altsep or os.sep)))
    if target is None:
        folders = [_name_clean_folder(source) for source, paths in listed if paths != [source]]
        pairs = [
            (path, name_clean(path) if path == source else _name_clean_folder(source) / path.name)
            for source, paths in listed
            for path in paths
        ]
    elif inputs == [Path(sources[0])] and not is_folder:
        return [(inputs[0], require_file_name(target))], []
    elif not is_folder and Path(target).suffix.lower() == ".exr":
        raise InputError(
            "--output",
            expected=f"a folder for the {len(inputs)} inputs",
            got=f"the file {target!r}",
            action="name a folder",
        )
    else:
        folders, pairs = [Path(target)], [(path, Path(target) / path.name) for path in inputs]
    outputs = [output for _, output in pairs]
    twice = next((output for output in outputs if outputs.count(output) > 1), None)
    if twice is not None:
        got = f"two for {str(twice)!r}"
        raise InputError("inputs", expected="one for each output", got=got, action="give them one by one")
    return pairs, folders


def require_inputs(sources: Sequence[str], outputs: Sequence[Path]) -> None:
    """Raise FileError or InputError if an output that the user names cannot be written, or an input is missing."""
    from lobewise.io.files import require_exr_name, require_readable, require_writable
    from lobewise.io.sequence import is_pattern

    for output in outputs:
        require_exr_name(output)
        if not is_pattern(output):
            require_writable(output)
    for source in sources:
        if not (is_pattern(source) or os.path.isdir(source)):
            require_readable(source)


def _list_inputs(source: Path) -> list[Path]:
    """Return the EXR files of a folder, or the input itself."""
    from lobewise.io.files import refusing

    # `Path.is_dir` would raise an error for a name that is too long.
    if not os.path.isdir(source):
        return [source]
    with refusing(f"input {str(source)!r}", "a folder that can be read", "check its permissions"):
        found = sorted(path for path in source.iterdir() if path.suffix.lower() == ".exr" and path.is_file())
    if not found:
        raise InputError(f"input {str(source)!r}", expected="EXR files in the folder", got="none", action="name files")
    return found


def _name_clean_folder(folder: Path) -> Path:
    """Return a folder beside another one: results among their inputs would be denoised by the next run."""
    named = folder if folder.name not in ("", "..") else folder.resolve()
    return named.with_name(f"{named.name}_clean")


@dataclass(frozen=True)
class Turn:
    """The place of an input among several."""

    label: str
    """Begins every note on the input; empty for the only one."""
    overlap: Overlap
    """What read the input ahead, if anything did."""
    following: Path | None
    """The file that may be read ahead; None where there is none, or it is not there yet."""


def run_each(
    pairs: Sequence[tuple[Path, Path]], folders: Sequence[Path], run: Callable[[Path, Path, Turn], None]
) -> None:
    """Make the folders of outputs, and run a verb on every pair of input and output.

    Of several inputs one that fails does not stop the others. Raises LobewiseError at the end if any failed.
    """
    from lobewise.cli.output import print_note
    from lobewise.io.files import make_folder
    from lobewise.io.sequence import is_pattern
    from lobewise.work.overlap import Overlap

    for folder in folders:
        make_folder(folder)
    with Overlap() as overlap:
        if len(pairs) == 1:
            return run(*pairs[0], Turn("", overlap, None))
        if note := describe_sequence([source for source, _ in pairs]):
            print_note(note)
        failed = []
        for (source, output), following in zip(pairs, [*(path for path, _ in pairs[1:]), None], strict=True):
            is_there = following is not None and following != output and not is_pattern(following)
            try:
                run(source, output, Turn(source.name, overlap, following if is_there else None))
            except LobewiseError as problem:
                failed.append(source)
                print_note(f"{source}: {problem}")
    if failed:
        names = ", ".join(map(str, failed[:8])) + (f" and {len(failed) - 8} more" if len(failed) > 8 else "")
        raise LobewiseError(
            f"{len(failed)} of {len(pairs)} files could not be denoised ({names})", action="mend what is said above"
        )
    return None


@contextmanager
def open_streams(sources: Sequence[str], target: str | None) -> Iterator[tuple[list[str], str | None]]:
    """Put files in place of names with stars, and of standard input and output.

    The bytes of the output file go to standard output at the end.

    Raises InputError if one of several inputs is standard input, or several are to be written to standard output.
    """
    if STREAM not in sources and target != STREAM:
        yield expand_names(sources), target
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
        # Sentences about the result must not stand among the bytes of the image.
        with redirect_stdout(sys.stderr) if target == STREAM else nullcontext():
            yield [source], output
        if target == STREAM:
            with Path(str(output)).open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()


def require_files(sources: Sequence[str], target: str | None, option: str) -> None:
    """Raise InputError if an option that needs files to stay meets a stream; ``option`` is empty where it is absent."""
    if option and STREAM in (*sources, target):
        raise InputError(option, expected="files as input and output", got=repr(STREAM), action="name files")


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
