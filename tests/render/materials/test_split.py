"""The share of a reflection that is diffuse, against Mitsuba's own evaluation of single lobes."""

from typing import Any

import numpy as np
import pytest

from tests.render.tolerances import SHARE

pytestmark = pytest.mark.mitsuba

COUNT = 400


@pytest.fixture
def directions(mi: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return hits with random viewers, some from behind, and random outgoing directions; no texture coordinates."""
    import drjit as dr

    def draw() -> np.ndarray:
        vector = rng.normal(size=(COUNT, 3))
        return np.asarray(vector / np.linalg.norm(vector, axis=1, keepdims=True), dtype=np.float32)

    si = dr.zeros(mi.SurfaceInteraction3f, COUNT)
    si.wi = mi.Vector3f(draw().T)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    si.n = mi.Normal3f(0, 0, 1)
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    return si, mi.Vector3f(draw().T)


def evaluate(mi: Any, bsdf: Any, si: Any, wo: Any, lobes: Any = None) -> np.ndarray:
    context = mi.BSDFContext()
    if lobes is not None:
        context.type_mask = lobes
    return np.array(bsdf.eval(context, si, wo), dtype=np.float64).T


def compute_share(mi: Any, bsdf: Any, si: Any, wo: Any) -> np.ndarray:
    from lobewise.render.materials.bsdfs import read_material
    from lobewise.render.materials.dispatch import compute_diffuse_share

    share = np.array(compute_diffuse_share(read_material(bsdf), si, wo, mi.Bool(True)), dtype=np.float64).T
    return np.broadcast_to(share, (COUNT, 3))


PLASTIC = {
    "type": "roughplastic",
    "distribution": "ggx",
    "alpha": 0.4,
    "diffuse_reflectance": {"type": "rgb", "value": [0.6, 0.2, 0.05]},
}
PRINCIPLED = {"type": "principled", "base_color": {"type": "rgb", "value": [0.8, 0.4, 0.1]}, "roughness": 0.7}
METAL = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.5}
DIFFUSE = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.3, 0.6, 0.9]}}


def tilted(mi: Any, inner: dict[str, Any]) -> dict[str, Any]:
    normal = np.array([0.3, -0.2, np.sqrt(1 - 0.13)])
    data = np.broadcast_to(0.5 * normal + 0.5, (2, 2, 3)).astype(np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(data)), "raw": True}
    return {"type": "normalmap", "normalmap": texture, "inner": inner}


@pytest.mark.parametrize("wrap", ["bare", "twosided", "mask", "normalmap", "blend"])
def test_share_is_that_of_mitsubas_diffuse_lobes(mi: Any, directions: tuple[Any, Any], wrap: str) -> None:
    bsdf_dict = {
        "bare": PLASTIC,
        "twosided": {"type": "twosided", "a": PLASTIC, "b": DIFFUSE},
        "mask": {"type": "mask", "inner": PLASTIC},
        "normalmap": tilted(mi, PLASTIC),
        "blend": {"type": "blendbsdf", "weight": 0.4, "a": PLASTIC, "b": METAL},
    }[wrap]
    bsdf = mi.load_dict(bsdf_dict)
    si, wo = directions
    total = evaluate(mi, bsdf, si, wo)
    diffuse = evaluate(mi, bsdf, si, wo, mi.BSDFFlags.Diffuse)
    glossy = evaluate(mi, bsdf, si, wo, mi.BSDFFlags.Glossy)
    assert np.count_nonzero(total) > COUNT // 2
    assert np.allclose(total, diffuse + glossy, rtol=1e-4)
    share = compute_share(mi, bsdf, si, wo)
    assert np.allclose(share * total, diffuse, atol=SHARE)


@pytest.mark.parametrize("sheen", [0.0, 0.8])
@pytest.mark.parametrize("flatness", [0.0, 0.7])
def test_principled_diffuse_is_all_that_is_left_without_a_boundary(
    mi: Any, directions: tuple[Any, Any], sheen: float, flatness: float
) -> None:
    """With ``specular`` 0 nothing is reflected at the boundary: Mitsuba's value is the diffuse part, and known."""
    from lobewise.render.materials.bsdfs import read_material
    from lobewise.render.materials.dispatch import evaluate_principled_diffuse

    extra = {"specular": 0.0, "flatness": flatness, "sheen": sheen, "sheen_tint": 0.6, "metallic": 0.0}
    bsdf = mi.load_dict({**PRINCIPLED, **extra})
    si, wo = directions
    ours = np.array(evaluate_principled_diffuse(read_material(bsdf), si, wo, mi.Bool(True)), dtype=np.float64).T
    theirs = evaluate(mi, bsdf, si, wo)
    assert np.count_nonzero(theirs) > COUNT // 2
    assert np.allclose(ours, theirs, rtol=1e-4, atol=1e-6)
    assert np.allclose(compute_share(mi, bsdf, si, wo)[theirs > 1e-6], 1.0, atol=SHARE)


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_share_of_principled_is_its_diffuse_part(mi: Any, directions: tuple[Any, Any], metallic: float) -> None:
    """The diffuse part scales with 1 - metallic and does not heed the boundary, so two plugins tell it."""
    si, wo = directions
    bsdf = mi.load_dict({**PRINCIPLED, "metallic": metallic, "specular": 0.8})
    bare = mi.load_dict({**PRINCIPLED, "metallic": 0.0, "specular": 0.0})
    expected = (1.0 - metallic) * evaluate(mi, bare, si, wo)
    total = evaluate(mi, bsdf, si, wo)
    assert np.allclose(compute_share(mi, bsdf, si, wo) * total, expected, atol=SHARE)


def test_share_of_thin_principled_is_its_part_without_transmission(mi: Any, directions: tuple[Any, Any]) -> None:
    thin = {"type": "principledthin", "roughness": 0.4, "diff_trans": 0.7, "sheen": 0.5, "flatness": 0.3, "eta": 1.4}
    si, wo = directions
    alone, glossy = (evaluate(mi, mi.load_dict({**thin, "spec_trans": each}), si, wo) for each in (0.0, 1.0))
    bsdf = mi.load_dict({**thin, "spec_trans": 0.25})
    total = 0.75 * alone + 0.25 * glossy
    np.testing.assert_allclose(evaluate(mi, bsdf, si, wo), total, rtol=1e-4, atol=1e-6)
    expected = np.divide(0.75 * alone, total, out=np.zeros_like(total), where=total > 0.0)
    np.testing.assert_allclose(compute_share(mi, bsdf, si, wo), expected, atol=SHARE)
    assert expected.std() > 0.1


@pytest.mark.parametrize("wrap", ["twosided", "mask", "normalmap", "deep"])
def test_share_of_wrapped_principled(mi: Any, directions: tuple[Any, Any], wrap: str) -> None:
    si, wo = directions

    def make(**extra: float) -> Any:
        inner = {**PRINCIPLED, **extra}
        return mi.load_dict(
            {
                "twosided": {"type": "twosided", "inner": inner},
                "mask": {"type": "mask", "opacity": 0.7, "inner": inner},
                "normalmap": tilted(mi, inner),
                "deep": {"type": "twosided", "inner": tilted(mi, inner)},
            }[wrap]
        )

    bsdf, bare = make(specular=0.8), make(specular=0.0)
    total, expected = evaluate(mi, bsdf, si, wo), evaluate(mi, bare, si, wo)
    assert np.count_nonzero(expected) > COUNT // 4
    assert np.allclose(compute_share(mi, bsdf, si, wo) * total, expected, atol=SHARE)


def test_share_of_blended_principled(mi: Any, directions: tuple[Any, Any]) -> None:
    si, wo = directions
    bsdf = mi.load_dict({"type": "blendbsdf", "weight": 0.3, "a": {**PRINCIPLED, "specular": 0.9}, "b": METAL})
    bare = mi.load_dict({**PRINCIPLED, "specular": 0.0})
    total, expected = evaluate(mi, bsdf, si, wo), 0.7 * evaluate(mi, bare, si, wo)
    assert np.allclose(compute_share(mi, bsdf, si, wo) * total, expected, atol=SHARE)


@pytest.mark.parametrize(("bsdf_dict", "share"), [(DIFFUSE, 1.0), (METAL, 0.0), ({"type": "plastic"}, 1.0)])
def test_share_of_one_lobe_is_all_or_nothing(
    mi: Any, directions: tuple[Any, Any], bsdf_dict: dict[str, Any], share: float
) -> None:
    si, wo = directions
    assert np.all(compute_share(mi, mi.load_dict(bsdf_dict), si, wo) == share)
