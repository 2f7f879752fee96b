"""The controls of one browser."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from lobewise.interactive.settings import METHODS, VIEWS, InteractiveSettings
from lobewise.settings import Knob
from lobewise.viewer.http.browser_messages import Control
from lobewise.viewer.messages import Description
from lobewise.viewer.pictures import LEGENDS, MAX_STOPS
from lobewise.viewer.scene_settings import KNOBS, SCENE_CONTROLS, SCENE_SIMILARITIES
from lobewise.viewer.status import write_message

NAMES = {
    "paths": "paths",
    "voxel_cones": "voxel cones",
    "virtual_lights": "virtual lights",
    "ggx": "ggx (covariance)",
    "sg": "single SG",
    "sg_mixture": "SG mixture",
    "normal": "normal-aware",
}
"""Words of settings that have another name on the page."""
FLY_HINT = "Left drag orbits, right drag moves, the wheel zooms. W A S D E Q fly, the arrow keys turn."
MIN_SPEED, MAX_SPEED = 0.1, 4.0
"""Frames of the objects' motion from picture to picture; the smallest number is also the slider's step."""


class Slider(NamedTuple):
    """The range of a slider, and how its numbers map to those of the setting."""

    low: float
    high: float
    step: float
    at_auto: float = 0.0
    """Number of the slider while the setting is "auto"."""
    to_slider: Callable[[float], float] = float
    from_slider: Callable[[float], float] = float


SLIDERS = {
    "scale": Slider(1, 16, 1, from_slider=int),
    "spp": Slider(1, 16, 1, from_slider=int),
    "radius": Slider(0, 16, 1, from_slider=int),
    "beta": Slider(0.5, 64.0, 0.5, 4.0),
    "adaptive": Slider(0.0, 25.0, 0.5, 0.0, lambda share: 100.0 * share, lambda percent: percent / 100.0),
}


class SettingsPanel:
    """The settings of one side of the wipe.

    Parameters
    ----------
    gui : viser's GUI
        Controls are added to its current folder.
    settings : InteractiveSettings
        The first settings.
    changed : callable
        Called when the user changed a setting.
    """

    def __init__(self, gui: Any, settings: InteractiveSettings, changed: Callable[[], None]) -> None:
        self._gui = gui
        self._changed = changed
        self._settings = settings
        self._handles: dict[str, Any] = {}
        choices = {"method": METHODS, "similarity": SCENE_SIMILARITIES}
        for field in SCENE_CONTROLS:
            knob, value = KNOBS[field], getattr(settings, field)
            if field in choices:
                names = [NAMES.get(word, word) for word in choices[field]]
                arguments = {"initial_value": NAMES.get(value, value), "hint": knob.hint}
                self._keep(field, gui.add_dropdown(knob.label, names, **arguments))
            elif field in SLIDERS:
                self._slide(knob, value)
            else:
                self._keep(field, gui.add_checkbox(knob.label, value, hint=knob.hint))
        self._refresh()

    @property
    def handles(self) -> tuple[Any, ...]:
        """viser's handles of the controls."""
        return tuple(self._handles.values())

    def get_settings(self) -> InteractiveSettings:
        """Return the current settings."""
        values = {name: self._get(name) for name in self._handles if not name.startswith("auto_")}
        return replace(self._settings, **values)

    def _get(self, name: str) -> Any:
        """Return the value of a setting that has a control."""
        value = self._handles[name].value
        if name in SLIDERS:
            auto = self._handles.get(f"auto_{name}")
            return "auto" if auto is not None and auto.value else SLIDERS[name].from_slider(value)
        return next((word for word, shown in NAMES.items() if shown == value), value)

    def _refresh(self) -> None:
        """Hide controls that change nothing with the current settings."""
        handles = self._handles
        filtered = self._get("similarity") != "none"
        shown = {
            "radius": filtered,
            "auto_beta": filtered,
            "beta": filtered and not handles["auto_beta"].value,
            "temporal": filtered,
            "filter_direct": filtered,
            "adaptive": handles["scale"].value > 1,
        }
        for name, visible in shown.items():
            if handles[name].visible != visible:
                handles[name].visible = visible

    def _slide(self, knob: Knob, value: Any) -> None:
        """Add a slider, after a checkbox for "auto" if the setting can be "auto"."""
        slider, auto = SLIDERS[knob.name], value == "auto"
        if "auto" in knob.choices:
            hint = f"{knob.label} follows the noise."
            self._keep(f"auto_{knob.name}", self._gui.add_checkbox(f"Auto {knob.label.lower()}", auto, hint=hint))
        first = slider.at_auto if auto else slider.to_slider(value)
        self._keep(
            knob.name, self._gui.add_slider(knob.label, slider.low, slider.high, slider.step, first, hint=knob.hint)
        )

    def _keep(self, name: str, handle: Any) -> None:
        self._handles[name] = handle

        async def react(event: Any) -> None:
            self._refresh()
            self._changed()

        handle.on_update(react)


@dataclass
class Actions:
    """The functions that the controls call, from the server's threads.

    Parameters
    ----------
    render, redraw : callable
        Called after changes that need a new frame, or that only show the last frame in another way.
    reset_camera, expose : callable
        Called by the two buttons of the folder "View".
    save : callable
        Called with "exr" or "png".
    """

    render: Callable[[], None]
    redraw: Callable[[], None]
    reset_camera: Callable[[], None]
    expose: Callable[[], None]
    save: Callable[[str], None]


