"""Renders a scene to a `lobewise.records.frame.Frame`, in tiles of pixels and chunks of samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lobewise.errors import InputError, name_value, require_choice, require_integer
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import SparseFrame
from lobewise.render.bridge import dr, mi
from lobewise.render.camera import get_camera, get_image_size, has_lens
from lobewise.render.coverage import trace_coverage
from lobewise.render.gbuffer import Moves, add_motion, trace_guides
from lobewise.render.images import finish_guides, finish_radiance, join, number_pixels, select, to_image
from lobewise.render.integrators import LIGHTS, Light, check_scene, plan_light, plan_pixels
from lobewise.render.materials.bsdfs import list_lobe_tables, read_scene_materials
from lobewise.render.own_light import check_own, forget_lobes_of_media, render_lens_guides, render_own, sample_pixels
from lobewise.render.tracing.paths import PathSettings, add_samples
from lobewise.render.tracing.samples import Sums, make_sums
from lobewise.scenes.limits import FRAME_BYTES_PER_PIXEL, RADIANCE_BYTES_PER_PIXEL, require_memory
from lobewise.settings.choices import MAX_SCALE_PIXELS

Progress = Callable[[int, int], None]

TILE_PIXELS = 1 << 20
"""Pixels rendered at once. Their sums take about 350 MB."""

CHUNK_SAMPLES = 1 << 22
"""Samples per launch. A launch takes some seconds, so that progress is reported and interrupts are handled."""

PART_STEP = 0x9E3779B1
"""Step of the seed from part to part of a pixel's samples: 2^32 over the golden ratio."""

GUIDE_SAMPLES = 32
"""Largest number of samples per pixel for the guides if the scene's own integrator renders the light."""


def _cut(length: int, step: int) -> Iterator[tuple[int, int]]:
    """Yield begin and end of successive pieces of a length."""
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
    """One pass of the path tracer over the samples of a scene, tile by tile; ``settings`` go to `PathSettings`."""

    def __init__(self, scene: Any, *, spp: int, seed: int, max_depth: int, light: str, **settings: Any) -> None:
        self.spp = require_integer("spp", spp, 1, 1 << 24)
        self._seed = require_integer("seed", seed, 0, (1 << 32) - 1)
        min_bounces = LIGHTS[require_choice("light", light, LIGHTS)]
        self.scene = scene
        self.settings = PathSettings(max_depth=max_depth, min_bounces=min_bounces, **settings)
        self.size = get_image_size(scene)
        self.materials = read_scene_materials(scene) if self.settings.guides else {}

    def run(
        self,
        columns: int,
        rows: int,
        finish: Callable[[tuple[int, int], Sums], dict[str, FloatArray]],
        progress: Progress | None = None,
        **where: Any,
    ) -> dict[str, FloatArray]:
        """Return the images, (rows, columns, ...), that ``finish`` makes from the sums of each run of pixels.

        ``where`` chooses the pixels of the image; see `add_samples`.
        """
        require_memory(columns, rows, FRAME_BYTES_PER_PIXEL if self.settings.guides else RADIANCE_BYTES_PER_PIXEL)
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
        return finish_radiance(sums, self.spp, self.settings.min_bounces < 2)


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
    """Render a scene with all images that help a denoiser, in one pass over the samples.

    Pixels are box filtered and independent. The radiance is split by the lobe of its first scattering into ``diffuse``
    and ``specular`` (refraction counts as specular; emission that the camera sees, directly or through a mask, is in
    neither), and by the number of scatterings into ``direct`` (one) and ``indirect`` (more). `lobewise.render.gbuffer`
    says which guides are means and which belong to the ray through the pixel's centre.

    Parameters
    ----------
    scene : mitsuba.Scene
        From `load_scene`, or loaded with a variant that `load_mitsuba` set. Its first sensor is used, but only the size
        of the film.
    spp : int
        Samples per pixel. With one sample there are no halves and no variance.
    seed : int
        The same seed gives the same bits, whatever the number of threads.
    max_depth : int, optional
        Longest path, vertices after the camera: 1 shows light sources, 2 adds direct light, and so on. By default that
        of the scene's integrator, or 8 without one.
    light : {"all", "indirect"}
        "indirect" keeps only light that was scattered more than once; ``color`` is then diffuse + specular and there is
        no ``direct``. The random numbers do not change.
    integrator : {"auto", "paths", "scene"}
        "paths" renders the light described above, "scene" that of the scene's own integrator (participating media,
        light traced from the lamps ...): one image, with halves but without parts and variance. "auto" chooses paths if
        they estimate the light of the scene's own integrator.
    aov_only : bool
        Compute only the guides; the radiance is 0.
    coverage : bool
        Whether the G-buffer describes each pixel's area by ``coverage`` and the ``mean_`` images. They take 16 more
        camera rays per pixel and no samples.
    previous_camera : Camera, optional
        Camera of the previous frame; with it the G-buffer holds ``motion``, and with ``moves`` ``reflected_motion``.
    moves : mapping of str to array_like, shape (4, 4), optional
        With ``previous_camera``: for each moved shape, by its id, the matrix that maps its world points to their
        positions in the previous frame.
    progress : callable, optional
        Called with ``(done, total)`` samples, from 0 to the total.

    Raises
    ------
    InputError
        If a number is out of range, the image does not fit the memory of the machine, the light or a moved shape is
        unknown, the sensor is not a plain perspective camera, or the scene's integrator makes no image of light.
    UnsupportedBsdfError
        If a BSDF is unknown and cannot be evaluated or sampled.
    MissingDependencyError
        If a BSDF must be fitted and SciPy is not installed.
    """
    check_scene(scene)
    lens = has_lens(scene)
    alone = aov_only and not lens
    plan = plan_light(scene, "paths" if alone else integrator, None if aov_only and lens else max_depth)
    guided: dict[str, Any] = {"coverage": coverage, "previous_camera": previous_camera, "moves": moves}
    if plan.lens:
        require_memory(*get_image_size(scene), FRAME_BYTES_PER_PIXEL)
        moved = previous_camera is not None
        guides = render_lens_guides(scene, samples=min(spp, GUIDE_SAMPLES), seed=seed, moved=moved)
        if aov_only:
            return guides
    elif plan.own is not None:
        guides = render_frame(scene, spp=min(spp, GUIDE_SAMPLES), seed=seed, aov_only=True, **guided)
        guides = forget_lobes_of_media(scene, guides)
    else:
        settings: dict[str, Any] = {"spp": spp, "seed": seed, "max_depth": plan.max_depth, "light": light}
        return _render_by_paths(_Pass(scene, radiance=not aov_only, **settings), progress, **guided)
    return guides.with_changes(spp=spp, **_render_own(scene, plan, spp, seed, light, progress))


