"""Checks of the noise: pixels may share it, as after a wide pixel filter, or a denoiser may have removed it already."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.checks.finding import Finding
from lobewise.records.frame import FloatArray, Frame

TILE_SIDE, SMALL_TILE_SIDE = 32, 16
"""Pixels along a side of a tile, and of a tile of a small frame."""
MAX_TILES, MIN_TILES = 64, 6
"""Largest number of measured tiles, and the number that a check needs."""
MIN_SHARE_INSIDE_SURFACE = 0.2
"""Share of a tile's pixels that must lie inside a surface."""
MAX_GUIDE_STEP = 0.03
"""Largest difference between the guides of neighbours on one surface."""
MIN_BRIGHTNESS = 0.02
"""Compressed brightness, in [0, 1), below which a pixel is not measured."""
MIN_ALBEDO = 0.02
"""Albedo of all lobes up to which a pixel shows a lamp or the sky, or scatters too little to be measured."""
MAX_UNSCATTERED_SHARE = 0.5
"""Share of emission and background in the light of a pixel from which on their lack of noise would count."""
MAX_CORRELATION_OF_INDEPENDENT = -0.605
"""Correlation of neighbouring second differences, of the lowest tenth of the tiles. Up to this value pixels are
independent: theory says -2/3. Textures and shadows raise the correlation in some tiles, a filter raises it in all."""
MAX_CORRELATION_SPREAD = 0.25
"""Median minus lowest tenth of the tiles' correlations. From this value on, changing light is the cause."""
MIN_CORRELATION_OF_SHARED = -0.62
"""Correlation of the lowest tile of all. Above this value a filter is the cause."""
MIN_CORRELATION_OF_DENOISED = -0.3
"""Correlation of the lowest quarter of the tiles. Above this value a denoiser is the cause, if the sample count is
unknown."""
MIN_NOISE_OF_SAMPLE, MIN_NOISE = 0.034, 0.02
"""Relative noise above which pixels share noise of samples: times the root of the sample count, and if the count is
unknown."""
MAX_NOISE_OF_DENOISED, MAX_NOISE_OF_DENOISED_SAMPLE = 0.007, 0.03
"""Relative noise of the noisiest tenth of the tiles up to which a denoiser is the cause: without a sample count, and
times the root of the count. A backdrop before a lamp has as little noise, a whole frame does not."""
MIN_TILES_OF_DENOISED = 12
"""Tiles that a denoised image needs: a small or cropped frame may show nothing but such a backdrop."""
MIN_NOISE_OVER_SHADOWS = 0.002
"""Relative noise below which shadows cannot be told from noise."""
MIN_SPP_OF_CLEAN = 1024
"""Samples per pixel from which on samples alone may leave as little noise as a denoiser."""
MEDIAN_OVER_DEVIATION = 0.6745 * 6.0**0.5
"""Median size of second differences of normally distributed noise, over the standard deviation of the noise."""

Numbers = NDArray[np.float32]


