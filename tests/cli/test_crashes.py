"""A crash of Mitsuba ends `render`, `view` and `fit` in one sentence; everything else ends them as without a child."""

import os
import signal
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lobewise.cli.program import run
from tests.interrupts import start_program

SCENE = """<scene version="3.0.0">
<sensor type="perspective"><film type="hdrfilm">
<integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
<shape type="ply" id="mesh"><string name="filename" value="mesh.ply"/><bsdf type="diffuse" id="gray"/></shape>
<emitter type="constant"/></scene>"""
HEAD = """ply
format binary_little_endian 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
MAIN = "from lobewise.cli import main; main()"
WITHOUT_FORK = "import os\nif hasattr(os, 'fork'): del os.fork\n"
CRASHED = "expected one that Mitsuba can load and render, got the end of Mitsuba's process by {}"
PATIENCE = 120.0

on_posix = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.fixture
def write_scene(mi: Any, tmp_path: Path) -> Callable[[int], Path]:
    """Return a function that writes the scene of one triangle, by the number of its last vertex."""

    def write(last: int) -> Path:
        corners = struct.pack("<9f", 0, 0, 3, 1, 0, 3, 0, 1, 3)
        (tmp_path / "mesh.ply").write_bytes(HEAD.encode() + corners + struct.pack("<B3i", 3, 0, 1, last))
        (tmp_path / "scene.xml").write_text(SCENE)
        return tmp_path / "scene.xml"

    return write


@pytest.fixture
def broken(write_scene: Callable[[int], Path]) -> Path:
    """Return a scene that crashes Mitsuba: a triangle has a vertex that is not there."""
    return write_scene(100_000_000)


def start(*words: object, before: str = "", after: str = MAIN, err: int = subprocess.PIPE) -> subprocess.Popen[str]:
    """Start the program with a line of Python before it, in a session of its own."""
    return start_program(*words, program=before + after, stderr=err, start_new_session=os.name == "posix")


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error."""
    out, err = process.communicate(timeout=PATIENCE)
    return process.returncode, out, err


@pytest.mark.sampled("anew")
@on_posix
@pytest.mark.mitsuba
@pytest.mark.parametrize("before", ["", WITHOUT_FORK], ids=["fork", "anew"])
def test_render_tells_a_crash(broken: Path, before: str) -> None:
    broken.with_name("out.exr").write_bytes(b"as it was")
    code, out, err = finish(start("render", broken, "-o", broken.with_name("out.exr"), before=before))
    assert (code, out) == (2, "")
    told = [line for line in err.splitlines() if line.startswith("lobewise:")]
    assert len(told) == 1
    assert told[0].startswith(f"lobewise: scene '{broken}': {CRASHED.format('SIGSEGV')}; leave out its meshes")
    assert broken.with_name("out.exr").read_bytes() == b"as it was"
    assert sorted(path.name for path in broken.parent.iterdir()) == ["mesh.ply", "out.exr", "scene.xml"]


@on_posix
@pytest.mark.mitsuba
def test_fit_tells_a_crash(broken: Path) -> None:
    code, out, err = finish(start("fit", "--mitsuba", f"{broken}#gray", "-o", broken.with_name("gray.lobes")))
    assert (code, out) == (2, "")
    assert f"lobewise: scene '{broken}': {CRASHED.format('SIGSEGV')}" in err


