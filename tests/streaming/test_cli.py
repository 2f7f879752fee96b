"""`lobewise denoise --bands`: what it takes and says, when it chooses bands by itself, and how Ctrl-C ends it."""

import contextlib
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.cli.output import describe_result, describe_settings
from lobewise.cli.program import run
from lobewise.io import write_frame
from lobewise.recipes.files import FileResult
from lobewise.recipes.streaming import plan
from lobewise.recipes.streaming.recipe import DenoisedFile
from tests.interrupts import start_program
from tests.streaming.frames import change_radiance, make_scene

CHEAP = ["--quality", "fast", "--similarity", "normal"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a frame of 83x19 pixels."""
    write_frame(tmp_path / "in.exr", change_radiance(make_scene((83, 19)), [3, 60], 4, np.nan))
    return tmp_path


def denoise(folder: Path, *more: str, output: str = "out.exr") -> int:
    """Return the exit code of denoising the folder's frame."""
    return run(["denoise", str(folder / "in.exr"), "-o", str(folder / output), *more])


def test_bands_give_the_bytes_of_the_whole(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert denoise(folder, "--bands", "off", *CHEAP, output="whole.exr") == 0
    whole = capsys.readouterr()
    assert denoise(folder, "--bands", "30", *CHEAP) == 0
    banded = capsys.readouterr()
    assert (folder / "out.exr").read_bytes() == (folder / "whole.exr").read_bytes()
    assert "19x83 pixels, quality fast" in whole.out
    assert "19x83 pixels in 3 bands, quality fast" in banded.out
    assert "; 2 bad pixels refilled." in banded.out
    assert banded.err == whole.err


def test_large_files_are_taken_in_bands(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert denoise(folder, *CHEAP) == 0
    assert "bands" not in capsys.readouterr().out
    monkeypatch.setattr(plan, "MAX_WHOLE_GIB", 1e-6)
    assert denoise(folder, *CHEAP) == 0
    assert "in 1 band, " in capsys.readouterr().out
    assert denoise(folder, *CHEAP, "--bands", "off") == 0
    assert "in 1 band, " not in capsys.readouterr().out


def test_sequences_go_band_by_band_and_frame_by_frame(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in (1, 2):
        write_frame(folder / f"in.{number:04d}.exr", make_scene((83, 19), seed=number))
    sequence = ["denoise", str(folder / "in.####.exr"), "-o"]
    assert run([*sequence, str(folder / "whole.####.exr"), "--bands", "off", *CHEAP]) == 0
    for name, options in (("rows", ["--bands", "30"]), ("auto", [])):
        monkeypatch.setattr(plan, "MAX_WHOLE_GIB", 1e-6)
        capsys.readouterr()
        assert run([*sequence, str(folder / f"{name}.####.exr"), *options, *CHEAP]) == 0
        assert "2 of 2 frames; the last: 19x83 pixels in " in capsys.readouterr().out
        for number in (1, 2):
            expected = (folder / f"whole.{number:04d}.exr").read_bytes()
            assert (folder / f"{name}.{number:04d}.exr").read_bytes() == expected


def test_materials_come_along(folder: Path, full_frame: Any) -> None:
    from lobewise.io.materials import write_lobe_table

    frame = make_scene((83, 19))
    guides = replace(frame.gbuffer, material=np.random.default_rng(1).integers(0, 3, (83, 19)))
    write_frame(folder / "in.exr", frame.with_changes(gbuffer=guides, lobe_tables=full_frame.lobe_tables))
    options = ["--quality", "fast", "--similarity", "sg_mixture"]
    for number, table in enumerate(full_frame.lobe_tables[::-1]):
        write_lobe_table(folder / f"{number}.lobes", table)
        options += ["--material", str(folder / f"{number}.lobes")]
    assert denoise(folder, "--bands", "off", *options, output="whole.exr") == 0
    assert denoise(folder, "--bands", "30", *options) == 0
    assert (folder / "out.exr").read_bytes() == (folder / "whole.exr").read_bytes()


def test_the_account_names_what_was_done() -> None:
    settings = {"similarity": "sg", "form": "full", "quality": "high", "radius": 8, "beta": 1.0, "device": "cpu"}
    done = FileResult((DenoisedFile((4320, 7680), 12, 1, 0.01234, settings, 61.234),))
    assert describe_result(done) == ("7680x4320 pixels in 12 bands, quality high, 61.23 s; 1 bad pixel refilled")
    assert describe_settings(done) == "similarity sg, form full, quality high, radius 8, beta 1, device cpu"


PROGRAM = """
import sys, time
from lobewise.cli import main
from lobewise.recipes.streaming import recipe

filter_band = recipe._filter_band

def tell(*arguments):
    print("band", flush=True)
    time.sleep(0.5)
    return filter_band(*arguments)

recipe._filter_band = tell
main(sys.argv[1:])
"""


@pytest.mark.nightly
@pytest.mark.parametrize("before", [None, b"what was there"])
def test_ctrl_c_leaves_no_part_of_a_file(before: bytes | None, folder: Path) -> None:
    if before is not None:
        (folder / "out.exr").write_bytes(before)
    arguments = ["denoise", str(folder / "in.exr"), "-o", str(folder / "out.exr"), "--bands", "10", *CHEAP]
    process = start_program(*arguments, program=PROGRAM)
    # In the midst of the third of nine bands; two are on the disk.
    for _ in range(3):
        assert process.stdout.readline() == "band\n"
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert error == "lobewise: interrupted; every output is whole, or as it was.\n"
    assert sorted(os.listdir(folder)) == (["in.exr"] if before is None else ["in.exr", "out.exr"])
    if before is not None:
        assert (folder / "out.exr").read_bytes() == before


def test_a_terminal_sees_how_far_it_is(folder: Path) -> None:
    pty = pytest.importorskip("pty")
    parent, child = pty.openpty()
    # So small a file is done before a bar is shown.
    soon = "from lobewise.work import progress; from lobewise.cli.terminal import steps; "
    soon += f"steps.MIN_SECONDS_WITH_BAR = progress.MIN_SECONDS = 0.0; {PROGRAM}"
    command = [sys.executable, "-c", soon, "denoise", str(folder / "in.exr"), "-o", str(folder / "out.exr")]
    with open(os.devnull, "wb") as silence:
        process = subprocess.Popen([*command, "--bands", "30", *CHEAP], stdout=silence, stderr=child)
        os.close(child)
        shown = b""
        # Linux raises it where the other end of a terminal has closed.
        with contextlib.suppress(OSError):
            while block := os.read(parent, 65536):
                shown += block
        assert process.wait(60) == 0
    os.close(parent)
    text = shown.decode("utf-8", "replace")
    assert "in.exr: filtering" in text
    assert "in.exr: writing" in text
    assert re.search(r"[1-9]\d %, 0:00:0\d left", text)
