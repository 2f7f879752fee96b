"""Fixtures that several rooms' tests use: seeded random numbers, a frame with every image, real EXR files."""

import os
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main

from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.lobe_table import LobeTable


@pytest.fixture(scope="session", autouse=True)
def _one_command() -> Iterator[None]:
    """Let Typer make the program's command once. Every call of the program makes it anew, which takes 0.1 s."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", cache(typer.main.get_command))
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """Return random numbers that are the same in every run."""
    return np.random.default_rng(20150915)


@pytest.fixture(scope="session")
def exr_folder() -> Path:
    """Return the folder of real EXR files, or skip and say how to get it."""
    return locate_data("exr")


@pytest.fixture(scope="session")
def field_folder() -> Path:
    """Return the folder of small inputs that once came out wrong, or skip and say how to get it."""
    return locate_data("field")


def locate_data(name: str) -> Path:
    """Return a folder of the test data, or skip the test and say how to get it."""
    root = os.environ.get("LOBEWISE_TEST_DATA")
    if not root:
        pytest.skip("set LOBEWISE_TEST_DATA to a folder with exr/: docs/developers/conventions.md lists its files")
    folder = Path(root) / name
    if not folder.is_dir():
        pytest.fail(f"LOBEWISE_TEST_DATA is {root!r}, which has no folder {name}/")
    return folder


@pytest.fixture(scope="session")
def mi() -> Any:
    """Return Mitsuba with its LLVM variant set, or skip and say why not; where CI is set that is a failure."""
    from lobewise.errors import MissingDependencyError
    from lobewise.render import load_mitsuba

    try:
        return load_mitsuba("cpu")
    except MissingDependencyError as error:
        if os.environ.get("CI"):
            pytest.fail(f"CI must render: {error}")
        pytest.skip(str(error))


@pytest.fixture
def make_frame(rng: np.random.Generator) -> Callable[..., Frame]:
    """Return a function of height and width that makes a frame with every image."""
    return partial(_make_random_frame, rng)


@pytest.fixture
def full_frame(make_frame: Callable[..., Frame]) -> Frame:
    """Return a frame of 13x9 pixels with every image that a frame can have, random and consistent in size only."""
    return make_frame(height=9, width=13)


def _make_random_frame(rng: np.random.Generator, *, height: int, width: int) -> Frame:
    """Return a frame with every image, for tests of plumbing rather than of pictures."""

    def color() -> np.ndarray:
        return rng.gamma(0.5, 1.0, (height, width, 3)).astype(np.float32)

    def radiance() -> Radiance:
        return Radiance(color=color(), diffuse=color(), specular=color(), direct=color(), indirect=color())

    def vector(length: int) -> np.ndarray:
        return rng.normal(size=(height, width, length)).astype(np.float32)

    def plane() -> np.ndarray:
        return rng.random((height, width)).astype(np.float32)

    return Frame(
        radiance=radiance(),
        gbuffer=GBuffer(
            depth=1.0 + plane(),
            position=vector(3),
            normal=vector(3),
            tangent=vector(3),
            alpha_u=plane(),
            alpha_v=plane(),
            lobe_kind=rng.integers(0, 4, (height, width)),
            diffuse_albedo=rng.random((height, width, 3)),
            specular_albedo=rng.random((height, width, 3)),
            hit_distance=plane(),
            hit_position=vector(3),
            mean_normal=vector(3),
            mean_diffuse_albedo=rng.random((height, width, 3)),
            mean_specular_albedo=rng.random((height, width, 3)),
            denoiser_albedo=rng.random((height, width, 3)),
            denoiser_normal=vector(3),
            mean_emission=rng.random((height, width, 3)),
            coverage=rng.multinomial(16, np.full(9, 1 / 9), (height, width)) / 16,
            blur_radius=rng.integers(0, 17, (height, width)) / 2,
            motion=vector(2),
            reflected_motion=vector(3),
            material=np.arange(height * width).reshape(height, width) % 3,
        ),
        camera=Camera(position=(1.0, 2.0, 0.1), forward=(0.0, -0.3, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7, fov_x=0.9),
        half_a=radiance(),
        half_b=radiance(),
        variance=radiance(),
        spp=4,
        lobe_tables=(make_lobe_table("first", 1), make_lobe_table("second", 2)),
    )


def make_lobe_table(name: str, lobes: int) -> LobeTable:
    """Return an isotropic table of two views whose lobes lie about the mirror direction."""
    cosine = np.array([0.4, 1.0])
    axis = np.stack([-np.sqrt(1.0 - cosine**2), 0.0 * cosine, cosine], axis=-1)
    return LobeTable(
        name=name,
        kind="sg",
        cosine=cosine,
        azimuth=[0.0],
        axis=np.tile(axis[:, None, None], (1, 1, lobes, 1)),
        sharpness=np.full((2, 1, lobes, 2), 30.0 / lobes),
        twist=np.zeros((2, 1, lobes)),
        amplitude=np.full((2, 1, lobes), 0.1),
        alpha=np.full((2, 1, 2), 0.2),
        albedo=np.full((2, 1, 3), 0.7),
        cosine_l2=np.full((2, 1), 0.99),
    )
