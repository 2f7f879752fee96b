"""The shader functions on a device, in three languages, against the lobes in double precision."""

import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.errors import FileError, InputError
from lobewise.exporting.names import SHADER_LANGUAGES
from lobewise.exporting.shaders.writing import export_shader, make_shader
from lobewise.features.normal import LAMBERT_COEFFICIENTS
from lobewise.fitting.arrays import normalize
from lobewise.lobes.directions import MIN_COSINE
from tests.exporting.shaders import INPUTS, compile_spirv, make_program, run_program
from tests.lobes.oracles import brdf, mixture, sg, tangent
from tests.mistakes import refuses

COUNT = 4096
WEIGHT_ATOL = 3e-6
"""Rounding of exponents that matter, up to 20, in single precision."""
"""Rounding of the similarity of anisotropic lobes in single precision, to the power beta."""
LOBE_RTOL = 3e-5
"""Of a lobe's size; grazing views lose a digit or two."""
DIFFUSE_ATOL = 4e-3
"""Of the polynomial that stands for the overlap of cosine lobes, at beta 1."""
SHARPEST = 1e7

Rows = dict[str, NDArray[np.float64]]


def make_directions(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    return normalize(rng.normal(size=(count, 3)))


def make_across(axis: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return unit vectors across others."""
    vector = rng.normal(size=axis.shape)
    return normalize(vector - np.sum(vector * axis, axis=-1, keepdims=True) * axis)


def make_covariance(axis: NDArray[np.float64], deviations: NDArray[np.float64], rng: np.random.Generator) -> Rows:
    """Return covariances with two standard deviations (count, 2), as the shaders have them."""
    x = make_across(axis, rng)
    y = np.cross(axis, x)
    u, v = (deviations[:, k, None] ** 2 for k in (0, 1))
    cross = [(0, 1), (0, 2), (1, 2)]
    return {
        "diagonal": u * x * x + v * y * y,
        "beside": np.stack([u[:, 0] * x[:, a] * x[:, b] + v[:, 0] * y[:, a] * y[:, b] for a, b in cross], axis=-1),
        "determinant": (deviations[:, 0] * deviations[:, 1]) ** 2,
    }


@pytest.fixture(scope="module")
def rows() -> Rows:
    """Return the inputs of every function, already rounded to single precision; lobes from mirror to Lambert."""
    rng = np.random.default_rng(20150915)
    n = COUNT
    found: Rows = {
        "pixel_i": rng.integers(0, 4000, (n, 2)).astype(float),
        "position_i": rng.uniform(-3.0, 3.0, (n, 3)),
        "depth_i": rng.uniform(3.9, 4.1, n),
        "depth_j": rng.uniform(3.9, 4.1, n),
        "pixel_angle": rng.uniform(0.0005, 0.002, n),
        "sigma": rng.uniform(1.0, 20.0, n),
        "exponent": rng.uniform(16.0, 128.0, n),
        "beta": rng.choice([1.0, 2.0, 4.0, 10.0], n),
        "axis_i": make_directions(rng, n),
        "tau": 10.0 ** rng.uniform(-3.5, -0.7, n),
        "view": make_directions(rng, n),
        "alpha": rng.uniform(0.0, 1.0, (n, 2)) ** 2,
    }
    found["alpha"][: n // 8, 0] = 0.0  # mirrors
    found["alpha"][n // 8 : n // 4] = rng.uniform(0.9, 1.0, (n // 8, 2))
    found["alpha"][n // 4, :] = 1.0
    found["pixel_j"] = found["pixel_i"] + rng.integers(-16, 17, (n, 2))
    footprint = (found["depth_i"] * found["pixel_angle"] * found["sigma"])[:, None]
    found["position_j"] = found["position_i"] + footprint * rng.normal(size=(n, 3))
    sharpness = 10.0 ** rng.uniform(0.0, np.log10(SHARPEST), n)
    ratio = 10.0 ** rng.normal(0.0, 0.3, n)
    found["sharpness_i"], found["sharpness_j"] = sharpness, np.minimum(sharpness * ratio, SHARPEST)
    width = 1.0 / np.sqrt(sharpness)
    step = np.minimum(width * np.abs(rng.normal(0.0, 1.2, n)), 2.0)[:, None]
    across = make_across(found["axis_i"], rng)
    found["axis_j"] = np.cos(step) * found["axis_i"] + np.sin(step) * across
    found["axis_j"][:16] = found["axis_i"][:16]
    found["axis_j"][16:32] = -found["axis_i"][16:32]
    for side in "ij":
        stretch = 10.0 ** rng.normal(0.0, 0.15, (n, 2))
        for name, value in make_covariance(found[f"axis_{side}"], width[:, None] * stretch, rng).items():
            found[f"{name}_{side}"] = value
        spread = 10.0 ** rng.uniform(-1.0, 0.5, (n, 4))
        found[f"many_{side}"] = np.minimum(sharpness[:, None] * spread, SHARPEST)
        amplitude = found[f"many_{side}"] * rng.uniform(0.1, 1.0, (n, 4))
        amplitude[rng.random((n, 4)) < 0.3] = 0.0
        amplitude[:, 0] = np.maximum(amplitude[:, 0], 0.1)
        found[f"amplitude_{side}"] = amplitude
    elevation = rng.uniform(0.02, 1.0, n)[:, None]
    elevation[-n // 8 :] = rng.uniform(0.01, 0.04, (n // 8, 1))  # grazing, and sharp
    found["alpha"][-n // 8 :] = rng.uniform(0.005, 0.03, (n // 8, 2))
    side = make_across(found["view"], rng)
    found["normal"] = elevation * found["view"] + np.sqrt(1.0 - elevation**2) * side
    found["tangent"] = make_across(found["normal"], rng)
    turned = rng.uniform(-0.5, 0.5, n)[:, None]
    found["raw_normal"] = turned * found["view"] + np.sqrt(1.0 - turned**2) * side
    return {name: np.asarray(found[name], np.float32).astype(np.float64) for name in INPUTS}


@pytest.fixture(scope="module")
def given(rows: Rows) -> NDArray[np.float32]:
    return np.column_stack([rows[name] for name in INPUTS]).astype(np.float32)


@pytest.fixture(scope="module", params=["wgsl", "glsl", "glsl by glslang", "hlsl by glslang"])
def results(request: Any, graphics: Any, given: NDArray[np.float32], tmp_path_factory: Any) -> Rows:
    """Return what the functions of a language give; HLSL, and GLSL a second time, by way of the reference compiler."""
    language, *by = request.param.split(" by ")
    code: str | bytes = make_program(language, make_shader(language))
    if by:
        request.getfixturevalue("glslang")
        code = compile_spirv(language, str(code), tmp_path_factory.mktemp("shader"))
    return run_program(graphics, code, given)


def get_mixture(rows: Rows, side: str) -> mixture.SgMixture:
    return mixture.SgMixture(rows[f"axis_{side}"][:, None, :], rows[f"many_{side}"], rows[f"amplitude_{side}"])


def get_lobe(rows: Rows, side: str) -> tangent.TangentLobe:
    diagonal, beside = rows[f"diagonal_{side}"], rows[f"beside_{side}"]
    six = np.stack([diagonal[:, 0], *beside[:, :2].T, diagonal[:, 1], beside[:, 2], diagonal[:, 2]], axis=-1)
    return tangent.TangentLobe(rows[f"axis_{side}"], six, rows[f"determinant_{side}"])


def check_weight(found: NDArray[np.float64], expected: NDArray[np.float64], atol: float) -> None:
    """Compare; make sure that the test says something: that weights of all sizes occur."""
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=atol)
    assert np.all((found >= 0.0) & (found <= 1.0))
    assert np.mean((expected > 0.05) & (expected < 0.95)) > 0.2


def test_screen(rows: Rows, results: Rows) -> None:
    d = rows["pixel_j"] - rows["pixel_i"]
    check_weight(results["screen"], np.exp(-np.sum(d * d, -1) / (2.0 * rows["sigma"] ** 2)), WEIGHT_ATOL)


def test_position(rows: Rows, results: Rows) -> None:
    d = rows["position_j"] - rows["position_i"]
    footprints = rows["depth_i"] * rows["depth_j"] * rows["pixel_angle"] ** 2
    expected = np.exp(-np.sum(d * d, -1) / (2.0 * rows["sigma"] ** 2 * footprints))
    check_weight(results["position"], expected, WEIGHT_ATOL)


def test_normal(rows: Rows, results: Rows) -> None:
    d = rows["axis_j"] - rows["axis_i"]
    expected = np.exp(-0.5 * rows["exponent"] * np.sum(d * d, -1))
    np.testing.assert_allclose(results["normal"], expected, rtol=0.0, atol=WEIGHT_ATOL)
    assert expected.min() < 0.1


def test_diffuse(rows: Rows, results: Rows) -> None:
    d = rows["axis_j"] - rows["axis_i"]
    x = 0.5 * np.sum(d * d, -1)
    polynomial = np.polynomial.polynomial.polyval(x, LAMBERT_COEFFICIENTS)
    np.testing.assert_allclose(results["diffuse"], 2.0 ** (-rows["beta"] * x * polynomial), rtol=0.0, atol=WEIGHT_ATOL)
    once = rows["beta"] == 1.0
    overlap = brdf.lambert_similarity(rows["axis_i"], rows["axis_j"])
    np.testing.assert_allclose(results["diffuse"][once], overlap[once], rtol=0.0, atol=DIFFUSE_ATOL)


def test_sg(rows: Rows, results: Rows) -> None:
    lobes = [rows[f"{name}_{side}"] for side in "ij" for name in ("axis", "sharpness")]
    check_weight(results["sg"], sg.sg_slide_similarity(*lobes, rows["beta"]), WEIGHT_ATOL)


def test_mixture(rows: Rows, results: Rows) -> None:
    expected = mixture.mixture_approx_similarity(get_mixture(rows, "i"), get_mixture(rows, "j"), rows["beta"])
    check_weight(results["mixture"], expected, WEIGHT_ATOL)


def test_ggx(rows: Rows, results: Rows) -> None:
    expected = tangent.tangent_approx_similarity(get_lobe(rows, "i"), get_lobe(rows, "j"), rows["beta"])
    check_weight(results["ggx"], expected, 10.0 * WEIGHT_ATOL)


def test_equal_pixels_have_weight_one(results: Rows) -> None:
    for name in ("normal", "diffuse"):
        np.testing.assert_array_equal(results[name][:16], 1.0)


def test_face_viewer(rows: Rows, results: Rows) -> None:
    cosine = np.sum(rows["raw_normal"] * rows["view"], -1, keepdims=True)
    expected = normalize(rows["raw_normal"] + np.maximum(MIN_COSINE - cosine, 0.0) * rows["view"])
    np.testing.assert_allclose(results["face"], expected, rtol=0.0, atol=1e-6)
    assert np.sum(expected * rows["view"], -1).min() > 0.9 * MIN_COSINE


def test_make_sg(rows: Rows, results: Rows) -> None:
    alpha = np.maximum(rows["alpha"][:, 0], 1e-12)
    axis, sharpness = brdf.reflect_sg(rows["view"], 2.0 / alpha**2, rows["normal"])
    np.testing.assert_allclose(results["make_sg"][:, :3], axis, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(results["make_sg"][:, 3], sg.sg_bandlimit(sharpness, rows["tau"]), rtol=LOBE_RTOL)


def test_make_mixture(rows: Rows, results: Rows) -> None:
    for k in range(0, COUNT, COUNT // 64):
        expected = mixture.make_ggx_mixture(
            rows["view"][k], rows["normal"][k], rows["alpha"][k, 0], lobes=3, tau=float(rows["tau"][k])
        )
        found = results["make_mixture"][k]
        np.testing.assert_allclose(found[:3], expected.axis[0], rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(found[3:6], expected.sharpness, rtol=LOBE_RTOL)
        np.testing.assert_allclose(found[7:10], expected.amplitude, rtol=LOBE_RTOL)
        assert found[10] == 0.0


@pytest.mark.parametrize("anisotropic", [False, True])
def test_make_covariance(rows: Rows, results: Rows, anisotropic: bool) -> None:
    found = results[f"make_{'anisotropic_' if anisotropic else ''}ggx"]
    more = {"alpha_v": rows["alpha"][:, 1], "tangent": rows["tangent"]} if anisotropic else {}
    tau: Any = rows["tau"]
    expected = tangent.make_tangent_lobe(rows["view"], rows["normal"], rows["alpha"][:, 0], tau=tau, **more)
    covariance = expected.covariance
    scale = covariance[:, [0, 3, 5]].sum(axis=1, keepdims=True)
    six = found[:, [3, 6, 7, 4, 8, 5]]
    np.testing.assert_allclose(found[:, :3], expected.axis, rtol=0.0, atol=LOBE_RTOL)
    np.testing.assert_allclose(six / scale, covariance / scale, rtol=0.0, atol=LOBE_RTOL)
    np.testing.assert_allclose(found[:, 9], expected.determinant, rtol=10.0 * LOBE_RTOL)


def test_nothing_overflows(results: Rows) -> None:
    for name, values in results.items():
        assert np.isfinite(values).all(), name


@pytest.mark.parametrize("language", SHADER_LANGUAGES)
def test_one_text_for_all(language: str) -> None:
    text = make_shader(language)
    assert "$" not in text
    assert ("vec3<f32>" in text, "float3 " in text) == (language == "wgsl", language == "hlsl")
    # Every constant says where it is from; every function what it is.
    lines = text.splitlines()
    for place, line in enumerate(lines):
        if re.match(r"(fn |float|vec|Lobewise|struct )", line):
            assert lines[place - 1].startswith("//") or lines[place - 1] == "", line


def test_export(tmp_path: Any) -> None:
    export_shader(tmp_path / "shader", "hlsl")
    assert (tmp_path / "shader" / "lobewise.hlsl").read_text() == make_shader("hlsl")
    with refuses(FileError, "output 'shader'"):
        export_shader(tmp_path / "shader", "wgsl")
    export_shader(tmp_path / "shader", "wgsl", force=True)
    assert sorted(path.name for path in (tmp_path / "shader").iterdir()) == [
        "README.md",
        "lobewise-export.json",
        "lobewise.wgsl",
    ]
    with refuses(InputError, "shader language"):
        make_shader("glls")
