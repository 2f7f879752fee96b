"""BSDFs without a formula: lobes fitted to what they answer, against the formulas of those that have one."""

import gc
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise import denoise
from lobewise.errors import MissingDependencyError, UnsupportedBsdfError
from lobewise.fitting.fit import LUMINANCE
from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.table import evaluate_lobes, evaluate_table
from lobewise.records.frame import Frame, GBuffer, LobeKind
from tests.mistakes import refuses
from tests.render.items import make_square
from tests.render.materials.measured_file import write_measured
from tests.render.materials.python_bsdf import register_lobes
from tests.render.materials.test_bsdfs import COPPER, WRAPPERS, flat_normals, middle, ramp_texture, rgb
from tests.render.tolerances import EXACT, FITTED_ALBEDO, FITTED_ALPHA, FITTED_LOBES, FITTED_TEXTURE, NOISE

pytestmark = pytest.mark.mitsuba

Furnace = Callable[..., Frame]
Guide = Callable[..., GBuffer]

GGX = {"type": "roughconductor", "distribution": "ggx", **COPPER}


@pytest.fixture(scope="module")
def lobes(mi: Any) -> str:
    """Return the name of a plugin that is written in Python."""
    return register_lobes()


@pytest.fixture
def fit_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take away the formulas of two plugins, so that they are fitted."""
    from lobewise.render.materials import bsdfs

    known = {"RoughConductor", "RoughPlastic", "SmoothDiffuse"}
    rest = {name: plugin for name, plugin in bsdfs.PLUGIN_OF_CLASS.items() if name not in known}
    monkeypatch.setattr(bsdfs, "PLUGIN_OF_CLASS", rest)


def fit(mi: Any, bsdf: dict[str, Any]) -> Any:
    from lobewise.render.materials.fitted import fit_bsdf

    return fit_bsdf(mi.load_dict(bsdf))


@pytest.fixture(scope="module")
def frame(mi: Any, lobes: str, make_box_scene: Callable[..., Any]) -> Frame:
    """Return a small frame of a ball and a plate of such BSDFs, one nested; and of metal that has a formula."""
    from lobewise.render import render_frame

    place = mi.ScalarTransform4f().translate([0.7, 0.1, 0.3]).rotate([1, 0, 0], -90).scale(0.8)
    nested = {
        "type": "twosided",
        "inner": {"type": "normalmap", "normalmap": flat_normals(0.1, 0.05), "inner": {"type": lobes}},
    }
    scene = make_box_scene(
        {
            "left": {"type": "sphere", "center": [-0.7, 0.6, 0.0], "radius": 0.6, "bsdf": nested},
            "plate": make_square(place, bsdf={"type": lobes, "id": "mine", "sharp": 30.0}),
            "metal": {"type": "sphere", "center": [-0.2, 0.4, 0.9], "radius": 0.4, "bsdf": {**GGX, "alpha": 0.2}},
        }
    )
    return render_frame(scene, spp=8, seed=2)


@pytest.mark.nightly
class TestAgainstFormulas:
    @pytest.mark.parametrize("cos_view", [1.0, 0.85, 0.5])
    def test_metal(self, guide: Guide, fit_all: None, cos_view: float) -> None:
        gbuffer = guide({**GGX, "alpha": 0.2}, cos_view=cos_view)
        assert np.all(gbuffer.lobe_kind == LobeKind.GGX)
        assert np.allclose([gbuffer.alpha_u, gbuffer.alpha_v], 0.2, rtol=FITTED_ALPHA)
        assert np.all(gbuffer.material == 1)

    @pytest.mark.parametrize(
        "bsdf",
        [
            {**GGX, "alpha": 0.2},
            {**GGX, "alpha_u": 0.1, "alpha_v": 0.3},
            {"type": "roughplastic", "distribution": "ggx", "alpha": 0.15, "diffuse_reflectance": rgb(0.6, 0.3, 0.1)},
            {"type": "diffuse", "reflectance": rgb(0.7, 0.4, 0.2)},
        ],
        ids=["metal", "brushed", "plastic", "diffuse"],
    )
    def test_albedos_are_the_furnace_radiance(self, furnace: Furnace, fit_all: None, bsdf: dict[str, Any]) -> None:
        frame = furnace(bsdf, cos_view=0.6, spp=256)
        for name in ("diffuse", "specular"):
            seen, told = middle(getattr(frame.radiance, name)), middle(getattr(frame.gbuffer, f"{name}_albedo"))
            assert np.allclose(told, seen, atol=FITTED_ALBEDO), name
        assert (middle(frame.radiance.diffuse).max() > 0.1) == ("alpha" not in str(bsdf) or "plastic" in bsdf["type"])

    @pytest.mark.parametrize("turn", [0.6, pytest.param(2.0, marks=pytest.mark.nightly)])
    def test_long_axis(self, guide: Guide, lobes: str, turn: float) -> None:
        gbuffer = guide({"type": lobes, "sharp": 40.0, "wide": 20.0, "stretch": 2.0, "turn": turn}, cos_view=0.9)
        # The square lies in the plane z = 0, its tangent along x.
        told = np.arctan2(gbuffer.tangent[..., 1], gbuffer.tangent[..., 0])
        assert np.abs(np.sin(told - turn)).max() < 0.05
        ratio = gbuffer.alpha_u / gbuffer.alpha_v
        assert np.allclose(ratio, 4.0, rtol=0.1)

    @pytest.mark.parametrize("bsdf", [{"stretch": 1.6, "turn": 0.6}, {}], ids=["brushed", "isotropic"])
    def test_guides_and_table_give_the_lobes_of_a_hit(self, mi: Any, lobes: str, bsdf: dict[str, float]) -> None:
        """What filters make of a pixel, from its normal, view and tangent in the world, against the BSDF there."""
        from lobewise.render.materials.bsdfs import read_material
        from lobewise.render.materials.surface import describe_material

        turn = mi.ScalarTransform4f().rotate([0.36, 0.8, -0.48], 40)
        inner = {"type": lobes, "sharp": 15.0, "wide": 6.0, **bsdf}
        shape = {"type": "rectangle", "to_world": turn, "bsdf": {"type": "twosided", "inner": inner}}
        scene = mi.load_dict({"type": "scene", "square": shape})
        plate = scene.shapes()[0].bsdf()
        material = read_material(plate)
        table = material.nested[0].fitted.fit.tables[0]
        light = np.random.default_rng(1).normal(size=(20000, 3))
        light /= np.linalg.norm(light, axis=1, keepdims=True)
        # Half way between the azimuths of the table, where lobes that changed places would meet.
        for azimuth in 0.6 + (np.arange(8) + 0.5) * np.pi / 4:
            toward = np.array(turn.matrix)[:3, :3] @ [0.5 * np.cos(azimuth), 0.5 * np.sin(azimuth), np.sqrt(0.75)]
            si = scene.ray_intersect(mi.Ray3f(mi.Point3f((5.0 * toward).tolist()), mi.Vector3f((-toward).tolist())))
            surface = describe_material(material, si, mi.Bool(True))
            normal, tangent = (np.array(getattr(surface, name)).ravel() for name in ("normal", "tangent"))
            told = evaluate_lobes(evaluate_table(table, normal, toward, tangent), light, table.kind)
            out = si.to_local(mi.Vector3f(np.ascontiguousarray(light.T, dtype=np.float32)))
            seen = np.array(plate.eval(mi.BSDFContext(), si, out)).T @ np.array(LUMINANCE)
            assert told @ seen / np.linalg.norm(told) / np.linalg.norm(seen) > FITTED_LOBES

    @pytest.mark.parametrize("turn", [1.2, *(pytest.param(turn, marks=pytest.mark.nightly) for turn in (0.3, 3.0))])
    def test_brushed_alphas_at_every_azimuth(self, mi: Any, fit_all: None, turn: float) -> None:
        import drjit as dr

        from lobewise.render.materials.bsdfs import read_material
        from lobewise.render.materials.surface import describe_material

        material = read_material(mi.load_dict({**GGX, "alpha_u": 0.1, "alpha_v": 0.3}))
        si = dr.zeros(mi.SurfaceInteraction3f, 3)
        si.sh_frame = mi.Frame3f(mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0), mi.Vector3f(0, 0, 1))
        cosine = np.array([0.2, 0.6, 0.95])
        sine = np.sqrt(1.0 - cosine**2)
        si.wi = mi.Vector3f(np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine]).astype(np.float32))
        surface = describe_material(material, si, mi.Bool(True))
        assert np.allclose(np.abs(np.array(surface.tangent).T[0]), [0, 1, 0], atol=0.02)
        assert np.allclose(np.array(surface.alpha_u), 0.3, rtol=FITTED_ALPHA)
        assert np.allclose(np.array(surface.alpha_v), 0.1, rtol=FITTED_ALPHA)

    def test_diffuse_texture_is_read_at_the_hit(self, mi: Any, fit_all: None) -> None:
        import drjit as dr

        from lobewise.render.materials.bsdfs import read_material
        from lobewise.render.materials.surface import describe_material

        material = read_material(mi.load_dict({"type": "diffuse", "reflectance": ramp_texture(0.1, 0.9)}))
        si = dr.zeros(mi.SurfaceInteraction3f, 3)
        si.wi = mi.Vector3f(0.6, 0.0, 0.8)
        u = np.array([0.2, 0.5, 0.8])
        si.uv = mi.Point2f(np.stack([u, u]).astype(np.float32))
        surface = describe_material(material, si, mi.Bool(True))
        assert np.allclose(np.array(surface.diffuse_albedo), 0.1 + 0.8 * u, atol=1e-3)
        assert np.all(np.array(surface.lobe_kind) == LobeKind.NONE)

    @pytest.mark.parametrize("plugin", ["roughconductor", "principledthin"])
    def test_specular_texture_is_read_at_the_hit(self, mi: Any, fit_all: None, plugin: str) -> None:
        import drjit as dr

        from lobewise.render.materials.bsdfs import read_material
        from lobewise.render.materials.surface import describe_material

        def make(value: Any) -> Any:
            if plugin == "roughconductor":
                bsdf = {**GGX, "alpha": 0.2, "specular_reflectance": value}
            else:
                bsdf = {"type": plugin, "base_color": value, "roughness": 0.3, "diff_trans": 0.4}
            return read_material(mi.load_dict(bsdf))

        si = dr.zeros(mi.SurfaceInteraction3f, 4)
        sine = np.array([0.0, 0.5, 0.7, 0.95])
        si.wi = mi.Vector3f(np.stack([sine, 0.0 * sine, np.sqrt(1.0 - sine**2)]).astype(np.float32))
        textured = make(ramp_texture(0.1, 0.9))
        for u in (0.15, 0.8):
            si.uv = mi.Point2f(u, 0.5)
            told = np.array(describe_material(textured, si, mi.Bool(True)).specular_albedo)
            plain = np.array(describe_material(make(rgb(*[0.1 + 0.8 * u] * 3)), si, mi.Bool(True)).specular_albedo)
            assert np.allclose(told, plain, atol=FITTED_TEXTURE), u

    def test_rows_are_looked_up_between_views_and_azimuths(self, mi: Any, rng: np.random.Generator) -> None:
        import drjit as dr

        from lobewise.render.materials.fitted import Fit
        from lobewise.render.materials.fitted_hits import FittedLobes
        from lobewise.render.materials.probe import Parts

        # The corners of cells, and points between, also between the last azimuth and the first.
        view, azimuth = np.array([0.0, 2.25, 4.75, 3.5, 1.0]), np.array([0.0, 3.0, 7.5, 5.25, 2.0])
        cosine = (np.sqrt(0.05) + (1.0 - np.sqrt(0.05)) * view / 5.0) ** 2
        turn = 0.4 + 2.0 * np.pi * azimuth / 8.0
        sine = np.sqrt(1.0 - cosine**2)
        si = dr.zeros(mi.SurfaceInteraction3f, 5)
        for columns in (8, 1):
            rows = rng.random((6, columns, 11)).astype(np.float32)
            fit = Fit(
                Parts(False, True, False, True, False, False, True), LobeKind.GGX, (), 0.4 if columns > 1 else 0.0, rows
            )
            si.wi = mi.Vector3f(np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine]).astype(np.float32))
            found = np.array([np.array(value) for value in FittedLobes(fit).look_up(si, mi.Bool(True))])
            low, left = view.astype(int), azimuth.astype(int)
            share, part = (view - low)[:, None], (azimuth - left)[:, None]
            high = np.minimum(low + 1, 5)
            ends = [(rows[low, k % columns], rows[high, k % columns]) for k in (left, left + 1)]
            one, two = (below + share * (above - below) for below, above in ends)
            assert np.allclose(found.T[1:], (one + part * (two - one))[1:], atol=1e-4), columns
            assert np.allclose(found.T[0], one[0], atol=1e-4)

    def test_questions_of_a_reflection(self) -> None:
        from lobewise.render.materials.fitted import is_isotropic, list_fitted_views

        def stretch(by: float) -> Callable[..., Any]:
            return lambda view, light: ggx_brdf(view, light, 0.2 * by, 0.2 / by)

        assert is_isotropic(stretch(1.0))
        assert not is_isotropic(stretch(1.05))
        cosines = np.array([0.2, 0.5, 0.8, 1.0])
        velvet = list_fitted_views(lambda view, light: (view[:, 2] < 0.7) * light[:, 0] ** 2, cosines)
        assert velvet.tolist() == [0.2, 0.5]


@pytest.mark.nightly
class TestPythonBsdf:
    def test_guides_are_finite_and_name_their_tables(self, frame: Frame) -> None:
        material = frame.gbuffer.material
        assert material is not None
        assert set(np.unique(material)) == {0.0, 1.0, 2.0}
        assert [table.lobe_count for table in frame.lobe_tables] == [3, 3]
        assert "mine" in [table.name for table in frame.lobe_tables]
        for name in ("alpha_u", "alpha_v", "tangent", "normal", "specular_albedo", "hit_position"):
            assert np.isfinite(getattr(frame.gbuffer, name)).all(), name
        fitted = material > 0
        length = np.linalg.norm(frame.gbuffer.tangent[fitted], axis=-1)
        assert np.allclose(length, 1.0, atol=EXACT)
        assert np.abs((frame.gbuffer.tangent * frame.gbuffer.normal).sum(axis=-1)[fitted]).max() < EXACT
        assert np.all(frame.gbuffer.lobe_kind[fitted] == LobeKind.GGX)
        assert frame.gbuffer.specular_albedo[fitted].min() > 0
        assert np.all(frame.radiance.diffuse[fitted].mean() < frame.radiance.specular[fitted].mean())

    @pytest.mark.parametrize("similarity", ["sg_mixture", "ggx"])
    def test_it_denoises(self, frame: Frame, similarity: str) -> None:
        result = denoise(frame, similarity=similarity, radius=3)
        assert np.isfinite(result.image).all()
        plate = frame.gbuffer.material == 1 + [table.name for table in frame.lobe_tables].index("mine")
        assert np.median(result.effective_samples[plate]) > 2.0

    def test_without_fitted_materials_there_is_no_channel(self, make_box_scene: Callable[..., Any]) -> None:
        from lobewise.render import render_frame

        frame = render_frame(make_box_scene({}, size=4), spp=1, aov_only=True)
        assert frame.gbuffer.material is None
        assert frame.lobe_tables == ()

    def test_wrappers_are_opened(self, guide: Guide, lobes: str) -> None:
        bare = guide({"type": lobes})
        for name, wrap in WRAPPERS:
            wrapped = guide(wrap({"type": lobes}))
            for field in ("alpha_u", "alpha_v", "lobe_kind", "normal", "material"):
                assert np.allclose(getattr(bare, field), getattr(wrapped, field), atol=1e-3), (name, field)

    def test_all_that_heeds_no_context_is_specular(self, furnace: Furnace, lobes: str) -> None:
        blend = {"type": "blendbsdf", "weight": 0.5, "a": {"type": lobes}, "b": {"type": "diffuse"}}
        frame = furnace(blend, spp=256)
        assert np.allclose(middle(frame.radiance.diffuse), 0.25, atol=NOISE)
        assert np.allclose(middle(frame.radiance.specular), middle(frame.gbuffer.specular_albedo), atol=FITTED_ALBEDO)

    def test_it_is_black_from_behind(self, guide: Guide, lobes: str) -> None:
        behind = guide({"type": lobes}, behind=True)
        assert np.all(behind.lobe_kind == LobeKind.NONE)
        assert np.all(behind.material == 0)
        both = guide({"type": "twosided", "inner": {"type": lobes}}, behind=True)
        assert np.allclose(both.alpha_u, guide({"type": lobes}).alpha_u, atol=EXACT)
        assert np.all(both.material == 1)

    def test_a_frame_is_fitted_once_and_keeps_no_bsdf(
        self, mi: Any, lobes: str, make_furnace: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        from lobewise.render.materials import fitted
        from lobewise.render.materials.bsdfs import read_scene_materials

        fits = []
        monkeypatch.setattr(fitted, "_fits", type(fitted._fits)())
        monkeypatch.setattr(fitted, "_make_fit", lambda *of, make=fitted._make_fit: fits.append(1) or make(*of))
        gc.collect()
        before = sum(isinstance(item, mi.BSDF) for item in gc.get_objects())
        for sharp in (50.0, 50.0, 60.0):
            read_scene_materials(make_furnace({"type": lobes, "sharp": sharp}))
        assert len(fits) == 2
        gc.collect()
        assert sum(isinstance(item, mi.BSDF) for item in gc.get_objects()) <= before


class TestOtherPlugins:
    @pytest.mark.nightly
    def test_a_pane_is_a_mirror_that_rays_may_pass(self, mi: Any, furnace: Furnace) -> None:
        bsdf = {"type": "thindielectric", "specular_reflectance": rgb(0.9, 0.6, 0.3)}
        found = fit(mi, bsdf)
        assert (found.kind, found.tables, found.can_be_transparent) == (LobeKind.DELTA, (), True)
        # A sheet reflects 2 r / (1 + r) of the light along the normal, r being that of one side: 0.04 for 1.5.
        assert np.isclose(found.rows[-1, 0, 8], 1.0 - mean_of_pane(bsdf), atol=0.01)
        frame = furnace(bsdf, spp=256)
        assert np.all(frame.gbuffer.depth == 0)
        assert frame.gbuffer.material is None
        seen = furnace({**bsdf, "int_ior": 30.0}, spp=256)
        assert np.all(seen.gbuffer.lobe_kind == LobeKind.DELTA)
        assert np.allclose(middle(seen.gbuffer.specular_albedo), middle(seen.radiance.specular), atol=NOISE)

    def test_measured_file(self, mi: Any, tmp_path: Path) -> None:
        write_measured(tmp_path / "paint.bsdf", 0.2, (0.8, 0.4, 0.2))
        found = fit(mi, {"type": "measured", "filename": str(tmp_path / "paint.bsdf"), "id": "paint"})
        assert (found.kind, found.tables[0].name, found.is_isotropic) == (LobeKind.GGX, "paint", True)
        # Without masking and Fresnel it is no GGX: seen from aslant the nearest one is narrower.
        assert np.allclose(found.rows[6:, 0, :2], 0.2, rtol=FITTED_ALPHA)
        # Seen from above light at t has its half vector at t / 2, and the integral of D(half) / 4 is near that of
        # D(half) cos(half) over half vectors, which is 1.
        assert np.allclose(found.rows[-1, 0, 2:5], [0.8, 0.4, 0.2], rtol=0.05)

    @pytest.mark.sampled("pplastic")
    @pytest.mark.parametrize("plugin", [pytest.param("hair", marks=pytest.mark.nightly), "pplastic"])
    def test_albedos_are_the_furnace_radiance(self, furnace: Furnace, plugin: str) -> None:
        frame = furnace({"type": "mask", "opacity": 1.0, "inner": {"type": plugin}}, spp=512)
        assert np.all(frame.gbuffer.lobe_kind == LobeKind.GGX)
        for name in ("diffuse", "specular"):
            seen, told = middle(getattr(frame.radiance, name)), middle(getattr(frame.gbuffer, f"{name}_albedo"))
            assert np.allclose(told, seen, atol=FITTED_ALBEDO), name

    def test_what_cannot_be_evaluated_is_named(self, mi: Any) -> None:
        from lobewise.render.materials.bsdfs import read_material

        mi.register_bsdf("lobewise_test_empty", lambda props: mi.BSDF(props))
        bsdf = mi.load_dict({"type": "mask", "inner": {"type": "lobewise_test_empty", "id": "my_bsdf"}})
        with refuses(UnsupportedBsdfError, "BSDF 'my_bsdf'") as caught:
            read_material(bsdf)
        # Dr.Jit calls every BSDF that is alive, and the error holds this one.
        del bsdf, caught
        gc.collect()

    def test_without_scipy(self, mi: Any, lobes: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "scipy.optimize", None)
        with refuses(MissingDependencyError, "fitting lobes"):
            fit(mi, {"type": lobes, "sharp": 12.3})


def mean_of_pane(bsdf: dict[str, Any]) -> float:
    """Return how often a ray passes a pane seen from above, where Mitsuba chooses by the untinted reflectance."""
    side = (0.504 / 2.504) ** 2
    return 1.0 - 2.0 * side / (1.0 + side)
