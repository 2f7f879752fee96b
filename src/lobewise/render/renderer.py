"""Render a scene to a `lobewise.frame.Frame`: tiles and chunks of samples, then arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lobewise.camera import Camera
from lobewise.errors import InputError, describe_problem, require_choice
from lobewise.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.motion import compute_motion
from lobewise.render.bridge import dr, mi
from lobewise.render.camera import get_camera, get_image_size
from lobewise.render.coverage import trace_coverage
from lobewise.render.gbuffer import Moves, finish_hits, finish_seen, move_back, to_image, trace_guides
from lobewise.render.materials.bsdfs import Material, list_lobe_tables, read_scene_materials
from lobewise.render.tracing.paths import PathSettings, Sums, add_samples, make_sums
from lobewise.render.variant import VARIANTS
from lobewise.sparse_frame import MOST_SCALE, SparseFrame

Progress = Callable[[int, int], None]

TILE_PIXELS = 1 << 20
"""Pixels in flight at once: about 350 MB of sums."""

CHUNK_SAMPLES = 1 << 22
"""Samples per launch: some seconds, so that progress is seen and an interrupt is heard."""

LIGHTS = {"all": 0, "indirect": 2}
"""What light can be asked for: how often it was scattered at least."""


def _check_count(name: str, value: int, lowest: int, highest: int) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not lowest <= value <= highest:
        raise InputError(
            describe_problem(
                name, expected=f"an integer from {lowest} to {highest}", got=repr(value), action="pass another"
            )
        )
    return int(value)


def _check_numbers(spp: int, seed: int, max_depth: int) -> tuple[int, int, int]:
    return (
        _check_count("spp", spp, 1, 1 << 24),
        _check_count("seed", seed, 0, (1 << 32) - 1),
        _check_count("max_depth", max_depth, 1, 1 << 16),
    )


def _find_fewest_bounces(light: str) -> int:
    return LIGHTS[require_choice("light", light, LIGHTS)]


def _check_scene(scene: Any) -> None:
    variant = mi.variant()
    if variant not in VARIANTS.values() or not isinstance(scene, mi.Scene):
        raise InputError(
            describe_problem(
                "scene",
                expected="a mitsuba.Scene of the variant " + " or ".join(VARIANTS.values()),
                got=f"a {type(scene).__name__} under the variant {variant}",
                action="call load_mitsuba() first, then load the scene",
            )
        )


def _plan_tiles(width: int, height: int) -> Iterator[tuple[int, int]]:
    count = width * height
    for start in range(0, count, TILE_PIXELS):
        yield start, min(TILE_PIXELS, count - start)


def _plan_chunks(spp: int, pixels: int) -> Iterator[tuple[int, int]]:
    step = max(1, CHUNK_SAMPLES // pixels)
    for start in range(0, spp, step):
        yield start, min(start + step, spp)


def _render_tile(
    scene: Any,
    materials: dict[int, Material],
    pixels: tuple[int, int],
    size: tuple[int, int],
    spp: int,
    seed: int,
    settings: PathSettings,
    advance: Callable[[int], None],
    **sparse: Any,
) -> Sums:
    sums = make_sums(pixels[1], settings.guides)
    for samples in _plan_chunks(spp, pixels[1]):
        sums = add_samples(
            scene, materials, sums, pixels=pixels, size=size, samples=samples, seed=seed, settings=settings, **sparse
        )
        dr.sync_thread()
        advance(pixels[1] * (samples[1] - samples[0]))
    return sums


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


def _finish_guides(sums: Sums, guides: dict[str, Any], spp: int) -> dict[str, FloatArray]:
    """Return the guides of a tile by their path in `Frame`, pixels first."""
    own = GBuffer.__dataclass_fields__
    images = {f"gbuffer.{name}": to_image(value) for name, value in guides.items() if name in own}
    images["shape"] = to_image(guides["shape"])
    images["gbuffer.hit_distance"], images["gbuffer.hit_position"] = finish_hits(sums, guides)
    images["gbuffer.hit_normal"], images["gbuffer.hit_albedo"] = finish_seen(sums, guides)
    for i, name in enumerate(("diffuse_albedo", "specular_albedo")):
        images[f"gbuffer.{name}"] = np.clip(to_image(sums.totals[2 + i]) / np.float32(spp), 0.0, 1.0)
    return images


def _finish_radiance(sums: Sums, spp: int, settings: PathSettings) -> dict[str, FloatArray]:
    """Return radiance, halves and variance of a tile by their path in `Frame`, pixels first."""
    even = [to_image(value) for value in sums.halves[:3]]
    odd = [to_image(value) for value in sums.halves[3:]]
    images: dict[str, FloatArray] = {}

    def add_parts(prefix: str, parts: list[FloatArray], count: int) -> None:
        scale = np.float32(1.0 / count)
        images[f"{prefix}.color"] = (parts[0] + parts[1] + parts[2]) * scale
        images[f"{prefix}.diffuse"] = parts[1] * scale
        images[f"{prefix}.specular"] = parts[2] * scale

    add_parts("radiance", [a + b for a, b in zip(even, odd, strict=True)], spp)
    for i, name in enumerate(("direct", "indirect")):
        # A black image would say that nothing is lit directly.
        if name == "indirect" or settings.fewest_bounces < 2:
            images[f"radiance.{name}"] = to_image(sums.totals[i]) / np.float32(spp)
    if spp > 1:
        add_parts("half_a", even, (spp + 1) // 2)
        add_parts("half_b", odd, spp // 2)
        for i, name in enumerate(("color", "diffuse", "specular")):
            images[f"variance.{name}"] = to_image(sums.squares[i]) / np.float32(spp * (spp - 1))
    return images


def _join(tiles: list[dict[str, FloatArray]], width: int, height: int) -> dict[str, FloatArray]:
    def join(name: str) -> FloatArray:
        whole = np.concatenate([tile[name] for tile in tiles])
        return whole.reshape(height, width, *whole.shape[1:])

    return {name: join(name) for name in tiles[0]}


def _select(images: dict[str, FloatArray], prefix: str) -> dict[str, FloatArray]:
    return {name.split(".", 1)[1]: value for name, value in images.items() if name.startswith(prefix + ".")}


def render_frame(
    scene: Any,
    *,
    spp: int,
    seed: int = 0,
    max_depth: int = 8,
    light: str = "all",
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
    max_depth : int
        Longest path, in vertices after the camera: 1 is light sources, 2 direct light, and so on.
    light : {"all", "indirect"}
        With "indirect" the radiance holds only what was scattered more than once: no emission that the camera sees,
        no direct light, so that color is diffuse + specular, and ``direct`` is left out. The random numbers are those
        of "all".
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
        If a number is out of range, the light or a moved shape unknown, or the sensor no plain perspective camera.
    UnsupportedBsdfError
        If the scene uses a BSDF that is not known and cannot be evaluated or sampled.
    MissingDependencyError
        If a BSDF must be fitted and SciPy is not installed.
    """
    spp, seed, max_depth = _check_numbers(spp, seed, max_depth)
    fewest = _find_fewest_bounces(light)
    _check_scene(scene)
    camera = get_camera(scene)
    materials = read_scene_materials(scene)
    size = get_image_size(scene)
    settings = PathSettings(max_depth=max_depth, light=not aov_only, fewest_bounces=fewest)
    advance = _make_advance(progress, size[0] * size[1] * spp)
    tiles = []
    with dr.suspend_grad():
        for pixels in _plan_tiles(*size):
            guides = trace_guides(scene, materials, camera, pixels=pixels, size=size)
            if coverage:
                guides |= trace_coverage(scene, materials, camera, pixels=pixels, size=size)
            sums = _render_tile(scene, materials, pixels, size, spp, seed, settings, advance)
            tiles.append({**_finish_guides(sums, guides, spp), **_finish_radiance(sums, spp, settings)})
    images = _join(tiles, *size)
    motion = {}
    if previous_camera is not None:
        before = move_back(scene, images["shape"], images["gbuffer.position"], moves or {})
        motion["motion"] = compute_motion(camera, previous_camera, before, images["gbuffer.depth"])
    tables = list_lobe_tables(materials)
    if not tables:
        del images["gbuffer.material"]
    has_halves = spp > 1 and not aov_only
    return Frame(
        radiance=Radiance(**_select(images, "radiance")),
        gbuffer=GBuffer(**_select(images, "gbuffer"), **motion),
        camera=camera,
        half_a=Radiance(**_select(images, "half_a")) if has_halves else None,
        half_b=Radiance(**_select(images, "half_b")) if has_halves else None,
        variance=Radiance(**_select(images, "variance")) if has_halves else None,
        spp=spp,
        lobe_tables=tables,
    )


