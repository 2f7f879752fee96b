"""A scene with an orthographic sensor in the page: the browser has a pinhole far away."""

import numpy as np
import pytest

from tests.viewer.conftest import compare, run_viewer
from tests.viewer.test_scene_target import BLOCK, CHEAP, NOISE, SIZE, arrive, drag, locate

pytestmark = [pytest.mark.nightly, pytest.mark.mitsuba]

SCENE = """<scene version="3.0.0"><sensor type="orthographic">
<transform name="to_world"><scale x="1.5" y="1.5"/><lookat origin="0.3,1.6,4" target="0,0.6,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/></film></sensor>
<shape type="cube"><transform name="to_world"><scale value="0.6"/></transform><bsdf type="roughplastic"/></shape>
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="2"/></transform></shape>
<emitter type="constant"/></scene>"""


def test_it_orbits_and_comes_nearer(mi, visit, tmp_path):
    path = tmp_path / "flat.xml"
    path.write_text(SCENE)
    with run_viewer(str(path), size=SIZE, changes=CHEAP) as viewer:
        page = arrive(visit, viewer)
        first, start = page.look(), locate(viewer)
        assert first.std() > 10.0
        assert page.page.get_by_text("orthographic").first.is_visible()
        drag(page, 4)
        second = page.wait_for_change(first, least=0.5 * NOISE, block=BLOCK)
        turned = locate(viewer)
        assert np.linalg.norm(turned - start) > 0.3
        page.page.mouse.wheel(0, -300)
        page.wait(lambda: np.linalg.norm(locate(viewer) - turned) > 0.3, "the camera to come nearer")
        third = page.wait_for_change(second, least=0.5 * NOISE, block=BLOCK)
        assert third.std() > 10.0
        page.page.get_by_role("button", name="Reset camera").click()
        page.wait(lambda: compare(page.look(), first, BLOCK) < NOISE, "the first view")
