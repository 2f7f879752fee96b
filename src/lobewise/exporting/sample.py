"""A small frame that goes into every export, with Python's result, which the example compares with its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.denoising.automatic import choose_beta, choose_screen_sigma, choose_tau
from lobewise.exporting.plan import FilterPlan, define_guides
from lobewise.filters.cross_filter import run_filter
from lobewise.frame import FloatArray, Frame
from lobewise.guides.lobe_fields import default_tau
from lobewise.guides.surfaces import find_places
from lobewise.io import read_frame
from lobewise.settings import DenoiseSettings

FRAME = "sample.exr"
"""A rendered frame, black outside `ROWS` and `COLUMNS`; made by `releasing/sample.py`."""
ROWS, COLUMNS = slice(256, 320), slice(304, 400)
"""Part of the frame: spheres and floor of many roughnesses, and some pixels without a specular lobe."""


@dataclass(frozen=True)
class Sample:
    """Inputs and constants by the names of arguments, and the filtered frame."""

    images: Mapping[str, NDArray[np.generic]]
    """Each of shape (height, width) or (height, width, channels), of type float32 or uint8."""
    numbers: Mapping[str, float]
    """Rounded to float32."""
    expected: FloatArray
    """The result of `lobewise.filters.cross_filter.run_filter`, (height, width, 5)."""

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
    """Filter a part of a frame that has camera, depth, normals, alphas, and diffuse and specular radiance."""
    images, numbers = _collect_images(plan, frame, part), _choose_numbers(plan, frame)
    if plan.makes_lobes:
        images |= _make_lobes(plan, images, numbers)
    else:
        images["mask"] = np.greater(images["depth"], 0.0).astype(np.uint8)
    done = run_filter(
        np.asarray(images["radiance"], np.float32),
        images["mask"] != 0,
        plan.make_features(images, numbers),
        form=plan.form,
        radius=plan.radius,
        albedo=np.asarray(images["albedo"], np.float32) if plan.albedo else None,
    )
    expected = np.dstack([done.image, done.weight_sum, done.effective_samples]).astype(np.float32)
    names = {argument.name for argument in plan.filter_arguments + plan.lobe_arguments}
    return Sample(
        {name: np.ascontiguousarray(image) for name, image in images.items() if name in names},
        {name: value for name, value in numbers.items() if name in names},
        expected,
    )


def _collect_images(plan: FilterPlan, frame: Frame, part: tuple[slice, slice]) -> dict[str, NDArray[np.generic]]:
    """Return every image that an exported function may take as an input, by the names of arguments."""
    guides, radiance, camera = frame.gbuffer, frame.radiance, frame.camera
    assert camera is not None and guides.normal is not None and guides.alpha_u is not None
    place, depth = find_places(guides, camera)
    depth, normal, alpha = depth[part].copy(), guides.normal[part], guides.alpha_u[part]
    color, albedo = radiance.diffuse, guides.diffuse_albedo
    if plan.makes_lobes:
        color, albedo = radiance.specular, guides.specular_albedo
        if guides.lobe_kind is not None:
            # The exported function gives every surface a lobe: hide the surfaces that have none.
            depth[guides.lobe_kind[part] == 0] = 0.0
    assert color is not None and albedo is not None
    return {
        "radiance": color[part],
        "albedo": albedo[part],
        "position": place[part],
        "depth": depth,
        "normal": normal,
        "alpha": alpha,
        # The frame has no brushed surface, so make every surface one.
        "alpha_u": alpha,
        "alpha_v": np.asarray(0.5 * alpha, np.float32),
        "tangent": np.cross(normal, np.array([0.3, 0.9, 0.1])).astype(np.float32),
    }


def _choose_numbers(plan: FilterPlan, frame: Frame) -> dict[str, float]:
    """Return every number that an exported function may take, by the names of arguments."""
    camera, spp = frame.require_camera("an export"), float(frame.spp or 4)
    numbers = {
        "screen_sigma": choose_screen_sigma(spp, plan.radius),
        "position_sigma": DenoiseSettings.position_sigma,
        "pixel_angle": camera.get_pixel_angle(frame.height),
        "normal_exponent": DenoiseSettings.normal_exponent,
        "beta": choose_beta(spp),
        "tau": choose_tau(spp, default_tau(camera, frame.height)),
        **{f"eye_{axis}": value for axis, value in zip("xyz", camera.position, strict=True)},
    }
    return {name: float(np.float32(value)) for name, value in numbers.items()}


def _make_lobes(
    plan: FilterPlan, images: Mapping[str, NDArray[np.generic]], numbers: Mapping[str, float]
) -> dict[str, NDArray[np.generic]]:
    """Return the outputs of the function that makes lobes, by the names of its arguments."""
    given = {
        each.name: np.asarray(images[each.name], np.float32) for each in plan.lobe_arguments if each.role == "input"
    }
    given = {{"alpha": "alpha_u"}.get(name, name): image for name, image in given.items()}
    eye = np.array([numbers[f"eye_{axis}"] for axis in "xyz"], np.float32)
    noise = np.float32(numbers["tau"]) * np.float32(numbers["tau"])
    made = engine.pixels(define_guides, given, {"eye": eye, "noise": noise}, plan.similarity, plan.lobes)
    names = [each.name for each in plan.lobe_arguments if each.role == "output"]
    return {
        name: image.view(np.uint8) if image.dtype == np.bool_ else image
        for name, image in zip(names, made, strict=True)
    }
