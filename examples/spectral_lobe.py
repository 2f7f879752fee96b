"""A feature of your own: what each pixel emits, as a distribution over wavelength.

The frame is a chart of fluorescent inks on one sheet: the same depth, normal and lobe everywhere. Each ink re-emits
around one wavelength, in a band of some width; two inks are as alike as these bands overlap.

    python examples/spectral_lobe.py
"""

from __future__ import annotations

import numpy as np

import lobewise
from lobewise.backend.expressions import log2
from lobewise.metrics import rel_mse


class SpectralLobe(lobewise.Feature):
    """A Gaussian over wavelength, mean m and standard deviation s in nanometres.

    ``S = sqrt(2 si sj / (si^2 + sj^2)) exp(-(mi - mj)^2 / (2 (si^2 + sj^2)))``, to the power beta.
    """

    name = "spectral lobe"
    neutral = (550.0, 50.0)

    def __init__(self, mean, deviation, beta=4.0):
        self.mean, self.deviation, self.beta = mean, deviation, beta

    def get_arrays(self):
        return self.mean, self.deviation

    def get_parameters(self):
        return 0.5 * self.beta, 0.5 * self.beta / np.log(2.0)

    def log2_similarity(self, i, j, parameters, offset, stage):
        (mi, si), (mj, sj) = i, j
        both = si * si + sj * sj
        return parameters[0] * log2(2.0 * si * sj / both) - parameters[1] * (mi - mj) * (mi - mj) / both


def make_frame(size: int = 96) -> tuple[lobewise.Frame, np.ndarray, np.ndarray, np.ndarray]:
    """Return a noisy frame, the means and deviations of its inks, and its true radiance."""
    rng = np.random.default_rng(2)
    patch = np.add.outer(4 * (np.arange(size) * 4 // size), np.arange(size) * 4 // size)
    mean = rng.uniform(460.0, 640.0, 16).astype(np.float32)[patch]
    deviation = rng.uniform(15.0, 50.0, 16).astype(np.float32)[patch]
    # A camera of three Gaussian bands sees the overlap of each with the ink.
    bands, width = np.array([610.0, 550.0, 465.0]), 40.0
    spread = deviation[..., None] ** 2 + width**2
    truth = width / np.sqrt(spread) * np.exp(-0.5 * (mean[..., None] - bands) ** 2 / spread) + 0.02
    noisy = truth * rng.gamma(2.0, 0.5, (size, size, 1))
    guides = lobewise.GBuffer(
        depth=np.full((size, size), 4.0),
        normal=np.broadcast_to((0.0, 0.0, 1.0), (size, size, 3)),
        alpha_u=np.full((size, size), 0.3),
    )
    camera = lobewise.Camera(position=(0, 0, 4), forward=(0, 0, -1), up=(0, 1, 0), fov_y=0.6)
    return lobewise.Frame(lobewise.Radiance(noisy), guides, camera, spp=4), mean, deviation, truth


def main() -> dict[str, tuple[float, float]]:
    """Return the error without and with the spectral lobe, by form of the filter."""
    frame, mean, deviation, truth = make_frame()
    errors = {}
    for form in ("full", "separable", "atrous"):
        plain = lobewise.denoise(frame, form=form, with_oidn=False).image
        guided = lobewise.denoise(frame, form=form, features=[SpectralLobe(mean, deviation)]).image
        errors[form] = rel_mse(plain, truth), rel_mse(guided, truth)
    return errors


if __name__ == "__main__":
    for form, (plain, guided) in main().items():
        print(f"{form:9} rel_mse without spectral lobe {plain:.4f}, with it {guided:.4f}")