class Panel:
    """Status and controls of one browser.

    Parameters
    ----------
    gui : viser's GUI of that browser
    description : Description
        The target.
    settings, other : InteractiveSettings
        The first settings of the left and the right side.
    actions : Actions
    fixed_size : bool
        Whether the resolution is never lowered; then there is no control for it.
    """

    def __init__(
        self,
        gui: Any,
        description: Description,
        settings: InteractiveSettings,
        other: InteractiveSettings,
        actions: Actions,
        *,
        fixed_size: bool,
    ) -> None:
        self._gui = gui
        self._actions = actions
        self.status = gui.add_html("")
        with gui.add_folder("View"):
            self._view = gui.add_dropdown("Show", list(VIEWS.values()), hint="The image, or what happens inside.")
            self._legend = gui.add_html("", visible=False)
            self._stops = gui.add_slider(
                "Exposure, stops", -MAX_STOPS, MAX_STOPS, 0.1, 0.0, hint="Each stop doubles the light."
            )
            self._expose = gui.add_button("Auto exposure", hint="Put the brightest 2 % above the shoulder.", icon=None)
            reset = gui.add_button("Reset camera", hint=FLY_HINT)
        self._plays: Any = None
        self._speed: Any = None
        if description.moves:
            with gui.add_folder("Motion"):
                self._plays = gui.add_checkbox("Play", True, hint="Let the objects move.")
                hint = "Frames of the motion from picture to picture."
                self._speed = gui.add_slider("Speed", MIN_SPEED, MAX_SPEED, MIN_SPEED, 1.0, hint=hint)
        with gui.add_folder("Wipe"):
            self._wiped = gui.add_checkbox("Compare A, B", False, hint="Left of the line A, right of it B.")
            self._place = gui.add_slider("Line", 0.0, 1.0, 0.005, 0.5, visible=False, hint="Where the line is.")
        with gui.add_folder("Settings A"):
            self.left = SettingsPanel(gui, settings, actions.render)
        self._right_folder = gui.add_folder("Settings B", visible=False)
        with self._right_folder:
            self.right = SettingsPanel(gui, other, actions.render)
        self._adapt: Any = None
        with gui.add_folder("Pace"):
            knob = KNOBS["accumulate"]
            self._accumulate = gui.add_checkbox(knob.label, True, hint=knob.hint)
            if not fixed_size:
                hint = "Lower the resolution of a moving camera to keep responding."
                self._adapt = gui.add_checkbox("Fewer pixels in motion", True, hint=hint)
        save = gui.add_button_group(
            "Save", ("EXR", "PNG"), hint="EXR: linear radiance of A and guides. PNG: the picture that is shown."
        )
        self._connect(reset, save)
        others = (self._view, self._stops, self._expose, reset, self._wiped, self._place, save)
        paces = (handle for handle in self._list_paces() if handle is not None)
        handles = (*others, *paces, *self.left.handles, *self.right.handles)
        self.controls = dict(describe_control(handle) for handle in handles)
        """The values that each control takes, by viser's identities."""

    @property
    def view(self) -> str:
        """The chosen view, one of `VIEWS`."""
        return next(name for name, title in VIEWS.items() if title == self._view.value)

    @property
    def stops(self) -> float:
        """Exposure, base-2 logarithm."""
        return float(self._stops.value)

    @property
    def wipe(self) -> float | None:
        """Position of the line, None without a wipe."""
        return float(self._place.value) if self._wiped.value else None

    @property
    def accumulate(self) -> bool:
        """Whether frames of a camera that stands still are averaged."""
        return bool(self._accumulate.value)

    @property
    def adapt(self) -> bool:
        """Whether the resolution may be lowered."""
        return self._adapt is not None and bool(self._adapt.value)

    @property
    def speed(self) -> float:
        """Frames of the objects' motion from picture to picture; 0 while they stand still."""
        return float(self._speed.value) if self._plays is not None and self._plays.value else 0.0

    def _list_paces(self) -> tuple[Any, ...]:
        """Return the controls of motion and pace; None for those that the page does not have."""
        return self._plays, self._speed, self._accumulate, self._adapt

    def set_stops(self, stops: float) -> None:
        """Move the slider to an exposure that was chosen automatically."""
        self._stops.value = stops

    def _connect(self, reset: Any, save: Any) -> None:
        actions = self._actions

        async def redraw(event: Any) -> None:
            legend = LEGENDS.get(self.view, "")
            self._legend.content = write_message(legend)
            self._legend.visible = bool(legend)
            # Only radiance has an exposure.
            exposed = not legend and self.view != "albedo"
            self._stops.visible = self._expose.visible = exposed
            if event.client_id is not None:
                actions.redraw()

        async def toggle(event: Any) -> None:
            self._place.visible = self._right_folder.visible = bool(self._wiped.value)
            actions.render()

        async def render(event: Any) -> None:
            actions.render()

        self._view.on_update(redraw)
        self._stops.on_update(redraw)
        self._place.on_update(redraw)
        self._wiped.on_update(toggle)
        for handle in self._list_paces():
            if handle is not None:
                handle.on_update(render)

        async def click_reset(event: Any) -> None:
            actions.reset_camera()

        async def click_expose(event: Any) -> None:
            actions.expose()

        async def click_save(event: Any) -> None:
            actions.save(event.target.value.lower())

        reset.on_click(click_reset)
        self._expose.on_click(click_expose)
        save.on_click(click_save)


def describe_control(handle: Any) -> tuple[str, Control]:
    """Return viser's identity of a control, by which browsers name it, and the values that it takes."""
    identity = str(handle._impl.uuid)
    if hasattr(handle, "options"):
        return identity, Control(choices=tuple(handle.options))
    if hasattr(handle, "min"):
        return identity, Control(low=handle.min, high=handle.max)
    return identity, Control()
