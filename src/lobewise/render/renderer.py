"""Render a scene to a `lobewise.frame.Frame`: tiles and chunks of samples, then arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.camera import Camera
from lobewise.errors import InputError, require_choice, require_integer
from lobewise.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.motion import compute_motion
from lobewise.render.bridge import dr, mi
from lobewise.render.camera import get_camera, get_image_size, has_lens
from lobewise.render.coverage import trace_coverage
from lobewise.render.gbuffer import Moves, move_back, trace_guides
from lobewise.render.images import finish_guides, finish_radiance, join, select, to_image
from lobewise.render.integrators import Light, check_scene, plan_light, require_paths
from lobewise.render.materials.bsdfs import list_lobe_tables, read_scene_materials
from lobewise.render.own_light import forget_lobes_of_media, render_lens_guides, render_own
from lobewise.render.tracing.paths import PathSettings, add_samples
from lobewise.render.tracing.samples import Sums, make_sums
from lobewise.sparse_frame import MAX_SCALE, SparseFrame

Progress = Callable[[int, int], None]

TILE_PIXELS = 1 << 20
"""Pixels in flight at once: about 350 MB of sums."""

CHUNK_SAMPLES = 1 << 22
"""Samples per launch: some seconds, so that progress is seen and an interrupt is heard."""

GUIDE_SAMPLES = 32
"""Samples, at most, of guides that are averages beside light of a scene's own integrator."""

LIGHTS = {"all": 0, "indirect": 2}
"""What light can be asked for: how often it was scattered at least."""


def _cut(length: int, step: int) -> Iterator[tuple[int, int]]:
    """Yield begin and end of the pieces of a length."""
    for start in range(0, length, step):
        yield start, min(start + step, length)


