"""The mixtures of an image against the functions of one point, and the laws of the whole image."""

from dataclasses import replace

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.fitting.arrays import normalize
from lobewise.fitting.table import evaluate_table
from lobewise.guides.mixture_fields import make_mixture_field
from lobewise.records.camera import Camera
from lobewise.records.frame import GBuffer, LobeKind
from lobewise.records.lobe_table import LobeTable
from lobewise.work import chunks
from tests.conftest import make_lobe_table
from tests.lobes.oracles.mixture import make_ggx_mixture, make_lambert_lobe
from tests.lobes.oracles.sg import sg_integral
from tests.mistakes import refuses

TAU = 0.01
SHAPE = (9, 13)
SINGLE = 2e-5
"""Relative: float32."""


@pytest.fixture
def camera() -> Camera:
    return Camera(position=(0.0, 0.0, 5.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7)


@pytest.fixture
def guides() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    return {
        "position": np.stack([*rng.uniform(-1.0, 1.0, (2, *SHAPE)), np.zeros(SHAPE)], axis=-1),
        "normal": normalize(rng.normal(size=(*SHAPE, 3)) * 0.3 + np.array([0.0, 0.0, 1.0])),
        "alpha_u": rng.uniform(0.05, 0.9, SHAPE),
        "lobe_kind": np.full(SHAPE, float(LobeKind.GGX)),
        "diffuse_albedo": rng.uniform(0.0, 1.0, (*SHAPE, 3)),
        "specular_albedo": rng.uniform(0.1, 1.0, (*SHAPE, 3)),
    }


def make_table(name: str, sharpness: float) -> LobeTable:
    """Return an isotropic table of two round lobes."""
    widths = np.broadcast_to(np.array([sharpness, 3.0])[:, None], (2, 1, 2, 2))
    return replace(make_lobe_table(name, 2), sharpness=widths, amplitude=np.broadcast_to([2.0, 0.3], (2, 1, 2)))


def compute_views(guides, camera):
    return normalize(camera.position - guides["position"])


def weigh(albedo):
    return albedo @ np.array([0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("lobes", [1, 2, 3, 4])
def test_ggx_pixels_have_the_mixture_of_a_point(guides, camera, lobes):
    field = make_mixture_field(GBuffer(**guides), camera, tau=TAU, lobes=lobes)
    albedo = weigh(guides["specular_albedo"])
    point = make_ggx_mixture(
        compute_views(guides, camera), guides["normal"], guides["alpha_u"], lobes=lobes, albedo=albedo, tau=TAU
    )
    assert field.valid.all()
    np.testing.assert_allclose(field.axis, point.axis[..., 0, :], atol=1e-6)
    np.testing.assert_allclose(field.sharpness, point.sharpness, rtol=SINGLE)
    np.testing.assert_allclose(field.amplitude, point.amplitude, rtol=SINGLE)


def test_other_kinds_are_one_lobe(guides, camera):
    kinds = np.resize([int(LobeKind.BECKMANN), int(LobeKind.DELTA), int(LobeKind.NONE)], SHAPE)
    guides["lobe_kind"] = kinds.astype(float)
    field = make_mixture_field(GBuffer(**guides), camera, tau=TAU)
    assert field.valid.all()
    assert (field.amplitude[..., 1:] == 0.0).all()
    integral = field.amplitude[..., 0] * sg_integral(field.sharpness[..., 0])
    none = kinds == LobeKind.NONE
    np.testing.assert_allclose(integral[~none], weigh(guides["specular_albedo"])[~none], rtol=SINGLE)
    np.testing.assert_allclose(field.sharpness[..., 0][kinds == LobeKind.DELTA], TAU**-2, rtol=SINGLE)
    np.testing.assert_allclose(field.axis[none], guides["normal"][none], atol=1e-6)


def test_diffuse_lobe_comes_last_with_its_true_amplitude(guides, camera):
    guides["diffuse_albedo"][2, 3] = 0.0
    guides["lobe_kind"][4] = float(LobeKind.NONE)
    field = make_mixture_field(GBuffer(**guides), camera, tau=TAU, lobes=2, diffuse=True)
    assert field.axis.shape == (*SHAPE, 9)
    point = make_lambert_lobe(guides["normal"], weigh(guides["diffuse_albedo"]))
    np.testing.assert_allclose(field.amplitude[..., 2], point.amplitude[..., 0], rtol=1e-5)
    lit = field.amplitude[..., 2] > 0.0
    assert not lit[2, 3]
    np.testing.assert_allclose(field.axis[lit][:, 6:], guides["normal"][lit], atol=1e-6)
    # without specular lobe the diffuse one is alone
    assert (field.amplitude[4, :, :2] == 0.0).all()
    assert field.valid.all()


def test_materials_have_the_lobes_of_their_tables(guides, camera):
    tables = make_table("one", 200.0), make_table("two", 40.0)
    material = np.zeros(SHAPE)
    material[2:5], material[6] = 1, 2
    field = make_mixture_field(GBuffer(**guides, material=material), camera, tau=TAU, lobes=3, lobe_tables=tables)
    assert field.axis.shape == (*SHAPE, 9)
    for number, table in enumerate(tables):
        here = material == number + 1
        lobes = evaluate_table(table, guides["normal"][here], compute_views(guides, camera)[here])
        sharpness = 2.0 * np.sqrt(np.prod(lobes.sharpness, axis=-1))
        np.testing.assert_allclose(field.axis[here][:, :6], lobes.axis.reshape(-1, 6), atol=1e-5)
        np.testing.assert_allclose(1.0 / field.sharpness[here][:, :2], 1.0 / sharpness + TAU**2, rtol=1e-4)
        kept = field.amplitude[here][:, :2] / field.sharpness[here][:, :2]
        np.testing.assert_allclose(kept, lobes.amplitude / sharpness, rtol=1e-4)
        assert (field.amplitude[here][:, 2] == 0.0).all()
    plain = make_mixture_field(GBuffer(**guides), camera, tau=TAU, lobes=3)
    elsewhere = material == 0
    np.testing.assert_array_equal(field.sharpness[elsewhere], plain.sharpness[elsewhere])


def test_pixels_without_meaning_are_harmless(guides, camera):
    guides["normal"][1, 1] = 0.0
    guides["alpha_u"][2, 2] = np.nan
    guides["specular_albedo"][3, 3] = np.inf
    field = make_mixture_field(GBuffer(**guides), camera, tau=TAU)
    assert [field.valid[k, k] for k in range(5)] == [True, False, False, False, True]
    for values in (field.axis, field.sharpness, field.amplitude):
        assert np.isfinite(values).all()
    assert (field.amplitude[~field.valid] == 0.0).all()


def test_tables_in_chunks_of_any_size_give_the_same_bits(guides, camera, monkeypatch):
    gbuffer, tables = GBuffer(**guides, material=np.ones(SHAPE)), [make_table("one", 200.0)]
    whole = make_mixture_field(gbuffer, camera, tau=TAU, lobe_tables=tables)
    for pixels in (1, 5, 40):
        monkeypatch.setattr(chunks, "CHUNK_PIXELS", pixels)
        part = make_mixture_field(gbuffer, camera, tau=TAU, lobe_tables=tables)
        for name in ("valid", "axis", "sharpness", "amplitude"):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name))


@pytest.mark.parametrize(("lobes", "diffuse"), [(0, False), (5, False), (4, True), (True, False)])
def test_number_of_lobes_is_checked(guides, camera, lobes, diffuse):
    with refuses(InputError, "lobes of a mixture"):
        make_mixture_field(GBuffer(**guides), camera, tau=TAU, lobes=lobes, diffuse=diffuse)


def test_too_many_lobes_in_a_table(guides, camera):
    material = np.ones(SHAPE)
    gbuffer = GBuffer(**guides, material=material)
    table = make_table("one", 50.0)
    wide = {name: np.repeat(getattr(table, name), 2, axis=2) for name in ("axis", "sharpness", "twist", "amplitude")}
    four = LobeTable(**{**{name: getattr(table, name) for name in table.__dataclass_fields__}, **wide})
    with refuses(InputError, "lobes of a mixture", expected="at most 4 for a pixel, the diffuse one included"):
        make_mixture_field(gbuffer, camera, tau=TAU, lobe_tables=[four], diffuse=True)