def render_sparse_frame(
    scene: Any,
    *,
    spp: int,
    scale: int,
    place: tuple[int, int] = (0, 0),
    guide_spp: int = 4,
    seed: int = 0,
    max_depth: int = 8,
    light: str = "all",
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
    spp, seed, max_depth = _check_numbers(spp, seed, max_depth)
    scale = _check_count("scale", scale, 1, MOST_SCALE)
    fewest = _find_fewest_bounces(light)
    _check_scene(scene)
    size = get_image_size(scene)
    first = tuple(
        _check_count(f"place[{k}]", place[k], 0, min(scale, length) - 1) for k, length in enumerate((size[1], size[0]))
    )
    guides = render_frame(
        scene,
        spp=guide_spp,
        seed=seed if guide_seed is None else guide_seed,
        max_depth=max_depth,
        aov_only=True,
        previous_camera=previous_camera,
        moves=moves,
    )
    materials = read_scene_materials(scene)
    columns, rows = -(-(size[0] - first[1]) // scale), -(-(size[1] - first[0]) // scale)
    settings = PathSettings(max_depth=max_depth, fewest_bounces=fewest)
    advance = _make_advance(progress, columns * rows * spp)
    tiles = []
    with dr.suspend_grad():
        for pixels in _plan_tiles(columns, rows):
            sums = _render_tile(
                scene, materials, pixels, size, spp, seed, settings, advance, scale=scale, place=(first[0], first[1])
            )
            tiles.append(_finish_radiance(sums, spp, settings))
    images = _join(tiles, columns, rows)
    return SparseFrame(
        radiance=Radiance(**_select(images, "radiance")),
        gbuffer=guides.gbuffer,
        scale=scale,
        place=(first[0], first[1]),
        camera=guides.camera,
        variance=Radiance(**_select(images, "variance")) if spp > 1 else None,
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
    max_depth: int = 8,
    light: str = "all",
) -> Radiance:
    """Render the radiance of single pixels, for `lobewise.recompute`.

    Parameters
    ----------
    scene, seed, max_depth, light
        See `render_frame`; the same seed gives the same bits as there.
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
    spp, seed, max_depth = _check_numbers(spp, seed, max_depth)
    fewest = _find_fewest_bounces(light)
    _check_scene(scene)
    width, height = get_image_size(scene)
    where = np.asarray(rows), np.asarray(columns)
    whole = all(each.ndim == 1 and each.size and each.dtype.kind in "iu" for each in where)
    if not whole or where[0].size != where[1].size:
        shapes = f"{where[0].dtype} of shape {where[0].shape} and {where[1].dtype} of shape {where[1].shape}"
        raise InputError(
            describe_problem("rows and columns", expected="as many whole numbers", got=shapes, action="pass np.nonzero")
        )
    if not ((where[0] >= 0) & (where[0] < height) & (where[1] >= 0) & (where[1] < width)).all():
        raise InputError(
            describe_problem(
                "rows and columns",
                expected=f"pixels of an image of {width}x{height}",
                got=f"rows {where[0].min()} to {where[0].max()}, columns {where[1].min()} to {where[1].max()}",
                action="count both from 0",
            )
        )
    materials = read_scene_materials(scene)
    listed = mi.UInt32((where[0] * width + where[1]).astype(np.uint32))
    settings = PathSettings(max_depth=max_depth, fewest_bounces=fewest)
    advance = _make_advance(None, 0)
    tiles = []
    with dr.suspend_grad():
        for pixels in _plan_tiles(where[0].size, 1):
            sums = _render_tile(scene, materials, pixels, (width, height), spp, seed, settings, advance, listed=listed)
            tiles.append(_finish_radiance(sums, spp, settings))
    return Radiance(**_select(_join(tiles, 1, where[0].size), "radiance"))


def render_reference(
    scene: Any,
    *,
    spp: int,
    seed: int = 1000,
    max_depth: int = 8,
    light: str = "all",
    progress: Progress | None = None,
) -> Frame:
    """Render the radiance alone: faster than `render_frame`, with a tenth of the memory, for many samples.

    Parameters and errors are those of `render_frame`; any BSDF of Mitsuba will do.
    """
    spp, seed, max_depth = _check_numbers(spp, seed, max_depth)
    fewest = _find_fewest_bounces(light)
    _check_scene(scene)
    camera = get_camera(scene)
    size = get_image_size(scene)
    settings = PathSettings(max_depth=max_depth, guides=False, fewest_bounces=fewest)
    advance = _make_advance(progress, size[0] * size[1] * spp)
    tiles = []
    with dr.suspend_grad():
        for pixels in _plan_tiles(*size):
            sums = _render_tile(scene, {}, pixels, size, spp, seed, settings, advance)
            tiles.append({"color": to_image(sums.halves[0]) / np.float32(spp)})
    return Frame(radiance=Radiance(**_join(tiles, *size)), camera=camera, spp=spp)