def check_noise(
    frame: Frame,
    *,
    has_normals: bool,
    has_others: bool = False,
    whole: tuple[int, int] | None = None,
) -> tuple[bool, list[Finding]]:
    """Return whether neighbouring pixels share their noise, and a finding if they do or if a denoiser ran already.

    The check measures pixels inside surfaces, whose normals and albedos equal those of their neighbours. There the
    second differences between neighbours are noise. A sky and lamps have none in any render, so they are left out.
    If pixels are independent, a second difference has the correlation -2/3 with the next one, whatever the
    distribution: ``a - 2b + c`` and ``b - 2c + d`` with independent, equal variances have the covariance -4 and the
    variance 6.

    Parameters
    ----------
    frame : Frame
        The frame as it was read.
    has_normals : bool
        Whether the file has normals. Without normals or albedos, edges and textures look like shared noise, so the
        check finds nothing.
    has_others : bool
        Whether the file has other images that may be the noisy one.
    whole : (int, int), optional
        (height, width) of the whole frame, if ``frame`` has only the rows of `list_tile_rows` of it.
    """
    if not has_normals or (frame.gbuffer.diffuse_albedo is None and frame.gbuffer.specular_albedo is None):
        return False, []
    tiles = _choose_tiles(frame.shape) if whole is None else _move_up(_choose_tiles(whole))
    guides = (frame.gbuffer.normal, frame.gbuffer.diffuse_albedo, frame.gbuffer.specular_albedo)
    known = [_cut(image, tiles) for image in guides if image is not None]
    scatters = np.stack([mark_scattering(frame, tile) for tile in tiles]) if tiles else np.zeros((0, 3, 3), np.bool_)
    correlation, noise = _measure(_cut(frame.radiance.color, tiles), known, scatters)
    if len(noise) < MIN_TILES:
        return False, []
    lowest, low, middle = np.quantile(correlation, (0.1, 0.25, 0.5))
    typical = float(np.median(noise))
    count = frame.spp
    alike = lowest > MAX_CORRELATION_OF_INDEPENDENT
    strength = typical * float(np.sqrt(count or 1))
    # A filter raises the correlation in every tile. In long renders of shadows and textures some tiles stay low.
    everywhere = (
        alike
        and correlation.min() > MIN_CORRELATION_OF_SHARED
        and middle - lowest < MAX_CORRELATION_SPREAD
        and typical > MIN_NOISE_OVER_SHADOWS
    )
    if everywhere and strength > (MIN_NOISE_OF_SAMPLE if count else MIN_NOISE):
        note = (
            "Neighbouring pixels share their noise, as with a pixel filter that spreads samples over several: the "
            "qualities balanced and high judge it two pixels apart."
        )
        return True, [Finding("noise shared by pixels", note, mended=True)]
    # A wrong alarm costs more than a missed one: the noise must be shared, and weak in all tiles.
    most = float(np.quantile(noise, 0.9))
    limit = MAX_NOISE_OF_DENOISED_SAMPLE / float(np.sqrt(count)) if count else MAX_NOISE_OF_DENOISED
    filtered = alike if count else low > MIN_CORRELATION_OF_DENOISED
    if filtered and most < limit and len(noise) >= MIN_TILES_OF_DENOISED and (count or 1) < MIN_SPP_OF_CLEAN:
        left = f"{count} samples per pixel leave" if count else "samples leave"
        beside = ", or the noisy one of the images in the file (--map color=...)" if has_others else ""
        note = (
            f"The image has noise of at most {100.0 * most:.2g} % inside surfaces, less than {left} and shared by "
            f"neighbours: it seems to be denoised already; give the noisy render{beside}."
        )
        return False, [Finding("denoised already", note, mended=False)]
    return False, []


def mark_scattering(frame: Frame, tile: tuple[slice, slice]) -> NDArray[np.bool_]:
    """Return which pixels of a tile show a surface that scatters most of the light that is seen there."""
    guides, color = frame.gbuffer, frame.radiance.color[tile]
    there = np.ones(color.shape[:2], np.bool_) if guides.normal is None else (guides.normal[tile] != 0.0).any(axis=-1)
    albedos = [image for image in (guides.diffuse_albedo, guides.specular_albedo) if image is not None]
    # The albedo for denoisers is black where the others were lifted for a division.
    albedos = albedos if guides.denoiser_albedo is None else [guides.denoiser_albedo]
    if albedos:
        there &= (np.sum([image[tile] for image in albedos], axis=0, dtype=np.float32) > MIN_ALBEDO).any(axis=-1)
    if frame.unscattered:
        exact = [image[tile] for image in frame.unscattered.values()]
        there &= np.sum(exact, axis=0, dtype=np.float32).sum(axis=-1) < MAX_UNSCATTERED_SHARE * color.sum(axis=-1)
    return np.asarray(there)


