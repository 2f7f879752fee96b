"""The samples of indirect light as the radiance and the rays of frames."""

from __future__ import annotations

import numpy as np

from lobewise.frame import Radiance
from lobewise.render.stages import IndirectLight
from lobewise.render.tracing.own_samples import OwnLight
from lobewise.render.tracing.points import IndirectMethod
from lobewise.sparse_frame import Rays


def make_radiance(method: IndirectMethod, light: IndirectLight, shape: tuple[int, int]) -> Radiance:
    """Return the light of some pixels as an image of (rows, columns) pixels, split by lobe if the method splits it."""
    diffuse, specular = (part.reshape(*shape, 3) for part in (light.diffuse, light.specular))
    split = {} if isinstance(method, OwnLight) else {"diffuse": diffuse, "specular": specular}
    return Radiance(diffuse + specular, **split)


def make_rays(light: IndirectLight, shape: tuple[int, int]) -> Rays | None:
    """Return the weights of the rays of some pixels as an image of (rows, columns) pixels.

    There are none if the method tells none. The weight of several samples is their mean. Directions are left out: with
    the noise of one path at one of 16 pixels, they raise the error (docs/developers/research/rays.md).
    """
    if light.ray_weight is None:
        return None
    known = np.isfinite(light.ray_weight)
    return Rays(np.where(known, light.ray_weight, np.float32(1.0)).reshape(shape))
