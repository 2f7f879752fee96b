"""The controls of one browser."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lobewise.viewer.looks import FrameLook, Look, SceneLook
from lobewise.viewer.messages import Description
from lobewise.viewer.pictures import LEGENDS, MOST_STOPS, VIEWS
from lobewise.viewer.status import write_message

METHOD_NAMES = {"paths": "paths", "voxel_cones": "voxel cones", "virtual_lights": "virtual lights"}
SIMILARITY_NAMES = {
    "auto": "auto",
    "ggx": "ggx (covariance)",
    "sg": "single SG",
    "asg": "anisotropic SG",
    "sg_mixture": "SG mixture",
    "normal": "normal-aware",
    "none": "none",
}
QUALITY_NAMES = {"fast": "fast", "balanced": "balanced", "high": "high"}
FORM_NAMES = {"full": "full", "separable": "separable", "atrous": "à-trous"}
FLY_HINT = "Left drag orbits, right drag moves, the wheel zooms. W A S D E Q fly, the arrow keys turn."
ZOOM_HINT = "The wheel zooms, right drag moves; W A S D fly."

_HINTS = {
    "method": "How indirect light is computed.",
    "scale": "Indirect light is shaded at one pixel of every n x n and upsampled.",
    "spp": "Samples of each shaded pixel.",
    "similarity": "What two pixels must share to be averaged.",
    "auto_beta": "The exponent follows the noise.",
    "beta": "Exponent of the similarity: larger keeps more detail and more noise.",
    "radius": "From the centre to the edge of the kernel, in samples (pixels where all are shaded).",
    "temporal": "A frame knows the ones before.",
    "adaptive": "Share of the pixels that is shaded again because nothing supports them.",
    "filter_direct": "Direct light has one light sample a pixel; filter it too.",
    "quality": "Fast weighs by the guides alone; balanced and high also by what the noise allows to tell apart.",
    "form": "Full is best; separable and à-trous are faster.",
    "auto_tau": "The band-limit follows the noise.",
    "tau": "Band-limit of the lobes, base-10 logarithm of radians: what makes a mirror's lobe finite.",
    "normal_exponent": "How strictly normals are compared.",
    "hit_distance": "Compare what lobes hit, not only where they point.",
}


class LookPanel:
    """The settings of one side of the wipe.

    Parameters
    ----------
    gui : viser's GUI
        Where controls are added; a folder is its context.
    found : Description
        What can be chosen.
    look : Look
        What is set first.
    changed : callable
        Called when the user changed anything.
    """

    def __init__(self, gui: Any, found: Description, look: Look, changed: Callable[[], None]) -> None:
        self._gui = gui
        self._changed = changed
        self._handles: dict[str, Any] = {}
        self._scene = isinstance(look, SceneLook)
        if isinstance(look, SceneLook):
            self._choose("method", "Method", found.methods, METHOD_NAMES, look.method)
            self._slide("scale", "Every nth pixel", 1, 16, 1, look.scale)
            self._slide("spp", "Samples", 1, 16, 1, look.spp)
        self._choose("similarity", "Similarity", found.similarities, SIMILARITY_NAMES, look.similarity)
        if isinstance(look, FrameLook) and len(found.qualities) > 1:
            self._choose("quality", "Quality", found.qualities, QUALITY_NAMES, look.quality)
        if isinstance(look, FrameLook) and len(found.forms) > 1:
            self._choose("form", "Kernel", found.forms, FORM_NAMES, look.form)
        self._slide("radius", "Radius", 0, 16 if self._scene or found.sparse else 32, 1, look.radius)
        self._check("auto_beta", "Auto beta", look.beta == "auto")
        self._slide("beta", "Beta", 0.5, 64.0, 0.5, 4.0 if isinstance(look.beta, str) else look.beta)
        if isinstance(look, SceneLook):
            self._check("temporal", "Temporal", look.temporal)
            self._slide("adaptive", "Adaptive, %", 0.0, 25.0, 0.5, 100.0 * look.adaptive)
            self._check("filter_direct", "Filter direct light", look.filter_direct)
        else:
            self._slide("normal_exponent", "Normal exponent", 1.0, 256.0, 1.0, look.normal_exponent)
            self._check("auto_tau", "Auto band-limit", look.tau == "auto")
            self._slide("tau", "Band-limit, log", -5.0, 0.0, 0.05, -1.5)
            if found.hit_distance:
                self._check("hit_distance", "Hit distance", look.hit_distance)
        self._refresh()

    def get_look(self) -> Look:
        """Return what is set."""
        value = {name: handle.value for name, handle in self._handles.items()}
        similarity = _find_key(SIMILARITY_NAMES, value["similarity"])
        beta = "auto" if value["auto_beta"] else float(value["beta"])
        radius = int(value["radius"])
        if self._scene:
            return SceneLook(
                method=_find_key(METHOD_NAMES, value["method"]),
                scale=int(value["scale"]),
                spp=int(value["spp"]),
                similarity=similarity,
                beta=beta,
                radius=radius,
                temporal=value["temporal"],
                adaptive=value["adaptive"] / 100.0,
                filter_direct=value["filter_direct"],
            )
        if similarity == "none":
            # One look for all settings that change nothing, so that it is computed once.
            return FrameLook(similarity="none")
        quality = _find_key(QUALITY_NAMES, value["quality"]) if "quality" in value else "fast"
        return FrameLook(
            similarity=similarity,
            quality=quality,
            form=_find_key(FORM_NAMES, value["form"]) if "form" in value and quality == "fast" else "full",
            radius=radius,
            beta=beta,
            tau="auto" if value["auto_tau"] else 10.0 ** value["tau"],
            normal_exponent=float(value["normal_exponent"]),
            hit_distance=bool(value.get("hit_distance")) and similarity in ("sg", "asg", "ggx"),
        )

    def _refresh(self) -> None:
        """Hide what changes nothing for the chosen settings."""
        handles = self._handles
        similarity = _find_key(SIMILARITY_NAMES, handles["similarity"].value)
        filtered = similarity != "none"
        # Another kernel than the full one has no other quality.
        plain = "quality" not in handles or handles["quality"].value == QUALITY_NAMES["fast"]
        shown = {
            "radius": filtered,
            "quality": filtered,
            "form": filtered and plain,
            "auto_beta": filtered,
            "beta": filtered and not handles["auto_beta"].value,
            "temporal": filtered,
            "filter_direct": filtered,
            "normal_exponent": similarity == "normal",
            "auto_tau": filtered and similarity != "normal",
            "hit_distance": similarity in ("sg", "asg", "ggx"),
        }
        if "form" in handles:
            shown["radius"] = filtered and not (plain and handles["form"].value == FORM_NAMES["atrous"])
        if "auto_tau" in handles:
            shown["tau"] = shown["auto_tau"] and not handles["auto_tau"].value
        if "adaptive" in handles:
            shown["adaptive"] = handles["scale"].value > 1
        for name, visible in shown.items():
            if name in handles and handles[name].visible != visible:
                handles[name].visible = visible

    def _choose(self, name: str, label: str, keys: Sequence[str], names: dict[str, str], value: str) -> None:
        self._keep(
            name,
            self._gui.add_dropdown(label, [names[key] for key in keys], initial_value=names[value], hint=_HINTS[name]),
        )

    def _slide(self, name: str, label: str, low: float, high: float, step: float, value: float) -> None:
        self._keep(name, self._gui.add_slider(label, low, high, step, value, hint=_HINTS[name]))

    def _check(self, name: str, label: str, value: bool) -> None:
        self._keep(name, self._gui.add_checkbox(label, value, hint=_HINTS[name]))

    def _keep(self, name: str, handle: Any) -> None:
        self._handles[name] = handle

        async def react(event: Any) -> None:
            self._refresh()
            self._changed()

        handle.on_update(react)


@dataclass
class Actions:
    """What the controls do; each is called from the server's threads.

    Parameters
    ----------
    render, redraw : callable
        Something changed that asks for a new frame, or only for the last one to be shown otherwise.
    reset_camera, expose : callable
        The two buttons of the folder "View".
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
    found : Description
        What can be chosen.
    look, other : Look
        What is set first on the left and on the right.
    actions : Actions
    fixed_size : bool
        Whether resolution is never lowered, so that there is no control for it.
    """

    def __init__(
        self, gui: Any, found: Description, look: Look, other: Look, actions: Actions, *, fixed_size: bool
    ) -> None:
        self._gui = gui
        self._actions = actions
        scene = found.camera is not None
        self.status = gui.add_html("")
        with gui.add_folder("View"):
            names = [VIEWS[name] for name in found.views]
            self._view = gui.add_dropdown("Show", names, hint="The image, or what happens inside.")
            self._legend = gui.add_html("", visible=False)
            self._stops = gui.add_slider(
                "Exposure, stops", -MOST_STOPS, MOST_STOPS, 0.1, 0.0, hint="Each stop doubles the light."
            )
            self._expose = gui.add_button("Auto exposure", hint="Put the brightest 2 % above the shoulder.", icon=None)
            hint = FLY_HINT if scene else ZOOM_HINT
            reset = gui.add_button("Reset camera" if scene else "Show all", hint=hint)
        with gui.add_folder("Wipe"):
            self._wiped = gui.add_checkbox("Compare A, B", False, hint="Left of the line A, right of it B.")
            self._place = gui.add_slider("Line", 0.0, 1.0, 0.005, 0.5, visible=False, hint="Where the line is.")
        with gui.add_folder("Settings A" if scene else "Filter A"):
            self.left = LookPanel(gui, found, look, actions.render)
        self._right_folder = gui.add_folder("Settings B" if scene else "Filter B", visible=False)
        with self._right_folder:
            self.right = LookPanel(gui, found, other, actions.render)
        self._accumulate: Any = None
        self._adapt: Any = None
        if scene:
            with gui.add_folder("Pace"):
                self._accumulate = gui.add_checkbox(
                    "Accumulate when still", True, hint="Average the frames of a camera that stands still."
                )
                if not fixed_size:
                    self._adapt = gui.add_checkbox(
                        "Fewer pixels in motion",
                        True,
                        hint="Lower the resolution of a moving camera to keep responding.",
                    )
        save = gui.add_button_group(
            "Save", ("EXR", "PNG"), hint="EXR: linear radiance of A and guides. PNG: the picture that is shown."
        )
        self._connect(reset, save)

    @property
    def view(self) -> str:
        """What is shown, a key of `VIEWS`."""
        return _find_key(VIEWS, self._view.value)

    @property
    def stops(self) -> float:
        """Exposure, base-2 logarithm."""
        return float(self._stops.value)

    @property
    def wipe(self) -> float | None:
        """Where the line is, None without a wipe."""
        return float(self._place.value) if self._wiped.value else None

    @property
    def accumulate(self) -> bool:
        """Whether frames of a camera that stands still are averaged."""
        return self._accumulate is not None and bool(self._accumulate.value)

    @property
    def adapt(self) -> bool:
        """Whether resolution may be lowered."""
        return self._adapt is not None and bool(self._adapt.value)

    def set_stops(self, stops: float) -> None:
        """Show an exposure that was chosen."""
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
        for handle in (self._accumulate, self._adapt):
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


def _find_key(names: dict[str, str], value: str) -> str:
    return next(key for key, name in names.items() if name == value)
