"""The controls of a side of the wipe, on a page that only remembers them."""

from types import SimpleNamespace

import pytest

from lobewise.interactive.settings import InteractiveSettings
from lobewise.viewer.panel import SettingsPanel


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


def make_panel(settings):
    """Return a page and the panel on it."""
    page = Page()
    return page, SettingsPanel(page, settings, lambda: None)


@pytest.mark.parametrize(
    "settings",
    [
        InteractiveSettings(),
        InteractiveSettings(
            "voxel_cones", 8, 2, "sg_mixture", 2.5, 5, temporal=False, adaptive=0.125, filter_direct=False
        ),
    ],
)
def test_what_is_shown_is_what_is_set(settings):
    _, panel = make_panel(settings)
    assert panel.get_settings() == settings


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
    for control in page.controls.values():
        assert control.hint.endswith(".")
        assert len(control.hint) < 200
    assert page.controls["Similarity"].names[0] == "ggx (covariance)"


def test_what_changes_nothing_is_hidden():
    page, _ = make_panel(InteractiveSettings(similarity="none", scale=1))
    hidden = {label for label, control in page.controls.items() if not control.visible}
    assert hidden == {"Radius", "Auto beta", "Beta", "Temporal", "Filter direct light", "Adaptive, %"}
