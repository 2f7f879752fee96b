"""The controls of a side of the wipe, on a page that only remembers them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from lobewise.interactive.settings import METHODS, InteractiveSettings
from lobewise.settings import FORM_NAMES, QUALITY_NAMES
from lobewise.viewer.looks import FRAME_SIMILARITIES, SCENE_SIMILARITIES, FrameLook
from lobewise.viewer.messages import Description
from lobewise.viewer.panel import LookPanel


class Page:
    """Remembers its controls by their labels."""

    def __init__(self) -> None:
        self.controls: dict[str, SimpleNamespace] = {}

    def keep(self, label, value, **more):
        control = SimpleNamespace(value=value, visible=True, on_update=lambda react: None, **more)
        self.controls[label] = control
        return control

    def add_dropdown(self, label, names, *, initial_value, hint):
        assert initial_value in names
        return self.keep(label, initial_value, names=names, hint=hint)

    def add_slider(self, label, low, high, step, value, *, hint):
        assert low <= value <= high
        return self.keep(label, value, ends=(low, high, step), hint=hint)

    def add_checkbox(self, label, value, *, hint):
        return self.keep(label, value, hint=hint)


def make_panel(look, **found):
    """Return a page and the panel on it."""
    scene = isinstance(look, InteractiveSettings)
    usual = {"similarities": SCENE_SIMILARITIES, "methods": METHODS} if scene else {"similarities": FRAME_SIMILARITIES}
    if not scene:
        usual |= {"qualities": QUALITY_NAMES, "forms": FORM_NAMES, "hit_distance": True}
    page = Page()
    return page, LookPanel(page, Description(look, 64, 64, **{**usual, **found}), look, lambda: None)


@pytest.mark.parametrize(
    "look",
    [
        InteractiveSettings(),
        InteractiveSettings(
            "voxel_cones", 8, 2, "sg_mixture", 2.5, 5, temporal=False, adaptive=0.125, filter_direct=False
        ),
        FrameLook(),
        FrameLook("none"),
        FrameLook("asg", "fast", "atrous", 3, 4.5, 32.0, 0.01, True),
        FrameLook("normal", "high", radius=2, normal_exponent=8.0),
    ],
)
def test_what_is_shown_is_what_is_set(look):
    _, panel = make_panel(look)
    assert panel.get_look() == look


def test_labels_and_hints_are_there():
    page, _ = make_panel(InteractiveSettings())
    assert list(page.controls) == [
        "Method",
        "Every nth pixel",
        "Samples",
        "Similarity",
        "Radius",
        "Auto beta",
        "Beta",
        "Temporal",
        "Adaptive, %",
        "Filter direct light",
    ]
    frame, _ = make_panel(FrameLook())
    assert {"Quality", "Kernel", "Normal exponent", "Auto band-limit", "Band-limit, log", "Hit distance"} <= set(
        frame.controls
    )
    for control in (*page.controls.values(), *frame.controls.values()):
        assert control.hint.endswith(".")
        assert len(control.hint) < 200
    assert page.controls["Similarity"].names[0] == "ggx (covariance)"


def test_what_leaves_no_choice_has_no_control():
    look = FrameLook("ggx", "fast")
    page, panel = make_panel(look, qualities=("fast",), forms=("full",), sparse=True, hit_distance=False)
    assert not {"Quality", "Kernel", "Hit distance"} & set(page.controls)
    assert page.controls["Radius"].ends == (0, 16, 1)
    assert panel.get_look() == look


def test_settings_that_mean_nothing_are_left_out():
    page, panel = make_panel(FrameLook("ggx", "fast", "separable", hit_distance=True))
    page.controls["Quality"].value = "balanced"
    assert panel.get_look().form == "full"
    page.controls["Similarity"].value = "normal-aware"
    assert panel.get_look() == replace(FrameLook("normal", "balanced"), hit_distance=False)
    page.controls["Similarity"].value = "none"
    assert panel.get_look() == FrameLook("none")


def test_what_changes_nothing_is_hidden():
    page, _ = make_panel(FrameLook("normal", "fast", "atrous"))
    hidden = {label for label, control in page.controls.items() if not control.visible}
    assert hidden == {"Radius", "Beta", "Auto band-limit", "Band-limit, log", "Hit distance"}
    page, _ = make_panel(InteractiveSettings(similarity="none", scale=1))
    hidden = {label for label, control in page.controls.items() if not control.visible}
    assert hidden == {"Radius", "Auto beta", "Beta", "Temporal", "Filter direct light", "Adaptive, %"}
