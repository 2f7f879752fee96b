"""Whether an image's noise is that of samples: as strong as their number says, and every pixel's its own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray, Frame
from lobewise.interchange.checks.finding import Finding

TILE = 32
SMALL_TILE = 16
"""Pixels along a side of the tiles that are looked at, and in small frames."""
MOST_TILES, FEWEST_TILES = 64, 6
FEWEST_PAIRS = 0.2
"""Share of a tile's pixels that must lie inside a surface."""
SAME = 0.03
"""Difference between the guides of neighbours on one surface."""
LIT = 0.02
"""Brightness, over itself plus the image's median, below which a pixel tells nothing."""
INDEPENDENT = -0.605
"""Correlation between neighbouring second differences, of the lowest tenth of the tiles, up to which pixels are
independent: for those it is -2/3; texture and shadows raise it in some tiles, a filter in all."""
SCATTERED = 0.25
"""Difference of that of the middle tile from which on light that changes is the cause, and no filter."""
LEAST_SHARED = -0.62
"""That of the lowest tile of all, above which a filter is the cause."""
SMOOTH = -0.3
"""That of the lowest quarter from which on a denoiser is the cause, where the number of samples is not known."""
STRONG, STRONG_ALONE = 0.034, 0.02
"""Noise over brightness that samples leave: times the root of their number, and where that is not known."""
MAX_NOISE_OF_DENOISED, MAX_NOISE_OF_DENOISED_SAMPLE = 0.007, 0.03
"""The same of the noisiest tenth of the tiles, up to which a denoiser is the cause: of the image, where the number of
samples is not known, else times its root. A backdrop before a lamp has as little noise, a whole frame not."""
MIN_TILES_OF_DENOISED = 12
"""Tiles below which a small or cropped frame may show such a backdrop only."""
FAINTEST = 0.002
"""Noise over brightness below which shadows look like it."""
MANY = 1024
"""Samples per pixel from which on noise may be as little as after denoising."""
MEDIAN_SIZE = 0.6745 * 6.0**0.5
"""The median size of second differences of normally distributed noise, over its standard deviation."""

Numbers = NDArray[np.float32]


def check_noise(frame: Frame, *, has_normals: bool) -> tuple[bool, list[Finding]]:
    """Return whether neighbouring pixels share their noise, and what was found: that, or that it is denoised already.

    Looked at are pixels inside surfaces: where normals and albedos are those of their neighbours. There second
    differences between neighbours are noise. Those of independent pixels have a correlation of -2/3 with the next
    (of ``a - 2b + c`` and ``b - 2c + d`` with independent, equal variances: -4 to 6), whatever the noise looks like.

    Parameters
    ----------
    frame : Frame
        As it was read.
    has_normals : bool
        Whether they are the file's. Without them or without albedos, edges or textures look like noise that pixels
        share, so nothing is told.
    """
    if not has_normals or (frame.gbuffer.diffuse_albedo is None and frame.gbuffer.specular_albedo is None):
        return False, []
    tiles = _choose_tiles(frame.shape)
    guides = (frame.gbuffer.normal, frame.gbuffer.diffuse_albedo, frame.gbuffer.specular_albedo)
    known = [_cut(image, tiles) for image in guides if image is not None]
    correlation, noise = _measure(_cut(frame.radiance.color, tiles), known)
    if len(noise) < FEWEST_TILES:
        return False, []
    lowest, low, middle = np.quantile(correlation, (0.1, 0.25, 0.5))
    typical = float(np.median(noise))
    count = frame.spp
    alike = lowest > INDEPENDENT
    strength = typical * float(np.sqrt(count or 1))
    # A filter raises it in every tile; where long renders leave little but shadows and textures, some still tell.
    everywhere = alike and correlation.min() > LEAST_SHARED and middle - lowest < SCATTERED and typical > FAINTEST
    if everywhere and strength > (STRONG if count else STRONG_ALONE):
        told = (
            "Neighbouring pixels share their noise, as with a pixel filter that spreads samples over several: the "
            "qualities balanced and high judge it two pixels apart."
        )
        return True, [Finding("noise shared by pixels", told, mended=True)]
    # A wrong alarm costs more than none: what is left must be the noise of a filter, and weak wherever it is looked at.
    most = float(np.quantile(noise, 0.9))
    limit = MAX_NOISE_OF_DENOISED_SAMPLE / float(np.sqrt(count)) if count else MAX_NOISE_OF_DENOISED
    filtered = alike if count else low > SMOOTH
    if filtered and most < limit and len(noise) >= MIN_TILES_OF_DENOISED and (count or 1) < MANY:
        left = f"{count} samples per pixel leave" if count else "samples leave"
        told = (
            f"The image has noise of at most {100.0 * most:.2g} % inside surfaces, less than {left} and shared by "
            "neighbours: it seems to be denoised already; give the noisy one (--map color=...)."
        )
        return False, [Finding("denoised already", told, mended=False)]
    return False, []


