"""Indirect light from virtual lights, also known as instant radiosity: the same few lights serve all pixels.

Source: Keller 1997, "Instant Radiosity"; interleaved sampling by Keller and Heidrich 2001; bounded geometry terms by
Kollig and Keller 2006, "Illumination in the Presence of Weak Singularities"; spheres in place of points by Hasan,
Krivanek, Walter and Bala 2009, "Virtual Spherical Lights for Many-Light Rendering of Glossy Scenes".
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lobewise.errors import InputError, name_value, require_choice, require_integer
from lobewise.render.bridge import dr, mi
from lobewise.render.camera import get_image_size
from lobewise.render.materials.bsdfs import Material
from lobewise.render.tracing.points import Indirect, Points, average_samples
from lobewise.render.tracing.rays import make_opaque
from lobewise.render.virtual_lights.gaussian_lighting import GaussianLighting
from lobewise.render.virtual_lights.gaussian_walk import GaussianWalk
from lobewise.render.virtual_lights.light_paths import LightPaths, LightSet, measure_sphere
from lobewise.render.virtual_lights.point_walk import PointWalk
from lobewise.render.virtual_lights.shading import Lighting

MAX_PATHS = 1 << 20
"""Largest number of light paths."""
MAX_DEPTH = 64
"""Longest path from the camera to the emitter, vertices after the camera."""
MAX_CLUSTER_SIZE = 256
"""Largest number of lights of a cluster."""
DEFAULT_PATHS = {"points": 1024, "gaussians": 16384}
"""Number of light paths by the kind of lights."""
WORTH = {"points": 4.0, "gaussians": 4.0}
"""Variance of one path over that of one sample, by the kind of lights. Median over pixels in three built-in scenes: for
points 1.7 to 39 for diffuse light, 1.5 to 6 for specular light; for clusters 4.3 to 22 over diffuse and 1.9 to 18 over
glossy surfaces."""


class VirtualLights:
    """Lights at the hits of quasi-random light paths, which light the points through visibility rays.

    Light from an emitter by mirrors or smooth glass alone (a caustic seen directly) is missing, because no light can
    lie on a mirror. Rays from smooth mirrors and glass are followed to the next other surface, which is also lit
    directly.

    The kind "points" differs from paths in two more ways. A light nearer than the clamp is darker, so corners are too
    dark, unless ``compensate`` adds the missing light by short rays. The error of a small number of lights is not noise
    but blotches, the same in all pixels, and spikes on glossy surfaces.

    The kind "gaussians" (Tokuyoshi 2015) joins neighbouring lights to clusters that light diffuse and glossy surfaces
    in closed form. A cluster has neither spikes nor a singularity; its light is a little too dark near corners, and
    details smaller than a cluster are blurred in reflections. Lobes below
    `lobewise.render.virtual_lights.gaussian_walk.MIN_ALPHA`, and those of rough glass, are followed like mirrors.
    Glossy light through rough glass leaves no virtual light.

    Parameters
    ----------
    scene : mitsuba.Scene
    materials : dict
        Materials of the scene; see `lobewise.render.materials.bsdfs.read_scene_materials`.
    kind : {"points", "gaussians"}
        Whether lights act as points (or spheres) or in clusters.
    count : int, optional
        Number of light paths, 1 to 2^20. Each leaves a light at every surface that it hits, except on mirrors. By
        default 1024, or 16384 for clusters.
    max_depth : int
        Longest path from the camera to the emitter, vertices after the camera, 3 to 64.
    clamp : float
        For points: distance from a light, over the diagonal of the scene's bounding box, 0 to 1. The geometry term is
        limited to its inverse square. With 0 there is no limit, and single lights dominate corners.
    compensate : bool
        For points: whether rays of the points' own BSDF add the clamped light: unbiased, with a little noise in
        corners. Has no effect on spheres, or without a clamp.
    radius : float
        For points: radius of spheres that replace the point lights, over the same diagonal, 0 to 1. With 0 lights are
        points. Spheres ignore ``clamp``.
    cluster_size : int
        For clusters: largest number of lights of one, 1 to 256.
    seed : int
        Seed of the light paths.

    Raises
    ------
    InputError
        If a number is out of range, if ``compensate`` or ``radius`` is given for clusters, or if no emitter of the
        scene emits light.
    """

    name = "virtual_lights"

    def __init__(
        self,
        scene: Any,
        materials: dict[int, Material],
        *,
        kind: str = "points",
        count: int | None = None,
        max_depth: int = 8,
        clamp: float = 0.05,
        compensate: bool = False,
        radius: float = 0.0,
        cluster_size: int = 8,
        seed: int = 0,
    ) -> None:
        require_choice("kind", kind, tuple(DEFAULT_PATHS))
        if count is None:
            count = DEFAULT_PATHS[kind]
        require_integer("count", count, 1, MAX_PATHS)
        require_integer("max_depth", max_depth, 3, MAX_DEPTH)
        require_integer("cluster_size", cluster_size, 1, MAX_CLUSTER_SIZE)
        require_integer("seed", seed, 0, (1 << 32) - 1)
        _require_part("clamp", clamp)
        _require_part("radius", radius)
        self._has_clusters = kind == "gaussians"
        if self._has_clusters and (compensate or radius > 0.0):
            got = "compensate" if compensate else f"radius {radius}"
            raise InputError("kind", expected='"points" with compensate or radius', got=got, action='use kind="points"')
        self._scene = scene
        self._materials = materials
        self._max_depth = max_depth
        self._clamp = clamp
        self._radius = radius
        self._compensates = compensate and clamp > 0.0 and radius == 0.0
        self._cluster_size = cluster_size
        self._paths = LightPaths(scene, count, max_depth - 2, seed)
        self.update()

    def update(self) -> None:
        """Trace the lights again after a change of the scene, without compiling again."""
        self._lights = self._paths.trace()
        self._numbers = {
            "number": dr.opaque(mi.UInt32, self._lights.number),
            "max_depth": dr.opaque(mi.UInt32, self._max_depth),
            # If the size of the film changes later, only the spread of runs over pixels gets less even.
            "width": dr.opaque(mi.UInt32, get_image_size(self._scene)[0]),
        }
        self._walk: PointWalk | GaussianWalk = self._make_cluster_walk() if self._has_clusters else self._make_walk()

    def _make_walk(self) -> PointWalk:
        _, half_diagonal = measure_sphere(self._scene)
        shortest, radius = 2.0 * self._clamp * half_diagonal, 2.0 * self._radius * half_diagonal
        lighting = Lighting(self._scene, self._materials, self._lights, shortest=shortest, radius=radius)
        return PointWalk(self._scene, self._materials, lighting, self._numbers, compensates=self._compensates)

    def _make_cluster_walk(self) -> GaussianWalk:
        lighting = GaussianLighting(self._scene, self._materials, self._lights, size=self._cluster_size)
        return GaussianWalk(self._scene, self._materials, lighting, self._numbers)

    @property
    def worth(self) -> float:
        """See `lobewise.render.tracing.points.IndirectMethod`; measured in docs/developers/virtual_lights.md."""
        return WORTH["gaussians" if self._has_clusters else "points"]

    @property
    def state(self) -> Any:
        """See `lobewise.render.tracing.points.IndirectMethod`."""
        return self._numbers, self._walk.state

    @property
    def lights(self) -> LightSet:
        """The set of lights."""
        return self._lights

    def shade(self, points: Points, *, samples: Any, seed: Any, all_lights: bool = False) -> Indirect:
        """Return the light of some or all lights; see `lobewise.render.tracing.points.IndirectMethod`.

        A sample of points takes one run of about `lobewise.render.virtual_lights.point_walk.LIGHTS_PER_SAMPLE` lights,
        in the order of their paths. Its weight makes the mean over seeds the sum over all lights. Neighbouring pixels
        and successive frames take runs far apart. A sample of clusters takes
        `lobewise.render.virtual_lights.gaussian_walk.CLUSTERS_PER_SAMPLE`, each drawn with a probability near its share
        of the light and weighted by its inverse. With ``all_lights`` each sample takes all lights or clusters. Only
        mirrors and smooth glass have a hit distance, others have 0.
        """
        end, seed_value = make_opaque(samples), make_opaque(seed)
        return average_samples(lambda index: self._walk.take(points, index, end, seed_value, all_lights), end)

    def get_band_limit(self, points: Points, samples: int) -> float:
        """Return `compute_sharpness_limit` of the lights that points see, radians; 0 for clusters, which have no
        spikes."""
        if self._has_clusters:
            return 0.0
        return compute_sharpness_limit(self.count_lights_seen(points, samples=samples))

    def count_lights_seen(self, points: Points, *, samples: int = 1, all_lights: bool = False) -> float:
        """Return the effective number of lights that a pixel sees, for `compute_sharpness_limit`.

        It is ``(sum L_k)^2 / sum L_k^2`` with the light ``L_k`` of each light at a point, median over points. Hidden,
        distant or averted lights count little. BSDFs and cosines of the points are left out. Some hundred lit points
        are enough. ``samples`` and ``all_lights`` are those of `shade`. InputError for clusters.
        """
        if isinstance(self._walk, GaussianWalk):
            raise InputError("kind", expected='"points"', got='"gaussians"', action="clusters need no band-limit")
        worth = np.asarray(self._walk.count_worth(points, make_opaque(samples), all_lights))
        lit = worth[np.asarray(points.active) & (worth > 0.0)]
        return float(np.median(lit)) if lit.size else 1.0


def compute_sharpness_limit(lights: float) -> float:
    """Return the band-limit tau (radians) of lobes that are lit by a number of lights, for `lobewise.denoise`.

    Each light takes ``2 pi / lights`` steradians of a receiver's hemisphere. A lobe of sharpness ``lambda`` covers
    ``4 pi / lambda`` steradians (``(int G)^2 / int G^2`` of its spherical Gaussian), so it sees ``2 lights / lambda``
    lights. Lobes sharper than ``lambda = 2 lights`` see less than one light: they are dark, or show its spike. After
    convolution with a Gaussian of ``tau^2 = 1 / (2 lights)`` no lobe is sharper. `VirtualLights.count_lights_seen`
    counts the lights; InputError if the number is not above 0.
    """
    if not (math.isfinite(lights) and lights > 0.0):
        raise InputError("lights", expected="a number above 0", got=name_value(lights), action="count those of a pixel")
    return min(1.0 / math.sqrt(2.0 * lights), 1.0)


def _require_part(name: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value <= 1.0:
        expected = "a fraction of the scene's diagonal, 0 to 1"
        raise InputError(name, expected=expected, got=name_value(value), action="0.05 is usual")
