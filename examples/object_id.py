"""A feature of your own: pixels of different objects do not mix.

The frame is a wall of one lacquer on which two pictures are printed. Depth, normal and lobe are the same everywhere, so
every similarity blurs the edge between the pictures; the object id, which any renderer writes, keeps it.

    python examples/object_id.py
"""

from __future__ import annotations

import numpy as np

import lobewise
from lobewise.metrics import rel_mse


class ObjectId(lobewise.Feature):
    """Each pixel is of one object: a distribution without width, so two pixels share all of it or nothing."""

    name = "object id"

    def __init__(self, ids):
        self.ids = ids

    def get_arrays(self):
        return (self.ids,)

    def log2_similarity(self, i, j, parameters, offset, stage):
        d = i[0] - j[0]
        return -1000.0 * d * d


def make_frame(size: int = 96) -> tuple[lobewise.Frame, np.ndarray, np.ndarray]:
    """Return a noisy frame, its object ids and its true radiance."""
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:size, :size] / size
    ids = (x + 0.3 * np.sin(7.0 * y) > 0.55).astype(np.float32)
    truth = np.where(ids[..., None] > 0, (0.9, 0.5, 0.1), (0.1, 0.2, 0.6))
    noisy = truth * rng.gamma(2.0, 0.5, (size, size, 1))
    guides = lobewise.GBuffer(
        depth=np.full((size, size), 4.0),
        normal=np.broadcast_to((0.0, 0.0, 1.0), (size, size, 3)),
        alpha_u=np.full((size, size), 0.2),
    )
    camera = lobewise.Camera(position=(0, 0, 4), forward=(0, 0, -1), up=(0, 1, 0), fov_y=0.6)
    return lobewise.Frame(lobewise.Radiance(noisy), guides, camera, spp=4), ids, truth


def main() -> dict[str, tuple[float, float]]:
    """Return the error without and with the object id, by form of the filter."""
    frame, ids, truth = make_frame()
    errors = {}
    for form in ("full", "separable", "atrous"):
        plain = lobewise.denoise(frame, form=form, with_oidn=False).image
        guided = lobewise.denoise(frame, form=form, features=[ObjectId(ids)]).image
        errors[form] = rel_mse(plain, truth), rel_mse(guided, truth)
    return errors


if __name__ == "__main__":
    for form, (plain, guided) in main().items():
        print(f"{form:9} rel_mse without object id {plain:.4f}, with it {guided:.4f}")
