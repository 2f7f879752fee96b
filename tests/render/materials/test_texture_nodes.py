"""Lobes that change their shape over a texture, against BSDFs whose parameters are the texture's values there."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.sparse.csgraph import minimum_spanning_tree

from lobewise import denoise
from lobewise.fitting.table import evaluate_lobes, evaluate_table
from lobewise.lobes.numbers import NUMPY
from lobewise.metrics import rel_mse
from lobewise.records.frame import GBuffer
from tests.render.materials.python_bsdf import register_lobes, register_rough
from tests.render.materials.test_bsdfs import WRAPPERS, bitmap, middle, ramp_texture, rgb
from tests.render.tolerances import EXACT, FITTED_ALBEDO, FITTED_ALPHA, FITTED_STEPS, FITTED_TEXTURE

pytestmark = pytest.mark.mitsuba

Guide = Callable[..., GBuffer]

SHARP, WIDE = 0.05, 0.4
CHECKER = {"type": "checkerboard", "color0": SHARP, "color1": WIDE}
"""Alpha ``WIDE`` where u and v are both below 0.5 or both above it, ``SHARP`` elsewhere."""
GUIDES = ("alpha_u", "alpha_v", "specular_albedo", "tangent", "material")


@pytest.fixture(scope="module")
def rough(mi: Any) -> str:
    """Return the name of a plugin that is written in Python and has textures."""
    return register_rough()


def read(bsdf: dict[str, Any]) -> Any:
    import mitsuba as mi

    from lobewise.render.materials.bsdfs import read_material

    return read_material(mi.load_dict(bsdf))


def describe(
    material: Any, u: Any, v: float = 0.25, *, cos_view: float = 0.8, azimuth: float = 0.0, scale: float = 1.0
) -> Any:
    """Return guides by name at texture coordinates ``u`` and positions (u, v, 0) times ``scale``.

    The first axis of the arrays is the hit.
    """
    import drjit as dr
    import mitsuba as mi

    from lobewise.render.materials.surface import describe_material

    u = np.atleast_1d(u)
    si = dr.zeros(mi.SurfaceInteraction3f, len(u))
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    sine = (1.0 - cos_view**2) ** 0.5
    si.wi = mi.Vector3f(*(float(part) for part in (sine * np.cos(azimuth), sine * np.sin(azimuth), cos_view)))
    si.uv = mi.Point2f(np.stack([u, np.full(len(u), v)]).astype(np.float32))
    si.p = mi.Point3f(np.stack([scale * u, np.full(len(u), scale * v), 0.0 * u]).astype(np.float32))
    surface = describe_material(material, si, mi.Bool(True))
    found = {name: np.atleast_1d(np.array(getattr(surface, name)).T) for name in GUIDES}
    return {name: np.broadcast_to(value, (len(u), *value.shape[1:])) for name, value in found.items()}


def list_tables(material: Any) -> Any:
    from lobewise.render.materials.bsdfs import list_lobe_tables

    return list_lobe_tables({0: material})


class TestSquares:
    @pytest.mark.nightly
    @pytest.mark.parametrize(
        "wrap", [pytest.param(wrap, id=name, marks=() if name in ("bare", "three deep") else pytest.mark.nightly)
                 for name, wrap in WRAPPERS]
    )  # fmt: skip
    def test_plastic_has_the_lobes_of_two_plastics(self, wrap: Callable[..., dict[str, Any]], mi: Any) -> None:
        material = read(wrap({"type": "pplastic", "alpha": CHECKER}))
        for cos_view in (0.97, 0.5):
            found = describe(material, [0.1, 0.4, 0.6, 0.9], cos_view=cos_view)
            plain = [describe(read(wrap({"type": "pplastic", "alpha": each})), 0.1, cos_view=cos_view)
                     for each in (WIDE, SHARP)]  # fmt: skip
            for name in ("alpha_u", "alpha_v"):
                alphas = [plain[k][name][0] for k in (0, 0, 1, 1)]
                assert np.allclose(found[name], alphas, rtol=FITTED_ALPHA), name
            albedos = [plain[k]["specular_albedo"][0] for k in (0, 0, 1, 1)]
            assert np.allclose(found["specular_albedo"], albedos, atol=FITTED_ALBEDO)
            assert len(set(found["material"].tolist())) == 2
        assert np.ptp(found["alpha_u"]) > 0.1

    @pytest.mark.nightly
    def test_tables_are_those_of_two_plastics(self, mi: Any) -> None:
        material = read({"type": "pplastic", "alpha": CHECKER, "id": "tiles"})
        tables = list_tables(material)
        assert [table.name for table in tables] == ["tiles 1 of 2", "tiles 2 of 2"]
        numbers = describe(material, [0.1, 0.9])["material"].astype(int)
        for number, alpha in zip(numbers, (WIDE, SHARP), strict=True):
            (plain,) = list_tables(read({"type": "pplastic", "alpha": alpha}))
            assert np.allclose(tables[number - 1].sharpness, plain.sharpness, rtol=FITTED_ALPHA)

    @pytest.mark.nightly
    def test_albedos_are_the_furnace_radiance(self, furnace: Callable[..., Any], rough: str) -> None:
        color = {"type": "checkerboard", "color0": rgb(0.2, 0.5, 0.8), "color1": rgb(0.9, 0.3, 0.1)}
        for u in (0.25, 0.75):
            # The camera sees the middle of the square: move the texture there.
            move = {"to_uv": mi_transform().translate([u - 0.5, -0.25])}
            frame = furnace({"type": rough, "rough": {**CHECKER, **move}, "color": {**color, **move}}, spp=4096)
            seen, told = middle(frame.radiance.specular), middle(frame.gbuffer.specular_albedo)
            assert np.allclose(told, seen, atol=FITTED_TEXTURE)
            assert np.argmax(told) == (2 if u < 0.5 else 0)

    @pytest.mark.nightly
    def test_a_rough_lobe_from_python(self, rough: str) -> None:
        # Mitsuba's checkerboard swaps its squares between colours and numbers.
        color = {"type": "checkerboard", "color0": 0.9, "color1": 0.3}
        material = read({"type": rough, "rough": CHECKER, "color": color})
        found = describe(material, [0.1, 0.9])
        for index, (alpha, value) in enumerate([(WIDE, 0.9), (SHARP, 0.3)]):
            plain = describe(read({"type": rough, "rough": alpha, "color": value}), 0.5)
            for name in ("alpha_u", "alpha_v"):
                assert np.isclose(found[name][index], plain[name][0], rtol=FITTED_ALPHA), name
            assert np.allclose(found["specular_albedo"][index], plain["specular_albedo"][0], atol=FITTED_ALBEDO)

    @pytest.mark.nightly
    def test_brushed_lobes_turn_with_the_texture(self, rough: str) -> None:
        stretch = {"type": "checkerboard", "color0": 2.0, "color1": 0.5}
        material = read({"type": rough, "rough": 0.2, "stretch": stretch})
        for azimuth in (0.0, 1.1):
            found = describe(material, [0.1, 0.9], cos_view=0.9, azimuth=azimuth)
            assert np.allclose(found["alpha_u"] / found["alpha_v"], 4.0, rtol=2.0 * FITTED_ALPHA)
            assert np.allclose(np.abs(found["tangent"]), [[0, 1, 0], [1, 0, 0]], atol=0.02)

    @pytest.mark.nightly
    def test_a_black_centre_is_no_node(self, rough: str) -> None:
        color = bitmap(np.array([[0.0, 0.0, 0.0, 0.9]] * 4)[..., None])
        material = read({"type": rough, "rough": ramp_texture(SHARP, WIDE), "color": color})
        found = describe(material, [0.3, 0.95])
        assert np.all(found["specular_albedo"][0] == 0.0)
        assert found["specular_albedo"][1].min() > 0.2
        assert found["alpha_u"][1] > 0.3


@pytest.mark.nightly
def test_a_denoised_frame_keeps_the_squares(
    mi: Any, make_box_scene: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    from lobewise.render import render_frame, render_reference
    from lobewise.render.materials import fitted

    alpha = {**CHECKER, "to_uv": mi.ScalarTransform3f().scale([2.0, 2.0])}
    to_world = mi.ScalarTransform4f().translate([0.0, 0.1, 0.3]).rotate([1, 0, 0], -90).scale(1.4)
    bsdf = {"type": "pplastic", "distribution": "ggx", "alpha": alpha, "diffuse_reflectance": 0.0}
    scene = make_box_scene({"plate": {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}}, size=64)
    frame = render_frame(scene, spp=16, seed=4)
    monkeypatch.setattr(fitted, "probe_texture", lambda *_: None)
    monkeypatch.setattr(fitted, "_fits", type(fitted._fits)())
    single = render_frame(scene, spp=16, seed=4)
    assert np.array_equal(frame.radiance.color, single.radiance.color)
    plate = frame.gbuffer.material > 0
    assert np.array_equal(np.unique(frame.gbuffer.material), [0.0, 1.0, 2.0])
    # Every pixel of the plate has one of two roughnesses; without places all have one.
    assert np.all((frame.gbuffer.alpha_v[plate] < 1.1 * SHARP) | (frame.gbuffer.alpha_v[plate] > 0.9 * WIDE))
    assert np.ptp(single.gbuffer.alpha_v[plate]) < 0.1 * WIDE
    reference = render_reference(scene, spp=1024, seed=5).radiance.color
    errors = [
        rel_mse(denoise(each, similarity="ggx", quality="fast").image, reference, plate) for each in (frame, single)
    ]
    assert errors[0] < 0.8 * errors[1]


class TestRamps:
    @pytest.mark.nightly
    @pytest.mark.parametrize("distribution", ["ggx", pytest.param("beckmann", marks=[pytest.mark.nightly])])
    def test_lobes_between_the_nodes(self, mi: Any, distribution: str) -> None:
        plastic = {"type": "pplastic", "distribution": distribution}
        material = read({**plastic, "alpha": ramp_texture(SHARP, WIDE)})
        assert len(material.fitted.fit.nodes) <= 5
        u = np.array([0.05, 0.22, 0.41, 0.66, 0.93])
        found = describe(material, u)
        normal, view, light = np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8]), make_lights()
        for index, alpha in enumerate(SHARP + (WIDE - SHARP) * u):
            same = read({**plastic, "alpha": float(alpha)})
            plain = describe(same, 0.5)
            for name in ("alpha_u", "alpha_v"):
                assert np.isclose(found[name][index], plain[name][0], rtol=FITTED_ALPHA), (name, alpha)
            assert np.allclose(found["specular_albedo"][index], plain["specular_albedo"][0], atol=FITTED_ALBEDO)
            tables = list_tables(material)[int(found["material"][index]) - 1], *list_tables(same)
            one, two = (evaluate_lobes(evaluate_table(table, normal, view), light, "sg") for table in tables)
            assert one @ two / np.linalg.norm(one) / np.linalg.norm(two) > FITTED_STEPS, alpha

    @pytest.mark.nightly
    def test_brushed_lobes_have_few_nodes(self, rough: str) -> None:
        brushed = {"type": rough, "stretch": 1.5}
        material = read({**brushed, "rough": ramp_texture(SHARP, WIDE)})
        assert len(material.fitted.fit.nodes) == 4
        assert not material.fitted.fit.is_isotropic
        for u in (0.1, 0.9):
            found = describe(material, u, cos_view=0.9)
            plain = describe(read({**brushed, "rough": SHARP + (WIDE - SHARP) * u}), 0.5, cos_view=0.9)
            for name in ("alpha_u", "alpha_v"):
                assert np.isclose(found[name][0], plain[name][0], rtol=FITTED_ALPHA), name

    @pytest.mark.nightly
    def test_alphas_do_not_jump(self, rough: str) -> None:
        material = read({"type": rough, "rough": ramp_texture(SHARP, WIDE)})
        alpha = describe(material, np.linspace(0.02, 0.98, 200))["alpha_u"]
        assert np.abs(np.diff(np.log(alpha))).max() < 0.06


class TestPositions:
    @pytest.mark.nightly
    @pytest.mark.parametrize("scale", [1.0, 40.0])
    def test_lobes_follow_a_texture_in_space(self, mi: Any, scale: float) -> None:
        from lobewise.render.materials.bsdfs import read_material

        values = np.array([WIDE, SHARP], dtype=np.float32).reshape(1, 1, 2, 1)
        grid = {"type": "gridvolume", "grid": mi.VolumeGrid(np.tile(values, (2, 2, 1, 1))), "filter_type": "nearest"}
        to_world = mi.ScalarTransform4f().translate([0.0, -scale, -scale]).scale([scale, 3.0 * scale, 3.0 * scale])
        alpha = {"type": "volume", "volume": {**grid, "to_world": to_world}}
        material = read_material(mi.load_dict({"type": "pplastic", "alpha": alpha}), extent=scale)
        assert material.fitted.fit.parts.positional
        found = describe(material, [0.2, 0.8], scale=scale)
        plain = [describe(read({"type": "pplastic", "alpha": each}), 0.5) for each in (WIDE, SHARP)]
        for name in ("alpha_u", "alpha_v"):
            assert np.allclose(found[name], [each[name][0] for each in plain], rtol=FITTED_ALPHA), name

    @pytest.mark.nightly
    def test_a_texture_on_the_surface_is_no_texture_in_space(self, mi: Any) -> None:
        assert not read({"type": "pplastic", "alpha": CHECKER}).fitted.fit.parts.positional

    def test_the_extent_is_that_of_the_scene(self, mi: Any) -> None:
        from lobewise.render.materials.bsdfs import _measure_extent

        ball = {"type": "sphere", "center": [3.0, -7.0, 1.0], "radius": 2.0}
        assert np.isclose(_measure_extent(mi.load_dict({"type": "scene", "ball": ball})), 9.0)
        assert _measure_extent(mi.load_dict({"type": "scene"})) == 1.0

    def test_attributes_of_meshes_are_named(self, mi: Any) -> None:
        from lobewise.render.integrators import tell_unseen
        from lobewise.render.materials.bsdfs import tell_attributes

        def make(alpha: Any) -> Any:
            bsdf = {"type": "twosided", "inner": {"type": "pplastic", "id": "paint", "alpha": alpha}}
            ball = {"type": "sphere", "bsdf": bsdf}
            return mi.load_dict({"type": "scene", "ball": ball, "sensor": {"type": "perspective"}})

        worn = {"type": "mesh_attribute", "name": "vertex_wear"}
        scene = make({"type": "checkerboard", "color0": worn, "color1": 0.2})
        assert "BSDF 'paint' reads the mesh attribute 'vertex_wear'" in tell_attributes(scene)
        assert tell_attributes(scene) in tell_unseen(scene)
        assert tell_attributes(make(0.2)) == ""
        # The roughness of a plugin with a formula is read at the hit.
        known = {"type": "roughconductor", "alpha": worn}
        assert tell_attributes(mi.load_dict({"type": "scene", "ball": {"type": "sphere", "bsdf": known}})) == ""


class TestOnePlace:
    @pytest.mark.nightly
    def test_equal_squares_give_the_lobes_of_no_texture(self, mi: Any) -> None:
        same = {"type": "checkerboard", "color0": 0.2, "color1": 0.2}
        one, two = (read({"type": "pplastic", "alpha": alpha}).fitted.fit for alpha in (same, 0.2))
        assert one.places is None
        assert np.array_equal(one.rows, two.rows)
        for name in ("axis", "sharpness", "amplitude", "alpha", "albedo"):
            assert np.array_equal(getattr(one.tables[0], name), getattr(two.tables[0], name)), name

    @pytest.mark.nightly
    def test_a_texture_of_color_has_one_node(self, mi: Any, rough: str) -> None:
        assert read({"type": rough, "rough": 0.2, "color": ramp_texture(0.05, 0.9)}).fitted.fit.places is None
        assert read({"type": "pplastic", "diffuse_reflectance": ramp_texture(0.05, 0.9)}).fitted.fit.places is None

    def test_small_changes_have_one_node(self, rough: str) -> None:
        assert read({"type": rough, "rough": ramp_texture(0.195, 0.205)}).fitted.fit.places is None

    @pytest.mark.nightly
    def test_numbers_of_tables_follow_each_other(self, mi: Any, rough: str) -> None:
        from lobewise.render.materials.bsdfs import list_lobe_tables, read_material

        fits: list[Any] = []
        bsdfs = [{"type": rough, "rough": CHECKER}, {"type": register_lobes(), "sharp": 50.0}]
        materials = [read_material(mi.load_dict(bsdf), fits) for bsdf in [*bsdfs, bsdfs[0]]]
        assert [material.number for material in materials] == [1, 3, 1]
        assert len(list_lobe_tables(dict(enumerate(materials)))) == 3
        assert describe(materials[1], 0.5)["material"].tolist() == [3.0]
        assert sorted(describe(materials[2], [0.1, 0.9])["material"]) == [1.0, 2.0]

    @pytest.mark.nightly
    def test_a_second_scene_fits_nothing(self, rough: str, monkeypatch: pytest.MonkeyPatch) -> None:
        from lobewise.render.materials import fitted

        bsdf = {"type": rough, "rough": CHECKER}
        first = read(bsdf)
        monkeypatch.setattr(fitted, "_make_fit", lambda *_: pytest.fail("fitted again"))
        assert read(bsdf).fitted.fit.rows is first.fitted.fit.rows


class TestMathematics:
    @pytest.mark.nightly
    def test_hits_are_located_as_places_are(self, mi: Any, rough: str) -> None:
        import drjit as dr

        from lobewise.render.materials.probe import evaluate_bsdf
        from lobewise.render.materials.texture_nodes import locate, make_signature

        texture = ramp_texture(SHARP, WIDE)
        bsdf = mi.load_dict({"type": rough, "rough": texture})
        material = read({"type": rough, "rough": texture})
        places = material.fitted.fit.places
        u = np.linspace(0.03, 0.97, 17)
        si = dr.zeros(mi.SurfaceInteraction3f, len(u))
        si.wi = mi.Vector3f(0, 0, 1)
        si.uv = mi.Point2f(np.stack([u, u]).astype(np.float32))
        spot = material.fitted.look_up_spot(bsdf, si, mi.Bool(True))
        pairs = [np.tile(each, (len(u), 1)) for each in (places.view, places.light)]
        uv = np.repeat(np.stack([u, u], axis=1), len(places.view), axis=0)
        values = evaluate_bsdf(bsdf, *pairs, place=uv)[:, 0].reshape(len(u), -1) * places.light[:, 2]
        edge, _, _, share, *_ = locate(NUMPY, make_signature(values).T, places.signature, places.edges)
        assert np.array_equal(np.array(spot.edge), edge)
        assert np.allclose(np.array(spot.share), share, atol=1e-3)
        assert np.allclose(np.array(spot.level)[0], values @ places.weight, rtol=1e-3)
        assert np.array_equal(np.array(spot.first), places.edges[edge, 0])

    def test_nodes_are_joined_by_the_shortest_tree(self, rng: np.random.Generator) -> None:
        from lobewise.render.materials.texture_nodes import _join_nodes

        nodes = rng.random((8, 5))
        length = np.linalg.norm(nodes[:, None] - nodes, axis=-1)
        edges = _join_nodes(nodes)
        assert len(edges) == 7
        assert np.isclose(length[edges[:, 0], edges[:, 1]].sum(), minimum_spanning_tree(length).sum())

    def test_signatures_do_not_depend_on_scale(self, rng: np.random.Generator) -> None:
        from lobewise.render.materials.texture_nodes import make_signature

        values = rng.random((5, 7))
        values[2] = 0.0
        one, two = make_signature(values), make_signature(values * rng.random((5, 1)))
        assert np.allclose(one, two, atol=EXACT)
        assert np.allclose(np.linalg.norm(one, axis=1), [1, 1, 0, 1, 1])

    @pytest.mark.parametrize("columns", [2, 6])
    def test_weights_are_those_of_scipy(self, rng: np.random.Generator, columns: int) -> None:
        from lobewise.render.materials.tints import solve_nonnegative

        for _ in range(10):
            system, target = rng.normal(size=(12, columns)), rng.normal(size=12)
            assert np.allclose(solve_nonnegative(system, target), nnls(system, target)[0], atol=1e-8)


def make_lights() -> np.ndarray:
    """Return lights about the mirror direction of the view (0.6, 0, 0.8), of equal solid angles."""
    rng = np.random.default_rng(3)
    light = rng.normal(size=(200000, 3))
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    return np.asarray(light[light @ [-0.6, 0.0, 0.8] > 0.5])


def mi_transform() -> Any:
    import mitsuba as mi

    return mi.ScalarTransform3f()