def _choose_tiles(shape: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Return tiles that are spread evenly over an image."""
    side = TILE if min(shape) >= 4 * TILE else SMALL_TILE
    down, across = (size // side for size in shape)
    step = max(1, int(np.ceil(np.sqrt(down * across / MOST_TILES))))
    return [
        (slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side))
        for row in range(0, down, step)
        for column in range(row // step % 2 * (step // 2), across, step)
    ]


def _cut(image: FloatArray, tiles: list[tuple[slice, slice]]) -> Numbers:
    """Return the tiles of an image, (tiles, rows, columns, components)."""
    return np.stack([image[tile] for tile in tiles]) if tiles else np.zeros((0, 3, 3, 3), np.float32)


def _measure(color: Numbers, guides: list[Numbers]) -> tuple[Numbers, Numbers]:
    """Return for each tile that shows enough of surfaces the correlation of neighbouring second differences, and noise.

    Noise is that over brightness; both are of brightness compressed to [0, 1), so that a few samples are not all of it.
    """
    with np.errstate(all="ignore"):
        gray = color[..., 0] + color[..., 1] + color[..., 2]
    gray = np.where(np.isfinite(gray) & (gray > 0.0), gray, np.float32(0.0))
    lit = gray[gray > 0.0]
    if not lit.size:
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    light = gray / (gray + np.median(lit))
    second, inside = _find_differences(light, guides)
    turned = _find_differences(light.swapaxes(1, 2), [guide.swapaxes(1, 2) for guide in guides])
    sums = _sum_products(second, inside) + _sum_products(*turned)
    shows = (sums[2] > FEWEST_PAIRS * light[0].size) & (sums[1] > 0.0)
    if not shows.any():
        return np.zeros(0, np.float32), np.zeros(0, np.float32)
    sizes = np.sort(np.where(inside, np.abs(second), np.inf)[shows].reshape(int(shows.sum()), -1), axis=1)
    middle = inside[shows].sum(axis=(1, 2)) // 2
    typical = np.take_along_axis(sizes, middle[:, None], axis=1)[:, 0]
    noise = np.where(np.isfinite(typical), typical, 0.0) / MEDIAN_SIZE / light[shows].mean(axis=(1, 2))
    return sums[0][shows] / sums[1][shows], noise.astype(np.float32)


def _find_differences(light: Numbers, guides: list[Numbers]) -> tuple[Numbers, NDArray[np.bool_]]:
    """Return second differences along rows, (tiles, rows, columns - 2), and where they are inside a surface."""
    inside = light > LIT
    joined = inside[..., 1:] & inside[..., :-1]
    for guide in guides:
        alike = np.abs(guide[:, :, 1:] - guide[:, :, :-1]) < SAME
        joined &= alike[..., 0] & alike[..., 1] & alike[..., 2]
    return light[..., 2:] - 2.0 * light[..., 1:-1] + light[..., :-2], joined[..., 1:] & joined[..., :-1]


def _sum_products(second: Numbers, inside: NDArray[np.bool_]) -> Numbers:
    """Return for each tile sums over neighbours along rows, (3, tiles): of products, of squares, and their number."""
    both = inside[..., 1:] & inside[..., :-1]
    first, last = second[..., 1:], second[..., :-1]
    products = np.where(both, first * last, 0.0), np.where(both, 0.5 * (first * first + last * last), 0.0), both
    return np.stack([product.sum(axis=(1, 2), dtype=np.float32) for product in products])