def _render_by_paths(
    run: _Pass, progress: Progress | None, *, coverage: bool, previous_camera: Camera | None, moves: Moves | None
) -> Frame:
    """Return the frame of one pass of the path tracer."""
    scene, spp = run.scene, run.spp
    camera = get_camera(scene)

    def finish(pixels: tuple[int, int], sums: Sums) -> dict[str, FloatArray]:
        guides = trace_guides(scene, run.materials, camera, pixels=pixels, size=run.size)
        if coverage:
            guides |= trace_coverage(
                scene, run.materials, camera, pixels=pixels, size=run.size, emission=not run.settings.min_bounces
            )
        return finish_guides(sums, guides, spp) | run.finish_radiance(pixels, sums)

    images = run.run(*run.size, finish, progress)
    tables = list_lobe_tables(run.materials)
    if not tables:
        del images["gbuffer.material"]
    gbuffer = GBuffer(**select(images, "gbuffer"))
    if previous_camera is not None:
        seen = images["seen_shape"], images["seen_distance"]
        gbuffer = add_motion(scene, gbuffer, images["shape"], seen, (camera, previous_camera), moves or {})
    parts = ("half_a", "half_b", "variance") if spp > 1 and run.settings.radiance else ()
    frame = Frame(
        radiance=Radiance(**select(images, "radiance")),
        gbuffer=gbuffer,
        camera=camera,
        spp=spp,
        lobe_tables=tables,
    )
    return frame.with_changes(**{name: Radiance(**select(images, name)) for name in parts}) if parts else frame


