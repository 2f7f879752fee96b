"""The frame that filters are timed on. Formulas make it at any size, the same on every machine."""

from __future__ import annotations

import numpy as np

from lobewise.features import (
    Feature,
    GgxFeature,
    GgxLobe,
    NormalFeature,
    PositionFeature,
    ScreenFeature,
    SgFeature,
    SgMixtureFeature,
)
from lobewise.guides.lobe_fields import default_tau, make_ggx_field, make_sg_field
from lobewise.guides.mixture_fields import make_mixture_field
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, LobeKind, Radiance

BETA = 8.0
"""Exponent of the weight of lobes; it does not change the times."""
SIMILARITIES = ("normal", "sg", "sg_mixture, 3 lobes", "sg_mixture, 3 coaxial", "ggx")
"""Similarities that `make_features` knows. Coaxial lobes share one axis, as lobes that approximate GGX do; lobes of
measured materials have their own axes."""


def make_frame(width: int, height: int) -> Frame:
    """Return a noisy plane, seen in perspective, whose roughness varies from patch to patch and whose normals vary."""
    rng = np.random.default_rng(0)
    camera = Camera(
        position=np.array([0.0, 2.0, 6.0]), forward=np.array([0.0, -0.4, -1.0]), up=np.array([0.0, 1.0, 0.0]), fov_y=0.7
    )
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    depth = 2.0 / np.maximum(-rays[..., 1], 0.05)
    position = camera.position + rays * depth[..., None]
    normal = np.stack(
        [0.1 * np.sin(5.0 * position[..., 0]), np.ones_like(depth), 0.1 * np.sin(4.0 * position[..., 2])], axis=-1
    )
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    patch = (np.floor(2.0 * position[..., 0]) + np.floor(2.0 * position[..., 2])) % 5.0
    alpha = (0.03 + 0.12 * patch).astype(np.float32)
    albedo = np.full((height, width, 3), 0.4, dtype=np.float32)
    color = rng.exponential(1.0, (height, width, 3)).astype(np.float32)
    half = np.float32(0.5) * color
    return Frame(
        radiance=Radiance(color=color, diffuse=half, specular=half),
        gbuffer=GBuffer(
            depth=depth.astype(np.float32),
            position=position.astype(np.float32),
            normal=normal.astype(np.float32),
            alpha_u=alpha,
            alpha_v=alpha,
            lobe_kind=np.full(depth.shape, float(LobeKind.GGX), dtype=np.float32),
            diffuse_albedo=albedo,
            specular_albedo=albedo,
        ),
        camera=camera,
        spp=4,
    )


def make_features(frame: Frame, names: tuple[str, ...] = SIMILARITIES) -> dict[str, list[Feature]]:
    """Return the features of each similarity, by its name; all share the distances on the screen and from the plane."""
    guides, camera = frame.gbuffer, frame.require_camera("the benchmark")
    position, depth = (guides.require(name, "the benchmark") for name in ("position", "depth"))
    pixel_angle = camera.get_pixel_angle(frame.height)
    place = [ScreenFeature(5.0), PositionFeature(position, depth, pixel_angle=pixel_angle, sigma=16.0)]
    features: dict[str, list[Feature]] = {}
    if "normal" in names:
        features["normal"] = [*place, NormalFeature(guides.require("normal", "the benchmark"), 64.0)]
    tau = default_tau(camera, frame.height)
    if "sg" in names:
        lobes = make_sg_field(guides, camera, tau=tau, diffuse_fallback=False)
        features["sg"] = [*place, SgFeature(lobes.axis, lobes.sharpness, BETA)]
    if any(name.startswith("sg_mixture") for name in names):
        features["sg_mixture, 3 lobes"] = [*place, make_mixture(frame, 3, coaxial=False)]
        features["sg_mixture, 3 coaxial"] = [*place, make_mixture(frame, 3, coaxial=True)]
    if "ggx" in names:
        wide = make_ggx_field(guides, camera, [tau])
        features["ggx"] = [*place, GgxFeature(GgxLobe(*wide.lobes[tau]), BETA)]
    return {name: features[name] for name in names}


def make_mixture(frame: Frame, lobes: int, *, coaxial: bool) -> Feature:
    """Return a mixture of 1 to 4 spherical Gaussians that approximates GGX.

    Without ``coaxial`` every lobe has its own axis. The axes are equal, but the kernels do not use that.
    """
    camera = frame.require_camera("the benchmark")
    field = make_mixture_field(frame.gbuffer, camera, tau=default_tau(camera, frame.height), lobes=lobes)
    axis = field.axis if coaxial else np.tile(field.axis, (1, 1, lobes))
    return SgMixtureFeature(axis, field.sharpness, field.amplitude, BETA)