def _choose_tiles(shape: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Return tiles that are spread evenly over an image."""
    side = TILE_SIDE if min(shape) >= 4 * TILE_SIDE else SMALL_TILE_SIDE
    down, across = (size // side for size in shape)
    step = max(1, int(np.ceil(np.sqrt(down * across / MAX_TILES))))
    return [
        (slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side))
        for row in range(0, down, step)
        for column in range(row // step % 2 * (step // 2), across, step)
    ]


def list_tile_rows(shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the rows of an image, from the first to before the last, that the check of its noise reads."""
    return list(dict.fromkeys((rows.start, rows.stop) for rows, _ in _choose_tiles(shape)))


def _move_up(tiles: list[tuple[slice, slice]]) -> list[tuple[slice, slice]]:
    """Return tiles without the rows between them."""
    tops = list(dict.fromkeys(rows.start for rows, _ in tiles))
    sides = {rows.start: rows.stop - rows.start for rows, _ in tiles}
    places = {top: number * sides[top] for number, top in enumerate(tops)}
    return [(slice(places[rows.start], places[rows.start] + sides[rows.start]), across) for rows, across in tiles]


def _cut(image: FloatArray, tiles: list[tuple[slice, slice]]) -> Numbers:
    """Return the tiles of an image, (tiles, rows, columns, components)."""
    return np.stack([image[tile] for tile in tiles]) if tiles else np.zeros((0, 3, 3, 3), np.float32)


def _measure(color: Numbers, guides: list[Numbers], scatters: NDArray[np.bool_]) -> tuple[Numbers, Numbers]:
    """Return the correlation of neighbouring second differences and the relative noise of each tile with surfaces.

    Only pixels in ``scatters``, (tiles, rows, columns), are measured.

    Both are measured on brightness that is compressed to [0, 1), so that a few bright samples do not dominate.
    """
    with np.errstate(all="ignore"):
        gray = color[..., 0] + color[..., 1] + color[..., 2]
    gray = np.where(np.isfinite(gray) & (gray > 0.0), gray, np.float32(0.0))
    lit = gray[gray > 0.0]
    if not lit.size:
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    light = gray / (gray + np.median(lit))
    shown = np.where(scatters, light, np.float32(0.0))
    second, inside = _compute_differences(shown, guides)
    turned = _compute_differences(shown.swapaxes(1, 2), [guide.swapaxes(1, 2) for guide in guides])
    sums = _sum_products(second, inside) + _sum_products(*turned)
    shows = (sums[2] > MIN_SHARE_INSIDE_SURFACE * light[0].size) & (sums[1] > 0.0)
    if not shows.any():
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    sizes = np.sort(np.where(inside, np.abs(second), np.inf)[shows].reshape(int(shows.sum()), -1), axis=1)
    middle = inside[shows].sum(axis=(1, 2)) // 2
    typical = np.take_along_axis(sizes, middle[:, None], axis=1)[:, 0]
    noise = np.where(np.isfinite(typical), typical, 0.0) / MEDIAN_OVER_DEVIATION / light[shows].mean(axis=(1, 2))
    return sums[0][shows] / sums[1][shows], noise.astype(np.float32)


def _compute_differences(light: Numbers, guides: list[Numbers]) -> tuple[Numbers, NDArray[np.bool_]]:
    """Return second differences along rows, (tiles, rows, columns - 2), and whether each lies inside a surface."""
    inside = light > MIN_BRIGHTNESS
    joined = inside[..., 1:] & inside[..., :-1]
    for guide in guides:
        alike = np.abs(guide[:, :, 1:] - guide[:, :, :-1]) < MAX_GUIDE_STEP
        joined &= alike[..., 0] & alike[..., 1] & alike[..., 2]
    return light[..., 2:] - 2.0 * light[..., 1:-1] + light[..., :-2], joined[..., 1:] & joined[..., :-1]


def _sum_products(second: Numbers, inside: NDArray[np.bool_]) -> Numbers:
    """Return sums over neighbours along the rows of each tile, (3, tiles): products, squares, and number of pairs."""
    both = inside[..., 1:] & inside[..., :-1]
    first, last = second[..., 1:], second[..., :-1]
    products = np.where(both, first * last, 0.0), np.where(both, 0.5 * (first * first + last * last), 0.0), both
    return np.stack([product.sum(axis=(1, 2), dtype=np.float32) for product in products])