def _render_own(
    scene: Any, plan: Light, spp: int, seed: int, light: str, progress: Progress | None
) -> dict[str, Radiance]:
    """Return the images of a scene's own integrator by their names in `Frame`."""
    check_own(spp, seed, light)
    width, height = get_image_size(scene)
    require_memory(width, height, RADIANCE_BYTES_PER_PIXEL)
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
    """Render the radiance of one pixel of every block, and the guides of all pixels, for `lobewise.upsample`.

    Shaded pixels have the bits of `render_frame`, unless the scene's own integrator renders the light.

    Parameters
    ----------
    scene, seed, max_depth, light, previous_camera, moves
        See `render_frame`.
    integrator : {"auto", "paths", "scene"}
        See `render_frame`. The scene's own integrator must render single rays, as all of Mitsuba's but ``ptracer`` do.
    spp : int
        Samples of a shaded pixel.
    scale : int
        Distance between shaded pixels, pixels, 1 to 16.
    place : (int, int)
        Row and column of the shaded pixel within each block.
    guide_spp : int
        Samples of every pixel for the guides that are means over samples: albedos and hits.
    guide_seed : int, optional
        Seed of the guides' samples; by default ``seed``. With one seed, guides do not change while nothing moves.
    progress : callable, optional
        Called with ``(done, total)`` samples of shaded pixels.

    Raises
    ------
    InputError, UnsupportedBsdfError, MissingDependencyError
        See `render_frame`.
    """
    plan = plan_pixels(scene, "sparse frames", integrator, max_depth)
    scale = require_integer("scale", scale, 1, MAX_SCALE_PIXELS)
    width, height = get_image_size(scene)
    row, column = (
        require_integer(f"place[{k}]", place[k], 0, min(scale, length) - 1) for k, length in enumerate((height, width))
    )
    guided: dict[str, Any] = {
        # The means over a lens take many rays.
        "spp": max(guide_spp, GUIDE_SAMPLES) if plan.lens else guide_spp,
        "seed": seed if guide_seed is None else guide_seed,
        "max_depth": max_depth,
    }
    guides = render_frame(scene, **guided, aov_only=True, previous_camera=previous_camera, moves=moves)
    if plan.own is not None and not plan.lens:
        guides = forget_lobes_of_media(scene, guides)
    columns, rows = -(-(width - column) // scale), -(-(height - row) // scale)
    light_of: dict[str, Any] = {"spp": spp, "seed": seed, "light": light}
    if plan.own is not None:
        pixels = np.add.outer(np.arange(row, height, scale) * width, np.arange(column, width, scale))
        advance = _make_advance(progress, pixels.size * spp)
        sampled = sample_pixels(scene, plan, pixels.ravel().astype(np.uint32), **light_of, advance=advance)
        images = {
            f"{name}.color": value.reshape(rows, columns, 3)
            for name, value in (("radiance", sampled.color), ("variance", sampled.variance))
            if value is not None
        }
    else:
        run = _Pass(scene, max_depth=plan.max_depth, **light_of)
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
    parts: int = 1,
) -> Radiance:
    """Render the radiance of single pixels, for `lobewise.recompute`.

    Parameters
    ----------
    scene, seed, max_depth, light, integrator
        See `render_sparse_frame`. The same seed gives the same bits.
    rows, columns : array_like of int, shape (count,)
        The pixels, at least one.
    spp, parts : int
        Samples per pixel, and the number of images that they are divided among, a divisor of ``spp``.

    Returns
    -------
    Radiance
        Images of shape (count, parts), one row per pixel: color, diffuse, specular, direct, indirect.

    Raises
    ------
    InputError
        If a number is out of range, the light is unknown, or a pixel lies outside the image.
    """
    if parts < 1 or spp % parts:
        raise InputError("parts", expected=f"a divisor of {spp} spp", got=name_value(parts), action="pass another")
    plan = plan_pixels(scene, "single pixels", integrator, max_depth)
    listed = number_pixels(np.asarray(rows), np.asarray(columns), get_image_size(scene))
    images = []
    for part in range(parts):
        drawn: dict[str, Any] = {"spp": spp // parts, "seed": (seed + part * PART_STEP) % (1 << 32), "light": light}
        if plan.own is not None:
            images.append({"color": sample_pixels(scene, plan, listed, **drawn).color[:, None]})
            continue
        run = _Pass(scene, max_depth=plan.max_depth, **drawn)
        images.append(select(run.run(1, len(listed), run.finish_radiance, listed=mi.UInt32(listed)), "radiance"))
    return Radiance(**{name: np.concatenate([each[name] for each in images], axis=1) for name in images[0]})


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
    """Render only the radiance, for many samples: faster than `render_frame`, with a tenth of the memory.

    Parameters and errors are those of `render_frame`. Any BSDF of Mitsuba works.
    """
    plan = plan_light(scene, integrator, max_depth)
    if plan.own is not None:
        images = _render_own(scene, plan, spp, seed, light, progress)
        return Frame(radiance=images["radiance"], camera=get_camera(scene, lens=True), spp=spp)
    run = _Pass(scene, spp=spp, seed=seed, max_depth=plan.max_depth, light=light, guides=False)

    def finish(_: tuple[int, int], sums: Sums) -> dict[str, FloatArray]:
        return {"color": to_image(sums.even.emitted) / np.float32(spp)}

    return Frame(radiance=Radiance(**run.run(*run.size, finish, progress)), camera=get_camera(scene), spp=spp)