@on_posix
@pytest.mark.mitsuba
def test_view_tells_a_crash(broken: Path, capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser", reason="pip install 'lobewise[viewer]'")
    assert run(["view", str(broken), "--port", "0"]) == 2
    told = capfd.readouterr().err
    assert told.count("lobewise: ") == 1
    assert f"lobewise: scene '{broken}': {CRASHED.format('SIGSEGV')}" in told


@pytest.mark.sampled("fork")
@pytest.mark.mitsuba
@pytest.mark.parametrize("before", ["", WITHOUT_FORK], ids=["fork", "anew"])
def test_what_goes_well_goes_as_without_a_child(write_scene: Callable[[int], Path], before: str) -> None:
    scene = write_scene(2)
    output = scene.with_name("out.exr")
    told = f"Wrote {output}: 8x8 pixels, 1 spp.\n"
    assert finish(start("render", scene, "--spp", "1", "-o", output, before=before)) == (0, told, "")
    assert output.exists()
    code, out, err = finish(start("render", scene, "--spp", "0", "-o", output, before=before))
    assert (code, out) == (2, "")
    assert err.count("lobewise: ") == 1
    assert "spp: expected" in err


IN_CHILD = """
import os, signal, time
from pathlib import Path
from lobewise.cli.options.writing import Output
from lobewise.cli import main, rendering
def work(scene, output, *rest):
    from lobewise.io.files import open_atomic
    with open_atomic(output) as stream:
        print(os.getpid(), os.getppid(), flush=True)
        {work}
rendering._render_whole = work
main()
"""
CRASH = "os.kill(os.getpid(), signal.{})"


def start_work(work: str, output: Path, err: int = subprocess.PIPE) -> subprocess.Popen[str]:
    """Start `render`, whose child does a piece of work while a file is half written."""
    return start("render", "showroom", "-o", output, after=IN_CHILD.format(work=work), err=err)


@pytest.mark.sampled("SIGKILL", "SIGSEGV")
@on_posix
@pytest.mark.parametrize("name", ["SIGKILL", "SIGABRT", "SIGSEGV"])
def test_nothing_half_written_stays(name: str, tmp_path: Path) -> None:
    code, out, err = finish(start_work(CRASH.format(name), tmp_path / "out.exr"))
    assert code == 2
    assert len(out.split()) == 2
    assert f"lobewise: scene 'showroom': {CRASHED.format(name)}" in err
    assert ("as where memory runs out; free memory" in err) == (name == "SIGKILL")
    assert list(tmp_path.iterdir()) == []


@on_posix
def test_no_progress_stays_on_the_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pty = pytest.importorskip("pty")
    monkeypatch.setenv("TERM", "xterm")
    work = f"with rendering.Steps() as steps: steps.tell('Rendering', 1, 2); {CRASH.format('SIGSEGV')}"
    listener, terminal = pty.openpty()
    process = start_work(work, tmp_path / "out.exr", err=terminal)
    assert finish(process)[0] == 2
    shown = os.read(listener, 10_000).decode()
    for end in (listener, terminal):
        os.close(end)
    assert "\x1b[?25l" in shown
    before, _, sentence = shown.partition("lobewise: scene")
    assert CRASHED.format("SIGSEGV") in sentence
    assert before.endswith("\r\x1b[2K\x1b[?25h")


@pytest.mark.sampled("the terminal's")
@on_posix
@pytest.mark.parametrize("whole", [True, False], ids=["the terminal's", "of one process"])
def test_ctrl_c_is_heard_once(whole: bool, tmp_path: Path) -> None:
    work = """try: print('works', flush=True); time.sleep(100)
        finally: time.sleep(0.5); print('cleaned', flush=True)"""
    process = start_work(work, tmp_path / "out.exr")
    while process.stdout.readline() != "works\n":
        assert process.poll() is None
    (os.killpg if whole else os.kill)(process.pid, signal.SIGINT)
    code, out, err = finish(process)
    assert (code, out) == (130, "cleaned\n")
    assert err == "lobewise: interrupted; every output is whole, or as it was.\n"
    assert list(tmp_path.iterdir()) == []


@on_posix
@pytest.mark.parametrize("name", ["SIGTERM", "SIGKILL"])
def test_the_child_ends_with_its_parent(name: str, tmp_path: Path) -> None:
    process = start_work("time.sleep(20)", tmp_path / "out.exr")
    assert process.stdout.readline().split()[1] == str(process.pid)
    os.kill(process.pid, getattr(signal, name))
    # The pipes are open until the child has ended as well.
    out, err = process.communicate(timeout=10)
    assert (process.returncode, out, err) == (-getattr(signal, name), "", "")


@on_posix
def test_who_ignores_ctrl_c_goes_on_ignoring_it(tmp_path: Path) -> None:
    before = "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    work = "os.killpg(0, signal.SIGINT); os.kill(os.getppid(), signal.SIGINT); time.sleep(0.2); stream.write(b'all')"
    process = start("render", "showroom", "-o", tmp_path / "out.exr", before=before, after=IN_CHILD.format(work=work))
    code, _, err = finish(process)
    assert (code, err) == (0, "")
    assert (tmp_path / "out.exr").read_bytes() == b"all"