def _make_advance(progress: Progress | None, total: int) -> Callable[[int], None]:
    done = 0

    def advance(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None:
            progress(done, total)

    if progress is not None:
        progress(0, total)
    return advance


class _Pass:
    """One pass over the samples of a scene, tile by tile; see `render_frame`, and `PathSettings` for the settings."""

    def __init__(self, scene: Any, *, spp: int, seed: int, max_depth: int, light: str, **settings: Any) -> None:
        self.spp = require_integer("spp", spp, 1, 1 << 24)
        self._seed = require_integer("seed", seed, 0, (1 << 32) - 1)
        fewest = LIGHTS[require_choice("light", light, LIGHTS)]
        self.scene = scene
        self.settings = PathSettings(max_depth=max_depth, fewest_bounces=fewest, **settings)
        self.size = get_image_size(scene)
        self.materials = read_scene_materials(scene) if self.settings.guides else {}

    @property
    def has_light(self) -> bool:
        """Whether there is radiance, and not only guides."""
        return self.settings.radiance

    def run(
        self,
        columns: int,
        rows: int,
        finish: Callable[[tuple[int, int], Sums], dict[str, FloatArray]],
        progress: Progress | None = None,
        **where: Any,
    ) -> dict[str, FloatArray]:
        """Return the images, (rows, columns, ...), that ``finish`` makes of the sums of each run of pixels.

        ``where`` tells which pixels of the image are meant, as `add_samples` takes it.
        """
        advance = _make_advance(progress, columns * rows * self.spp)
        tiles = []
        with dr.suspend_grad():
            for start, end in _cut(columns * rows, TILE_PIXELS):
                pixels = start, end - start
                tiles.append(finish(pixels, self._sum_tile(pixels, advance, where)))
        return join(tiles, columns, rows)

    def _sum_tile(self, pixels: tuple[int, int], advance: Callable[[int], None], where: dict[str, Any]) -> Sums:
        sums = make_sums(pixels[1], self.settings.guides)
        for samples in _cut(self.spp, max(1, CHUNK_SAMPLES // pixels[1])):
            part = {"pixels": pixels, "size": self.size, "samples": samples, "seed": self._seed, **where}
            sums = add_samples(self.scene, self.materials, sums, settings=self.settings, **part)
            dr.sync_thread()
            advance(pixels[1] * (samples[1] - samples[0]))
        return sums

    def finish_radiance(self, _: tuple[int, int], sums: Sums) -> dict[str, FloatArray]:
        """Return the radiance of a run of pixels."""
        return finish_radiance(sums, self.spp, self.settings.fewest_bounces < 2)


def render_frame(
    scene: Any,
    *,
    spp: int,
    seed: int = 0,
    max_depth: int | None = None,
    light: str = "all",
    integrator: str = "auto",
    aov_only: bool = False,
    coverage: bool = True,
    previous_camera: Camera | None = None,
    moves: Moves | None = None,
    progress: Progress | None = None,
) -> Frame:
    """Render a scene with all that a denoiser may want to know, in one pass over the samples.

    Pixels are box filtered and independent. The radiance is told apart by the lobe of its first scattering (emission
    that the camera sees directly, or through a mask, is in neither ``diffuse`` nor ``specular``), and by their number:
    ``direct`` was scattered once, ``indirect`` more often. Refraction counts as specular. Which guides are averages
    and which belong to the pixel-centre ray is told in `lobewise.render.gbuffer`.

    Parameters
    ----------
    scene : mitsuba.Scene
        From `load_scene`, or loaded with a variant that `load_mitsuba` set. Its first sensor is used; of its film
        only the size.
    spp : int
        Samples per pixel. With one sample there are no halves and no variance.
    seed : int
        The same seed gives the same bits, whatever the number of threads.
    max_depth : int, optional
        Longest path, in vertices after the camera: 1 is light sources, 2 direct light, and so on; by default that of
        the scene's integrator, or 8 without one.
    light : {"all", "indirect"}
        With "indirect" the radiance holds only what was scattered more than once: no emission that the camera sees,
        no direct light, so that color is diffuse + specular, and ``direct`` is left out. The random numbers are those
        of "all".
    integrator : {"auto", "paths", "scene"}
        Whose light: "paths" are those told above, "scene" is the scene's own integrator, and "auto" takes paths where
        they estimate the same light. That of an own integrator (participating media, light traced from the lamps ...)
        is one image, with halves but without parts and variance.
    aov_only : bool
        Leave the radiance out (it is all zero) and compute the guides alone.
    coverage : bool
        Whether the G-buffer holds what each pixel's area shows: ``coverage`` and the ``mean_`` images. They take 16
        more rays of the camera per pixel and no samples.
    previous_camera : Camera, optional
        Camera of the frame before; with it the G-buffer holds ``motion``.
    moves : mapping of str to array_like, shape (4, 4), optional
        With ``previous_camera``: where shapes came from, by their id. The matrix takes a world point of the shape to
        where the frame before had it; shapes that are not named stood still.
    progress : callable, optional
        Called with ``(done, total)`` samples, from 0 to the total.

    Raises
    ------
    InputError
        If a number is out of range, the light or a moved shape unknown, the sensor no plain perspective camera, or the
        scene's integrator makes no image of light.
    UnsupportedBsdfError
        If the scene uses a BSDF that is not known and cannot be evaluated or sampled.
    MissingDependencyError
        If a BSDF must be fitted and SciPy is not installed.
    """
    check_scene(scene)
    lens = has_lens(scene)
    alone = aov_only and not lens
    plan = plan_light(scene, "paths" if alone else integrator, None if aov_only and lens else max_depth)
    guided: dict[str, Any] = {"coverage": coverage, "previous_camera": previous_camera, "moves": moves}
    if plan.lens:
        moved = previous_camera is not None
        guides = render_lens_guides(scene, samples=min(spp, GUIDE_SAMPLES), seed=seed, moved=moved)
        return guides if aov_only else _add_own_light(guides, scene, plan, spp, seed, light, progress)
    if plan.own is not None:
        guides = render_frame(scene, spp=min(spp, GUIDE_SAMPLES), seed=seed, aov_only=True, **guided)
        guides = forget_lobes_of_media(scene, guides)
        return _add_own_light(guides, scene, plan, spp, seed, light, progress)
    settings: dict[str, Any] = {"spp": spp, "seed": seed, "max_depth": plan.max_depth, "light": light}
    return _render_by_paths(_Pass(scene, radiance=not aov_only, **settings), progress, **guided)


def _render_by_paths(
    run: _Pass, progress: Progress | None, *, coverage: bool, previous_camera: Camera | None, moves: Moves | None
) -> Frame:
    """Return the frame of one pass over the samples."""
    scene, spp = run.scene, run.spp
    camera = get_camera(scene)

    def finish(pixels: tuple[int, int], sums: Sums) -> dict[str, FloatArray]:
        guides = trace_guides(scene, run.materials, camera, pixels=pixels, size=run.size)
        if coverage:
            guides |= trace_coverage(
                scene, run.materials, camera, pixels=pixels, size=run.size, emission=not run.settings.fewest_bounces
            )
        return finish_guides(sums, guides, spp) | run.finish_radiance(pixels, sums)

    images = run.run(*run.size, finish, progress)
    motion = {}
    if previous_camera is not None:
        before = move_back(scene, images["shape"], images["gbuffer.position"], moves or {})
        motion["motion"] = compute_motion(camera, previous_camera, before, images["gbuffer.depth"])
    tables = list_lobe_tables(run.materials)
    if not tables:
        del images["gbuffer.material"]
    parts = ("half_a", "half_b", "variance") if spp > 1 and run.has_light else ()
    frame = Frame(
        radiance=Radiance(**select(images, "radiance")),
        gbuffer=GBuffer(**select(images, "gbuffer"), **motion),
        camera=camera,
        spp=spp,
        lobe_tables=tables,
    )
    return frame.with_changes(**{name: Radiance(**select(images, name)) for name in parts}) if parts else frame


def _add_own_light(
    guides: Frame, scene: Any, plan: Light, spp: int, seed: int, light: str, progress: Progress | None
) -> Frame:
    """Return a frame with the light of a scene's own integrator."""
    return guides.with_changes(spp=spp, **_render_own(scene, plan, spp, seed, light, progress))


def _render_own(
    scene: Any, plan: Light, spp: int, seed: int, light: str, progress: Progress | None
) -> dict[str, Radiance]:
    """Return the images of a scene's own integrator by their names in `Frame`."""
    if require_choice("light", light, LIGHTS) != "all":
        action = "leave it out, or ask for integrator 'paths'"
        raise InputError("light", expected="'all' beside a scene's own integrator", got=repr(light), action=action)
    require_integer("spp", spp, 1, 1 << 24)
    require_integer("seed", seed, 0, (1 << 32) - 1)
    width, height = get_image_size(scene)
    advance = _make_advance(progress, width * height * spp)
    return render_own(scene, plan.own, spp=spp, seed=seed, advance=advance)


def render_sparse_frame(
    scene: Any,
    *,
    spp: int,
    scale: int,
    place: tuple[int, int] = (0, 0),
    guide_spp: int = 4,
    seed: int = 0,
    max_depth: int | None = None,
    light: str = "all",
    integrator: str = "auto",
    guide_seed: int | None = None,
    previous_camera: Camera | None = None,
    moves: Moves | None = None,
    progress: Progress | None = None,
) -> SparseFrame:
    """Render the radiance of one pixel of every block, and the guides of all, for `lobewise.upsample`.

    The radiance is that of `render_frame` at the shaded pixels, bit for bit.

    Parameters
    ----------
    scene, seed, max_depth, light, previous_camera, moves
        See `render_frame`.
    integrator : {"auto", "paths"}
        With "auto" the light must be that of the scene's integrator.
    spp : int
        Samples of a shaded pixel.
    scale : int
        Pixels from shaded pixel to shaded pixel, 1 to 16.
    place : (int, int)
        Row and column of the shaded pixel within each block.
    guide_spp : int
        Samples of every pixel for the guides that are averages over samples: albedos and hits. They follow no light.
    guide_seed : int, optional
        Seed of those samples; by default ``seed``. Guides that share it agree from frame to frame while nothing moves.
    progress : callable, optional
        Called with ``(done, total)`` samples that carry light.

    Raises
    ------
    InputError
        If a number is out of range, the light or a moved shape unknown, or the sensor no plain perspective camera.
    UnsupportedBsdfError
        If the scene uses a BSDF that is not known and cannot be evaluated or sampled.
    MissingDependencyError
        If a BSDF must be fitted and SciPy is not installed.
    """
    depth = require_paths(scene, "sparse frames", integrator, max_depth).max_depth
    run = _Pass(scene, spp=spp, seed=seed, max_depth=depth, light=light)
    scale = require_integer("scale", scale, 1, MAX_SCALE)
    width, height = run.size
    row, column = (
        require_integer(f"place[{k}]", place[k], 0, min(scale, length) - 1) for k, length in enumerate((height, width))
    )
    asked: dict[str, Any] = {
        "spp": guide_spp,
        "seed": seed if guide_seed is None else guide_seed,
        "max_depth": max_depth,
    }
    guides = render_frame(scene, **asked, aov_only=True, previous_camera=previous_camera, moves=moves)
    columns, rows = -(-(width - column) // scale), -(-(height - row) // scale)
    images = run.run(columns, rows, run.finish_radiance, progress, scale=scale, place=(row, column))
    return SparseFrame(
        radiance=Radiance(**select(images, "radiance")),
        gbuffer=guides.gbuffer,
        scale=scale,
        place=(row, column),
        camera=guides.camera,
        variance=Radiance(**select(images, "variance")) if spp > 1 else None,
        spp=spp,
        lobe_tables=guides.lobe_tables,
    )


def render_pixels(
    scene: Any,
    rows: ArrayLike,
    columns: ArrayLike,
    *,
    spp: int,
    seed: int = 0,
    max_depth: int | None = None,
    light: str = "all",
    integrator: str = "auto",
) -> Radiance:
    """Render the radiance of single pixels, for `lobewise.recompute`.

    Parameters
    ----------
    scene, seed, max_depth, light, integrator
        See `render_sparse_frame`; the same seed gives the same bits as there.
    rows, columns : array_like of int, shape (count,)
        The pixels, at least one.
    spp : int
        Samples of each.

    Returns
    -------
    Radiance
        Of shape (count, 1): color, diffuse, specular, direct, indirect of each pixel in turn.

    Raises
    ------
    InputError
        If a number is out of range, the light unknown, or a pixel lies outside the image.
    """
    depth = require_paths(scene, "single pixels", integrator, max_depth).max_depth
    run = _Pass(scene, spp=spp, seed=seed, max_depth=depth, light=light)
    listed = _number_pixels(np.asarray(rows), np.asarray(columns), run.size)
    images = run.run(1, len(listed), run.finish_radiance, listed=mi.UInt32(listed))
    return Radiance(**select(images, "radiance"))


def _number_pixels(rows: NDArray[Any], columns: NDArray[Any], size: tuple[int, int]) -> NDArray[np.uint32]:
    """Return the numbers of pixels, row-major."""
    where, (width, height) = (rows, columns), size
    whole = all(each.ndim == 1 and each.size and each.dtype.kind in "iu" for each in where)
    if not whole or rows.size != columns.size:
        shapes = f"{rows.dtype} of shape {rows.shape} and {columns.dtype} of shape {columns.shape}"
        raise InputError("rows and columns", expected="as many whole numbers", got=shapes, action="pass np.nonzero")
    if not ((rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)).all():
        expected = f"pixels of an image of {width}x{height}"
        got = f"rows {rows.min()} to {rows.max()}, columns {columns.min()} to {columns.max()}"
        raise InputError("rows and columns", expected=expected, got=got, action="count both from 0")
    return np.asarray(rows * width + columns, dtype=np.uint32)


def render_reference(
    scene: Any,
    *,
    spp: int,
    seed: int = 1000,
    max_depth: int | None = None,
    light: str = "all",
    integrator: str = "auto",
    progress: Progress | None = None,
) -> Frame:
    """Render the radiance alone: faster than `render_frame`, with a tenth of the memory, for many samples.

    Parameters and errors are those of `render_frame`; any BSDF of Mitsuba will do.
    """
    plan = plan_light(scene, integrator, max_depth)
    if plan.own is not None:
        images = _render_own(scene, plan, spp, seed, light, progress)
        return Frame(radiance=images["radiance"], camera=get_camera(scene, lens=True), spp=spp)
    run = _Pass(scene, spp=spp, seed=seed, max_depth=plan.max_depth, light=light, guides=False)

    def finish(_: tuple[int, int], sums: Sums) -> dict[str, FloatArray]:
        return {"color": to_image(sums.even.emitted) / np.float32(spp)}

    return Frame(radiance=Radiance(**run.run(*run.size, finish, progress)), camera=get_camera(scene), spp=spp)
