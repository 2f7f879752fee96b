"""A small frame that an export brings along, with what Python makes of it: the example compares with that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.pointwise import run_pointwise
from lobewise.denoising.automatic import choose_beta, choose_screen_sigma, choose_tau
from lobewise.exporting.plan import FilterPlan, define_guides
from lobewise.filters.cross_filter import run_filter
from lobewise.frame import FloatArray, Frame
from lobewise.guides.surfaces import find_places
from lobewise.io import read_frame
from lobewise.lobes.band_limit import default_tau

FRAME = "showroom-4spp.exr"
ROWS, COLUMNS = slice(256, 320), slice(304, 400)
"""Part of the frame: spheres and floor of many roughnesses, some pixels without a specular lobe."""
POSITION_SIGMA, NORMAL_EXPONENT = 16.0, 64.0


@dataclass(frozen=True)
class Sample:
    """Inputs and constants by the names of arguments, and the filtered frame."""

    images: Mapping[str, NDArray[np.generic]]
    """Each (height, width) or (height, width, channels); float32 or uint8."""
    numbers: Mapping[str, float]
    """Rounded to float32."""
    expected: FloatArray
    """What `lobewise.filters.cross_filter.run_filter` gives, (height, width, 5)."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width)."""
        return int(self.expected.shape[0]), int(self.expected.shape[1])


def make_sample(plan: FilterPlan) -> Sample:
    """Return part of the frame inside the package, filtered by the kernels of this process."""
    with as_file(files("lobewise") / "data" / FRAME) as path:
        frame = read_frame(path)
    return filter_sample(plan, frame, (ROWS, COLUMNS))


def filter_sample(plan: FilterPlan, frame: Frame, part: tuple[slice, slice]) -> Sample:
    """Return a part of a frame, which has camera, depth, normals, alphas and both radiances, filtered."""
    guides, radiance, camera = frame.gbuffer, frame.radiance, frame.camera
    assert camera is not None and guides.normal is not None and guides.alpha_u is not None
    assert radiance.specular is not None and radiance.diffuse is not None
    images: dict[str, NDArray[np.generic]] = {}
    place, depth = find_places(guides, camera)
    images["position"], images["depth"] = place[part], depth[part].copy()
    images["normal"], alpha = guides.normal[part], guides.alpha_u[part]
    if plan.makes_lobes:
        color, albedo = radiance.specular, guides.specular_albedo
        if guides.lobe_kind is not None:
            # The exported function takes every surface to have a lobe.
            images["depth"][guides.lobe_kind[part] == 0] = 0.0
    else:
        color, albedo = radiance.diffuse, guides.diffuse_albedo
    assert albedo is not None
    images["radiance"], images["albedo"] = color[part], albedo[part]
    images["alpha"] = images["alpha_u"] = alpha
    # The frame has no brushed surface: it is given one.
    images["alpha_v"] = np.asarray(0.5 * alpha, np.float32)
    images["tangent"] = np.cross(images["normal"], np.array([0.3, 0.9, 0.1])).astype(np.float32)

    spp = float(frame.spp or 4)
    pixel_angle = camera.get_pixel_angle(frame.height)
    numbers = {
        "screen_sigma": choose_screen_sigma(spp, plan.radius),
        "position_sigma": POSITION_SIGMA,
        "pixel_angle": pixel_angle,
        "normal_exponent": NORMAL_EXPONENT,
        "beta": choose_beta(spp),
        "tau": choose_tau(spp, default_tau(camera, frame.height)),
        **{f"eye_{axis}": value for axis, value in zip("xyz", camera.position, strict=True)},
    }
    numbers = {name: float(np.float32(value)) for name, value in numbers.items()}
    arguments = plan.filter_arguments + plan.lobe_arguments
    if plan.makes_lobes:
        images |= _make_lobes(plan, images, numbers)
    else:
        images["mask"] = np.greater(images["depth"], 0.0).astype(np.uint8)
    mask = images["mask"] != 0
    features = plan.make_features(images, numbers)
    done = run_filter(
        color[part],
        mask,
        features,
        form=plan.form,
        radius=plan.radius,
        albedo=albedo[part] if plan.albedo else None,
    )
    expected = np.dstack([done.image, done.weight_sum, done.effective_samples]).astype(np.float32)
    names = {argument.name for argument in arguments}
    return Sample(
        {name: np.ascontiguousarray(image) for name, image in images.items() if name in names},
        {name: value for name, value in numbers.items() if name in names},
        expected,
    )


def _make_lobes(
    plan: FilterPlan, images: Mapping[str, NDArray[np.generic]], numbers: Mapping[str, float]
) -> dict[str, NDArray[np.generic]]:
    """Return what the function that makes lobes gives, by the names of its arguments."""
    given = {
        each.name: np.asarray(images[each.name], np.float32) for each in plan.lobe_arguments if each.role == "input"
    }
    given = {{"alpha": "alpha_u"}.get(name, name): image for name, image in given.items()}
    eye = np.array([numbers[f"eye_{axis}"] for axis in "xyz"], np.float32)
    noise = np.float32(numbers["tau"]) * np.float32(numbers["tau"])
    made = run_pointwise(define_guides, given, {"eye": eye, "noise": noise}, plan.similarity, plan.lobes)
    names = [each.name for each in plan.lobe_arguments if each.role == "output"]
    return {
        name: image.view(np.uint8) if image.dtype == np.bool_ else image
        for name, image in zip(names, made, strict=True)
    }
