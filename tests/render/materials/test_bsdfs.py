"""Roughness, lobe kind, frame and albedo of every supported BSDF, against the renderer's own answers.

The albedos' second definition is a furnace: under a white sky, the split radiance of a flat square is the directional
albedo of each lobe. The frame's is the shape of the BSDF near its peak, which must widen along the tangent by alpha_u.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lobewise.records.frame import Frame, GBuffer, LobeKind
from tests.render.items import make_camera, rgb
from tests.render.tolerances import ALBEDO_FIT, EXACT, GLASS_FIT, NOISE, PEAK_SHAPE, PRINCIPLED_DIFFUSE

pytestmark = pytest.mark.mitsuba

Furnace = Callable[..., Frame]
Guide = Callable[..., GBuffer]


COPPER = {"eta": rgb(0.27, 1.12, 1.16), "k": rgb(3.41, 2.59, 2.40)}
METAL = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.2, **COPPER}
PLASTIC = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.15, "diffuse_reflectance": rgb(0.6, 0.3, 0.1)}

ALPHAS = [
    ("diffuse", {"type": "diffuse"}, LobeKind.NONE, 0.0, 0.0),
    ("conductor", {"type": "conductor", **COPPER}, LobeKind.DELTA, 0.0, 0.0),
    ("dielectric", {"type": "dielectric"}, LobeKind.DELTA, 0.0, 0.0),
    ("plastic", {"type": "plastic"}, LobeKind.DELTA, 0.0, 0.0),
    ("roughconductor", METAL, LobeKind.GGX, 0.2, 0.2),
    ("beckmann", {"type": "roughconductor", "alpha": 0.3}, LobeKind.BECKMANN, 0.3, 0.3),
    (
        "anisotropic",
        {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.3, "alpha_v": 0.05},
        LobeKind.GGX,
        0.3,
        0.05,
    ),
    ("roughplastic", PLASTIC, LobeKind.GGX, 0.15, 0.15),
    ("beckmann plastic", {"type": "roughplastic", "alpha": 0.12}, LobeKind.BECKMANN, 0.12, 0.12),
    (
        "roughdielectric",
        {"type": "roughdielectric", "distribution": "ggx", "alpha_u": 0.1, "alpha_v": 0.2},
        LobeKind.GGX,
        0.1,
        0.2,
    ),
    ("principled", {"type": "principled", "roughness": 0.5}, LobeKind.GGX, 0.25, 0.25),
    (
        "brushed principled",
        {"type": "principled", "roughness": 0.5, "anisotropic": 0.8, "metallic": 1.0},
        LobeKind.GGX,
        0.25 / np.sqrt(1 - 0.9 * 0.8),
        0.25 * np.sqrt(1 - 0.9 * 0.8),
    ),
    (
        "rough brushed principled",
        {"type": "principled", "roughness": 1.0, "anisotropic": 1.0},
        LobeKind.GGX,
        1.0,
        np.sqrt(0.1),
    ),
    (
        "thin principled",
        {"type": "principledthin", "roughness": 0.5, "anisotropic": 0.8, "spec_trans": 0.5},
        LobeKind.GGX,
        0.25 / (1.0 - 0.9 * 0.8) ** 0.5,
        0.25 * (1.0 - 0.9 * 0.8) ** 0.5,
    ),
    ("smooth principled", {"type": "principled", "roughness": 0.0}, LobeKind.GGX, 0.001, 0.001),
]

WRAPPERS: list[tuple[str, Callable[[dict[str, Any]], dict[str, Any]]]] = [
    ("bare", lambda inner: inner),
    ("twosided", lambda inner: {"type": "twosided", "inner": inner}),
    ("mask", lambda inner: {"type": "mask", "opacity": 0.9, "inner": inner}),
    ("normalmap", lambda inner: {"type": "normalmap", "normalmap": flat_normals(), "inner": inner}),
    ("bumpmap", lambda inner: {"type": "bumpmap", "bumps": ramp_texture(0.0, 0.0), "inner": inner}),
    ("blend with itself", lambda inner: {"type": "blendbsdf", "weight": 0.3, "a": inner, "b": dict(inner)}),
    (
        "three deep",
        lambda inner: {
            "type": "mask",
            "opacity": 0.8,
            "inner": {"type": "twosided", "inner": {"type": "normalmap", "normalmap": flat_normals(), "inner": inner}},
        },
    ),
]


def bitmap(values: np.ndarray) -> dict[str, Any]:
    import mitsuba as mi

    data = np.ascontiguousarray(values, dtype=np.float32)
    return {"type": "bitmap", "bitmap": mi.Bitmap(data), "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}


def flat_normals(x: float = 0.0, y: float = 0.0) -> dict[str, Any]:
    normal = np.array([x, y, np.sqrt(1 - x * x - y * y)])
    return bitmap(np.broadcast_to(0.5 * normal + 0.5, (4, 4, 3)))


def ramp_texture(left: float, right: float, resolution: int = 64) -> dict[str, Any]:
    """Return a texture that goes from left at u = 0 to right at u = 1."""
    x = (np.arange(resolution) + 0.5) / resolution
    return bitmap(np.broadcast_to(left + (right - left) * x, (resolution, resolution))[..., None])


def middle(image: np.ndarray) -> np.ndarray:
    """Return the mean over the picture, which spans half a degree."""
    return np.asarray(image.mean(axis=(0, 1)))


@pytest.mark.parametrize(("name", "bsdf", "kind", "alpha_u", "alpha_v"), ALPHAS, ids=[case[0] for case in ALPHAS])
def test_alpha_and_kind(
    guide: Guide, name: str, bsdf: dict[str, Any], kind: LobeKind, alpha_u: float, alpha_v: float
) -> None:
    gbuffer = guide(bsdf)
    assert np.all(gbuffer.lobe_kind == kind)
    assert np.allclose(gbuffer.alpha_u, alpha_u, atol=EXACT)
    assert np.allclose(gbuffer.alpha_v, alpha_v, atol=EXACT)


@pytest.mark.parametrize(("name", "wrap"), WRAPPERS, ids=[case[0] for case in WRAPPERS])
@pytest.mark.parametrize("bsdf", [METAL, PLASTIC, {"type": "principled", "roughness": 0.4}], ids=lambda b: b["type"])
def test_wrappers_are_opened(
    guide: Guide, name: str, wrap: Callable[[dict[str, Any]], dict[str, Any]], bsdf: dict[str, Any]
) -> None:
    bare, wrapped = guide(bsdf), guide(wrap(bsdf))
    for field in ("alpha_u", "alpha_v", "lobe_kind", "normal"):
        assert np.allclose(getattr(bare, field), getattr(wrapped, field), atol=1e-3), field


@pytest.mark.parametrize("name", ["roughconductor", "roughdielectric"])
def test_alpha_texture_is_read_at_the_hit(guide: Guide, name: str) -> None:
    bsdf = {"type": name, "distribution": "ggx", "alpha": ramp_texture(0.05, 0.55)}
    gbuffer = guide(bsdf, cos_view=1.0)
    u = 0.5 * (gbuffer.position[..., 0] + 1.0)
    assert np.ptp(u) > 0.01
    assert np.allclose(gbuffer.alpha_u, 0.05 + 0.5 * u, atol=1e-4)


def test_roughness_texture_of_principled_is_squared_at_the_hit(guide: Guide) -> None:
    bsdf = {"type": "principled", "roughness": ramp_texture(0.2, 0.8), "anisotropic": ramp_texture(0.0, 1.0)}
    gbuffer = guide(bsdf, cos_view=1.0)
    u = 0.5 * (gbuffer.position[..., 0] + 1.0)
    aspect = np.sqrt(1 - 0.9 * u)
    assert np.allclose(gbuffer.alpha_u, (0.2 + 0.6 * u) ** 2 / aspect, atol=1e-4)
    assert np.allclose(gbuffer.alpha_v, (0.2 + 0.6 * u) ** 2 * aspect, atol=1e-4)


FURNACE = [
    ("diffuse", {"type": "diffuse", "reflectance": rgb(0.7, 0.4, 0.2)}, NOISE),
    ("textured diffuse", {"type": "diffuse", "reflectance": ramp_texture}, NOISE),
    ("conductor", {"type": "conductor", **COPPER, "specular_reflectance": rgb(0.9, 0.8, 0.7)}, NOISE),
    ("plastic", {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.3, 0.1)}, NOISE),
    ("nonlinear plastic", {"type": "plastic", "diffuse_reflectance": rgb(0.9, 0.3, 0.1), "nonlinear": True}, NOISE),
    ("roughconductor", METAL, ALBEDO_FIT),
    ("tinted", {**METAL, "specular_reflectance": rgb(0.5, 0.6, 0.7)}, ALBEDO_FIT),
    ("anisotropic", {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.3, "alpha_v": 0.1}, ALBEDO_FIT),
    ("beckmann", {"type": "roughconductor", "alpha": 0.25, **COPPER}, ALBEDO_FIT),
    ("smooth beckmann plastic", {"type": "roughplastic", "alpha": 0.05, "nonlinear": True}, ALBEDO_FIT),
    ("roughplastic", PLASTIC, ALBEDO_FIT),
    ("dense plastic", {**PLASTIC, "int_ior": 1.9, "nonlinear": True}, ALBEDO_FIT),
    ("principled", {"type": "principled", "base_color": rgb(0.7, 0.4, 0.2), "roughness": 0.4}, PRINCIPLED_DIFFUSE),
    (
        "metallic",
        {"type": "principled", "base_color": rgb(0.9, 0.6, 0.3), "metallic": 1.0, "roughness": 0.5},
        ALBEDO_FIT,
    ),
    (
        "half metallic and tinted",
        {
            "type": "principled",
            "base_color": rgb(0.9, 0.5, 0.2),
            "metallic": 0.5,
            "roughness": 0.5,
            "specular": 0.9,
            "spec_tint": 0.7,
        },
        PRINCIPLED_DIFFUSE,
    ),
    (
        "blend",
        {"type": "blendbsdf", "weight": 0.3, "a": METAL, "b": {"type": "diffuse", "reflectance": rgb(0.2, 0.5, 0.8)}},
        ALBEDO_FIT,
    ),
    (
        "blend of principled",
        {"type": "blendbsdf", "weight": 0.6, "a": METAL, "b": {"type": "principled", "roughness": 0.5}},
        PRINCIPLED_DIFFUSE,
    ),
    ("two-sided", {"type": "twosided", "inner": PLASTIC}, ALBEDO_FIT),
    (
        "thin principled",
        {
            "type": "principledthin",
            "base_color": rgb(0.7, 0.4, 0.2),
            "roughness": 0.4,
            "spec_trans": 0.6,
            "diff_trans": 0.8,
            "eta": 1.5,
        },
        PRINCIPLED_DIFFUSE,
    ),
]


@pytest.mark.sampled(
    "diffuse-0.9",
    "conductor-0.5",
    "nonlinear plastic-0.5",
    "tinted-0.5",
    "smooth beckmann plastic-0.5",
    "principled-0.9",
    "half metallic and tinted-0.9",
    "blend of principled-0.5",
)
@pytest.mark.parametrize("cos_view", [0.9, 0.5])
@pytest.mark.parametrize(("name", "bsdf", "tolerance"), FURNACE, ids=[case[0] for case in FURNACE])
def test_albedos_are_the_furnace_radiance_of_each_lobe(
    furnace: Furnace, name: str, bsdf: dict[str, Any], tolerance: float, cos_view: float
) -> None:
    textures = {key: value(0.2, 0.9) for key, value in bsdf.items() if callable(value)}
    frame = furnace({**bsdf, **textures}, cos_view=cos_view)
    for lobe in ("diffuse", "specular"):
        seen = middle(getattr(frame.radiance, lobe))
        told = middle(getattr(frame.gbuffer, f"{lobe}_albedo"))
        assert np.allclose(told, seen, atol=tolerance), (lobe, told, seen)


GLASS = [
    ("dielectric", {"type": "dielectric", "int_ior": 1.5}, NOISE),
    ("roughdielectric", {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.15, "int_ior": 1.5}, GLASS_FIT),
]


@pytest.mark.parametrize("cos_view", [0.9, 0.5])
@pytest.mark.parametrize(("name", "bsdf", "tolerance"), GLASS, ids=[case[0] for case in GLASS])
def test_albedo_of_glass_holds_what_is_refracted(
    furnace: Furnace, name: str, bsdf: dict[str, Any], tolerance: float, cos_view: float
) -> None:
    tints = {"specular_reflectance": rgb(1.0, 0.0, 0.5), "specular_transmittance": rgb(0.0, 1.0, 0.5)}
    frame = furnace({**bsdf, **tints}, cos_view=cos_view, spp=2048)
    seen, told = middle(frame.radiance.specular), middle(frame.gbuffer.specular_albedo)
    # Radiance is less by the square of the index on the far side of the boundary; leaving the glass undoes that.
    through = 1.5**2 * seen[1]
    assert np.isclose(told[0], seen[0], atol=tolerance)
    assert np.isclose(told[1], through, atol=tolerance)
    assert np.isclose(told[2], 0.5 * (seen[0] + through), atol=tolerance)
    assert frame.radiance.diffuse.max() == 0


def test_albedo_of_principled_glass_holds_what_is_refracted(furnace: Furnace) -> None:
    bsdf = {"type": "principled", "base_color": rgb(0.81, 0.36, 0.04), "roughness": 0.4, "eta": 1.5}
    opaque, clear = furnace({**bsdf, "spec_trans": 1e-4}), furnace({**bsdf, "spec_trans": 1.0}, spp=2048)
    reflected = middle(opaque.radiance.specular)
    through = 1.5**2 * (middle(clear.radiance.specular) - reflected)
    assert np.allclose(through / np.sqrt([0.81, 0.36, 0.04]), through[0] / 0.9, atol=3 * NOISE)
    assert np.allclose(middle(clear.gbuffer.specular_albedo), reflected + through, atol=PRINCIPLED_DIFFUSE)
    assert clear.gbuffer.diffuse_albedo.max() == 0


@pytest.mark.parametrize("name", ["diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "principled"])
def test_one_sided_material_is_black_from_behind(furnace: Furnace, name: str) -> None:
    frame = furnace({"type": name}, behind=True, spp=4)
    assert frame.radiance.color.max() == 0
    assert frame.gbuffer.diffuse_albedo.max() == 0
    assert frame.gbuffer.specular_albedo.max() == 0
    assert np.all(frame.gbuffer.lobe_kind == LobeKind.NONE)
    assert np.allclose(frame.gbuffer.normal, (0, 0, -1), atol=EXACT)


def test_two_sided_material_of_two_kinds_shows_the_side_that_is_seen(furnace: Furnace) -> None:
    bsdf = {"type": "twosided", "front": {**METAL, "alpha": 0.1}, "rear": {**PLASTIC, "alpha": 0.4}}
    front, rear = furnace(bsdf, spp=4).gbuffer, furnace(bsdf, spp=4, behind=True).gbuffer
    assert np.allclose(front.alpha_u, 0.1, atol=EXACT)
    assert front.diffuse_albedo.max() == 0
    assert np.allclose(rear.alpha_u, 0.4, atol=EXACT)
    assert rear.diffuse_albedo.min() > 0


def test_blend_takes_the_lobe_that_reflects_more(guide: Guide) -> None:
    strong, weak = {**METAL, "alpha": 0.1}, {**PLASTIC, "alpha": 0.4}
    for weight, alpha in ((0.2, 0.1), (0.8, 0.1), (0.99, 0.4)):
        gbuffer = guide({"type": "blendbsdf", "weight": weight, "a": strong, "b": weak})
        assert np.allclose(gbuffer.alpha_u, alpha, atol=EXACT), weight
    mirrored = guide({"type": "blendbsdf", "weight": 0.8, "a": weak, "b": strong})
    assert np.allclose(mirrored.alpha_u, 0.1, atol=EXACT)


def test_blend_weight_texture_is_read_at_the_hit(guide: Guide) -> None:
    bsdf = {
        "type": "blendbsdf",
        "weight": ramp_texture(-20.0, 21.0),
        "a": {**METAL, "alpha": 0.1},
        "b": {**METAL, "alpha": 0.4},
    }
    gbuffer = guide(bsdf, cos_view=1.0)
    expected = np.where(gbuffer.position[..., 0] > 0, 0.4, 0.1)
    assert set(np.unique(expected)) == {0.1, 0.4}
    assert np.allclose(gbuffer.alpha_u, expected, atol=EXACT)


def test_opaque_half_of_a_mask_is_what_the_pixel_shows(furnace: Furnace) -> None:
    seen = furnace({"type": "mask", "opacity": 0.6, "inner": METAL}, spp=4).gbuffer
    unseen = furnace({"type": "mask", "opacity": 0.4, "inner": METAL}, spp=4).gbuffer
    assert np.all(seen.depth > 0)
    assert np.allclose(seen.alpha_u, 0.2, atol=EXACT)
    assert np.all(unseen.depth == 0)
    assert np.all(unseen.lobe_kind == LobeKind.NONE)


def make_maps() -> list[tuple[str, dict[str, Any]]]:
    inner = {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.20, "alpha_v": 0.05}
    turned = {"type": "normalmap", "normalmap": flat_normals(0.2, -0.1), "inner": inner}
    bumped = {"type": "bumpmap", "bumps": ramp_texture(0.0, 0.6), "inner": inner}
    glossy = {"type": "principled", "roughness": 0.3, "anisotropic": 0.9, "metallic": 1.0}
    return [
        ("bare", inner),
        ("twosided", {"type": "twosided", "inner": inner}),
        ("normalmap", turned),
        ("bumpmap", bumped),
        ("twosided normalmap", {"type": "twosided", "inner": turned}),
        ("twosided bumpmap", {"type": "twosided", "inner": bumped}),
        ("normalmap over bumpmap", {"type": "normalmap", "normalmap": flat_normals(0.1, 0.1), "inner": bumped}),
        ("principled", {"type": "twosided", "inner": glossy}),
    ]


@pytest.mark.parametrize(
    ("case", "behind"), [(case, False) for case in range(8)] + [(1, True), (4, True), (5, True), (7, True)]
)
def test_lobe_widens_by_alpha_along_the_tangent(mi: Any, case: int, behind: bool) -> None:
    """Tilt the half vector from the told normal along the told axes: the BSDF must fall as GGX of the told alphas."""
    from lobewise.render.materials.bsdfs import read_material
    from lobewise.render.materials.surface import describe_material

    name, bsdf_dict = make_maps()[case]
    turn = mi.ScalarTransform4f().rotate([0.3, 1.0, -0.5], 40)
    scene = mi.load_dict({"type": "scene", "square": {"type": "rectangle", "to_world": turn, "bsdf": bsdf_dict}})
    bsdf = scene.shapes()[0].bsdf()
    toward = np.array(turn.matrix)[:3, :3] @ np.array([0.25, 0.15, -0.95 if behind else 0.95])
    toward /= np.linalg.norm(toward)
    ray = mi.Ray3f(mi.Point3f((5.0 * toward).tolist()), mi.Vector3f((-toward).tolist()))
    si = scene.ray_intersect(ray)
    assert np.all(si.is_valid())
    surface = describe_material(read_material(bsdf), si, mi.Bool(True))
    normal, tangent = (np.array(getattr(surface, field)).ravel() for field in ("normal", "tangent"))
    alpha = np.array(surface.alpha_u)[0], np.array(surface.alpha_v)[0]
    assert normal @ toward > 0
    assert abs(normal @ tangent) < EXACT
    assert np.isclose(np.linalg.norm(tangent), 1.0, atol=EXACT)

    def evaluate(half: np.ndarray) -> float:
        half = half / np.linalg.norm(half)
        out = 2.0 * (half @ toward) * half - toward
        return float(np.array(bsdf.eval(mi.BSDFContext(), si, si.to_local(mi.Vector3f(out.tolist())))).ravel()[1])

    # The renderer's cosine, which changes little for such tilts, stands in both.
    peak = evaluate(normal)
    assert peak > 0
    for axis, width in ((tangent, alpha[0]), (np.cross(normal, tangent), alpha[1])):
        for tilt in (0.5 * width, -0.5 * width):
            cosine_4 = 1.0 / (1.0 + tilt**2) ** 2
            expected = 1.0 / (1.0 + (tilt / width) ** 2) ** 2 / cosine_4
            assert np.isclose(evaluate(normal + tilt * axis) / peak, expected, rtol=PEAK_SHAPE), (name, tilt)


@pytest.mark.sampled("bumpmap")
@pytest.mark.parametrize("plugin", ["normalmap", "bumpmap"])
def test_mapped_normal_agrees_with_mitsubas_own_channel(mi: Any, plugin: str) -> None:
    maps = {"normalmap": flat_normals(0.3, -0.2), "bumpmap": ramp_texture(0.0, 0.5)}
    bsdf = {"type": plugin, "map" if plugin == "bumpmap" else "normalmap": maps[plugin], "inner": PLASTIC}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "aov", "aovs": "n:sh_normal"},
            "sensor": make_camera(mi, [0.5, 0.5, 4], fov=10.0),
            "square": {"type": "rectangle", "bsdf": bsdf},
        }
    )
    from lobewise.render import render_frame

    theirs = np.array(mi.render(scene, spp=4))[..., -3:]
    ours = render_frame(scene, spp=1, aov_only=True).gbuffer.normal
    assert np.abs(theirs[..., 2] - 1.0).max() > 0.01
    assert np.allclose(ours, theirs, atol=1e-4)
