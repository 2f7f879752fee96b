"""Old scenes are freed while Dr.Jit does not record: freed in the midst of a recording, they end the process."""

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.pythons import run_python

pytestmark = pytest.mark.mitsuba

SCENE = """<scene version="3.0.0">
<sensor type="perspective"><film type="hdrfilm">
<integer name="width" value="8"/><integer name="height" value="4"/></film></sensor>
<shape type="sphere"><point name="center" value="0 0 4"/><bsdf type="roughplastic"/></shape>
<emitter type="constant"/></scene>"""

PROGRAM = """
import gc, sys
from lobewise.render import load_mitsuba, load_scene, render_frame
load_mitsuba("cpu")
from lobewise.render.materials import dispatch

ask, scene = dispatch._dispatch, load_scene(sys.argv[1])
calls, fatal, old = 0, -1, []

def become_garbage(*arguments):
    global calls
    answer = ask(*arguments)
    calls += 1
    if calls == fatal:
        cycle = [old.pop()]
        cycle.append(cycle)
    return answer

def render():
    global calls
    calls = 0
    render_frame(scene, spp=1)
    return calls

dispatch._dispatch = become_garbage
gc.set_threshold(1, 1, 1)
for fatal in range(1, render()):
    old.append(load_scene(sys.argv[1]))
    render()
print(fatal, old)
"""


def test_an_old_scene_may_become_garbage_between_any_two_calls(mi: Any, tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(SCENE)
    count, _, left = run_python("-c", PROGRAM, str(tmp_path / "scene.xml")).partition(" ")
    assert int(count) > 6
    assert left == "[]\n"


def test_garbage_waits_until_a_recording_is_done(mi: Any) -> None:
    from lobewise.render.bridge import Frozen, dr, follow, repeat
    from lobewise.render.tracing.rays import _Skip

    seen: list[bool] = []

    def record(value: Any) -> list[Any]:
        seen.append(gc.isenabled())
        return [value + 1.0]

    frozen = Frozen(record, lambda: None)
    for _ in range(2):
        assert np.allclose(frozen(dr.opaque(mi.Float, 2.0, 3))[0], 3.0)
    (total,) = repeat(lambda index, total: tuple(record(total)), mi.UInt32(0), mi.UInt32(4), mi.Float(1.0), label="sum")
    assert np.allclose(total, 5.0)

    def end(state: Any) -> None:
        state.active = record(mi.Float(0.0))[0] < 0.0

    follow(_Skip(dr.zeros(mi.Ray3f)), end, "end")
    assert len(seen) >= 3
    assert not any(seen)
    assert gc.isenabled()
