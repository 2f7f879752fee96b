"""A frame with every image that denoising looks at, whose pixels agree well enough to be averaged."""

import os
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.records.frame import Frame, LobeKind, Radiance
from tests.denoising.test_denoising import make_frame

BAD = {"nan": np.nan, "inf": np.inf, "negative": -1.0}


def make_scene(shape: tuple[int, int], *, halves: bool = True, apart: bool = True, seed: int = 0) -> Frame:
    """Return a glossy and rough plane with all its guides, noisy, the upper half of it brighter.

    Some pixels are bad, some show no surface, some have no specular lobe.
    """
    rng = np.random.default_rng(seed)
    height, width = shape
    plain = make_frame(shape, apart=True, seed=seed)

    def color(low: float, high: float) -> np.ndarray[Any, Any]:
        return rng.uniform(low, high, (height, width, 3))

    def vectors(spread: float) -> np.ndarray[Any, Any]:
        found = np.array([0.0, 0.6, 0.8]) + rng.normal(0.0, spread, (height, width, 3))
        return found / np.linalg.norm(found, axis=-1, keepdims=True)

    bright = np.where(np.arange(height) < height // 2, 3.0, 1.0)[:, None, None]

    def radiance() -> Radiance:
        diffuse, specular = (bright * color(0.2, 0.4) * rng.exponential(1.0, (height, width, 1)) for _ in range(2))
        return Radiance(diffuse + specular + 0.01, diffuse, specular)

    both = radiance(), radiance()
    whole = Radiance(*(0.5 * getattr(both[0], name) + 0.5 * getattr(both[1], name) for name in _PARTS))
    kind = np.where(rng.random(shape) < 0.05, int(LobeKind.NONE), int(LobeKind.GGX))
    normal, depth = vectors(0.01), np.array(plain.gbuffer.depth)
    if height * width > 2:
        normal[0, :2], depth[0, :2] = 0.0, 0.0
    guides = replace(
        plain.gbuffer,
        depth=depth,
        normal=normal,
        tangent=np.broadcast_to([1.0, 0.0, 0.0], normal.shape),
        alpha_v=np.clip(plain.gbuffer.alpha_u * 0.8, 0.0, 1.0),
        lobe_kind=kind,
        diffuse_albedo=color(0.4, 0.6),
        specular_albedo=color(0.4, 0.6),
        hit_distance=rng.uniform(1.0, 3.0, shape),
        mean_diffuse_albedo=color(0.4, 0.6),
        mean_specular_albedo=color(0.4, 0.6),
        mean_emission=color(0.0, 0.02),
        coverage=_make_coverage(shape, rng),
        blur_radius=rng.uniform(-5.0, 20.0, shape).clip(0.0).astype(np.float32),
    )
    frame = plain.with_changes(
        radiance=whole,
        gbuffer=guides,
        half_a=both[0] if halves else None,
        half_b=both[1] if halves else None,
        variance=Radiance(color(0.01, 0.1)),
    )
    return frame if apart else combine(frame)


_PARTS = ("color", "diffuse", "specular")
_OWNERS = ("radiance", "half_a", "half_b")


def _make_coverage(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray[Any, Any]:
    coverage = rng.dirichlet(np.ones(9), shape)
    coverage[rng.random(shape) < 0.5] = np.eye(9)[4]
    return coverage


def combine(frame: Frame) -> Frame:
    """Return the frame without what tells diffuse and specular radiance apart."""
    parts = {name: getattr(frame, name) for name in _OWNERS}
    return frame.with_changes(**{name: part and Radiance(part.color) for name, part in parts.items()})


def change_radiance(frame: Frame, rows: slice | list[int], columns: slice | int, value: Any) -> Frame:
    """Return the frame with another value, or what a function makes of them, at some pixels of all its radiance."""
    changed = {}
    for owner in _OWNERS:
        part = getattr(frame, owner)
        if part is None:
            continue
        images = {}
        for item in fields(part):
            image = getattr(part, item.name)
            if image is not None:
                image = np.array(image)
                image[rows, columns] = value(image[rows, columns]) if callable(value) else value
                images[item.name] = image
        changed[owner] = Radiance(**images)
    return frame.with_changes(**changed)


def assert_same_images(got: Frame, expected: Frame, rows: slice = slice(None)) -> None:
    """Raise AssertionError unless a frame is another, or some rows of it, image by image."""
    for owner in (*_OWNERS, "gbuffer", "variance"):
        one, other = getattr(got, owner), getattr(expected, owner)
        assert (one is None) == (other is None), owner
        for field in [] if one is None else one.__dataclass_fields__:
            image, whole = getattr(one, field), getattr(other, field)
            assert (image is None) == (whole is None), field
            if image is not None:
                np.testing.assert_array_equal(image, whole[rows], err_msg=f"{owner} {field}")


def compare_bands(source: Path, heights: tuple[int, ...], **settings: Any) -> tuple[lobewise.Result, set[Any]]:
    """Raise AssertionError unless bands give the file of the whole frame; return its result, and the notes of bands."""
    whole, banded = source.with_name("whole.exr"), source.with_name("bands.exr")
    tables = settings.pop("lobe_tables", None)
    frame = lobewise.read_frame(source, lobe_tables=tables)
    result, notes = lobewise.denoise(frame, **settings), set()
    lobewise.write_result(whole, result, source=source)
    for rows in heights:
        done = denoise_file(source, banded, rows=rows, lobe_tables=tables, **settings)
        assert banded.read_bytes() == whole.read_bytes(), rows
        assert done.settings == result.settings
        assert done.energy_lost == result.energy_lost
        notes.add(done.notes)
        assert done.bad_pixel_count == result.bad_pixel_count
        assert done.shape == frame.shape
        assert done.bands == -(-frame.height // rows)
    assert sorted(os.listdir(source.parent)) == ["bands.exr", "in.exr", "whole.exr"]
    return result, notes


def add_bad_pixels(frame: Frame, rows: list[int]) -> Frame:
    """Return the frame with bad pixels of every kind in some rows."""
    for number, row in enumerate(rows):
        value = list(BAD.values())[number % len(BAD)]
        frame = change_radiance(frame, [row], slice(number % 5, None, 7), value)
    return frame
