"""The lobes of images: pixel by pixel against the reference lobes, and what they do with every kind of bad guide."""

from typing import NamedTuple

import numpy as np
import pytest

from lobewise.errors import InputError, MissingChannelError
from lobewise.guides.lobe_fields import (
    SPREAD_TURNS,
    default_tau,
    make_ggx_field,
    make_sg_field,
    spread_lobes,
)
from lobewise.records.camera import Camera
from lobewise.records.frame import GBuffer, LobeKind
from tests.lobes.oracles.brdf import reflect, reflect_sg
from tests.lobes.oracles.sg import sg_bandlimit
from tests.lobes.oracles.tangent import TangentLobe, make_tangent_lobe, tangent_approx_similarity
from tests.lobes.quadrature import normalize
from tests.mistakes import refuses

HEIGHT, WIDTH = 13, 17
TAU = 0.01
ROWS, COLUMNS = np.triu_indices(3)
SHAPES = {"axis": (3,), "sharpness": (), "tangent_axis": (3,), "covariance": (6,), "determinant": ()}


@pytest.fixture
def camera():
    return Camera(position=(0.5, -0.3, 5.0), forward=(-0.1, 0.05, -1.0), up=(0.0, 1.0, 0.1), fov_y=0.8, fov_x=0.9)


@pytest.fixture
def guides(rng, camera):
    """Guides of a bumpy anisotropic wall with every kind of lobe, as a dict of arrays."""
    rays = camera.make_ray_directions(WIDTH, HEIGHT).astype(np.float64)
    depth = rng.uniform(2.0, 6.0, (HEIGHT, WIDTH))
    normal = normalize(-rays + 0.8 * rng.normal(size=rays.shape))
    facing = np.sum(normal * -rays, axis=-1, keepdims=True)
    normal = np.where(facing < 0.05, -rays, normal)
    tangent = normalize(np.cross(normal, rng.normal(size=rays.shape)))
    return {
        "depth": depth,
        "position": camera.position + depth[..., None] * rays,
        "normal": normal,
        "tangent": tangent,
        "alpha_u": rng.uniform(0.02, 1.0, (HEIGHT, WIDTH)),
        "alpha_v": rng.uniform(0.02, 1.0, (HEIGHT, WIDTH)),
        "lobe_kind": rng.integers(1, 4, (HEIGHT, WIDTH)),
    }


class Lobes(NamedTuple):
    """Both kinds of lobes of an image; those of covariances have the Lambert lobe where there is no other."""

    valid: np.ndarray
    axis: np.ndarray
    sharpness: np.ndarray
    tangent_valid: np.ndarray
    tangent_axis: np.ndarray
    covariance: np.ndarray
    determinant: np.ndarray


def build(guides, camera, tau=TAU, diffuse_fallback=False):
    sg = make_sg_field(GBuffer(**guides), camera, tau=tau, diffuse_fallback=diffuse_fallback)
    ggx = make_ggx_field(GBuffer(**guides), camera, [tau])
    valid = sg.valid & ggx.valid
    return Lobes(valid, sg.axis, sg.sharpness, ggx.valid, *join_covariance(ggx, tau))


def join_covariance(ggx, tau):
    """Return axes, covariances (height, width, 6) and determinants of a field; 0, 0 and 1 without a lobe."""
    planes = [plane.astype(np.float64) for plane in ggx.lobes[tau]]
    axis, t, (large, small) = np.stack(planes[:3], -1), np.stack(planes[3:6], -1), planes[6:]
    across = np.eye(3) - axis[..., :, None] * axis[..., None, :]
    matrix = small[..., None, None] * across + t[..., :, None] * t[..., None, :]
    six = np.where(ggx.valid[..., None], matrix[..., ROWS, COLUMNS], 0.0)
    return [each.astype(np.float32) for each in (axis, six, large * small)]


def assert_harmless(field, where):
    assert not field.valid[where].any()
    for name, value in (("axis", 0.0), ("sharpness", 1.0)):
        np.testing.assert_array_equal(getattr(field, name)[where], np.float32(value))
    none = ~field.tangent_valid[where]
    for name, value in (("tangent_axis", 0.0), ("covariance", 0.0), ("determinant", 1.0)):
        np.testing.assert_array_equal(getattr(field, name)[where][none], np.float32(value))


def assert_equal(a, b):
    for name in ("valid", *SHAPES):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.mark.parametrize("anisotropic", [False, True])
def test_every_pixel_has_its_reference_lobe(guides, camera, anisotropic):
    if not anisotropic:
        del guides["alpha_v"]
    field = build(guides, camera)
    assert field.valid.all()
    kind = guides["lobe_kind"]
    rough = np.where(kind == LobeKind.DELTA, 0.0, 1.0)
    alpha_u = rough * guides["alpha_u"]
    alpha_v = rough * guides["alpha_v"] if anisotropic else alpha_u
    view = normalize(camera.position - guides["position"])
    normal, tangent = guides["normal"], guides["tangent"]

    np.testing.assert_allclose(field.axis, reflect(view, normal), atol=2e-6)
    with np.errstate(divide="ignore", invalid="ignore"):
        sharpness = reflect_sg(view, 2.0 / (alpha_u * alpha_v), normal)[1]
    np.testing.assert_allclose(field.sharpness, sg_bandlimit(sharpness, TAU), rtol=2e-5)

    for code, beckmann in ((LobeKind.GGX, False), (LobeKind.BECKMANN, True), (LobeKind.DELTA, False)):
        where = kind == code
        assert where.sum() > 20
        lobe = make_tangent_lobe(
            view[where], normal[where], alpha_u[where], alpha_v[where], tangent[where], tau=TAU, beckmann=beckmann
        )
        trace = np.sum(lobe.covariance[:, [0, 3, 5]], axis=-1, keepdims=True)
        np.testing.assert_allclose(field.tangent_axis[where], lobe.axis, atol=2e-6)
        np.testing.assert_allclose(field.covariance[where] / trace, lobe.covariance / trace, atol=5e-6)
        np.testing.assert_allclose(field.determinant[where], lobe.determinant, rtol=1e-4)


def test_shapes_dtypes_and_memory_layout(guides, camera):
    field = build(guides, camera)
    for name, channels in SHAPES.items():
        values = getattr(field, name)
        assert values.shape == (HEIGHT, WIDTH, *channels)
        assert values.dtype == np.float32
    assert field.valid.dtype == np.bool_


def test_depth_and_position_give_the_same_lobes(guides, camera):
    with_position = build({**guides, "depth": None}, camera)
    with_depth = build({**guides, "position": None}, camera)
    np.testing.assert_array_equal(with_position.valid, with_depth.valid)
    np.testing.assert_allclose(with_position.tangent_axis, with_depth.tangent_axis, atol=3e-6)
    np.testing.assert_allclose(with_position.axis, with_depth.axis, atol=3e-6)


def test_tangent_matters_only_where_the_lobe_is_anisotropic(guides, camera):
    plain = build({**guides, "alpha_v": None, "tangent": None}, camera)
    np.testing.assert_array_equal(plain.covariance, build({**guides, "alpha_v": None}, camera).covariance)
    np.testing.assert_array_equal(
        plain.covariance, build({**guides, "alpha_v": guides["alpha_u"], "tangent": None}, camera).covariance
    )
    turned = {**guides, "tangent": np.cross(guides["normal"], guides["tangent"])}
    assert np.abs(build(turned, camera).covariance - build(guides, camera).covariance).max() > 0.1
    swapped = {**turned, "alpha_u": guides["alpha_v"], "alpha_v": guides["alpha_u"]}
    np.testing.assert_allclose(build(swapped, camera).covariance, build(guides, camera).covariance, atol=1e-5)


def test_a_pixel_without_tangent_gets_the_isotropic_lobe_of_the_same_area(guides, camera):
    guides["lobe_kind"][4, 5] = LobeKind.GGX
    mean = np.sqrt(guides["alpha_u"] * guides["alpha_v"])
    expected = build({**guides, "alpha_u": mean, "alpha_v": None}, camera)
    for missing in (np.zeros(3), guides["normal"][4, 5] * 2.0, np.full(3, np.nan)):
        tangent = guides["tangent"].copy()
        tangent[4, 5] = missing
        field = build({**guides, "tangent": tangent}, camera)
        assert field.valid.all()
        np.testing.assert_allclose(field.covariance[4, 5], expected.covariance[4, 5], rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(field.tangent_axis[4, 5], expected.tangent_axis[4, 5], atol=1e-5)


@pytest.mark.parametrize("length", [0.1, 7.0])
def test_normals_and_tangents_need_not_have_unit_length(guides, camera, length):
    scaled = {**guides, "normal": length * guides["normal"], "tangent": length * guides["tangent"]}
    np.testing.assert_allclose(build(scaled, camera).covariance, build(guides, camera).covariance, atol=1e-5)


def test_mirrors_are_finite_through_the_band_limit(guides, camera):
    guides["lobe_kind"] = np.full((HEIGHT, WIDTH), LobeKind.DELTA)
    guides["alpha_u"][::2] = np.nan  # a mirror's roughness is not looked at
    field = build(guides, camera, tau=0.02)
    assert field.valid.all()
    np.testing.assert_allclose(field.sharpness, 2500.0, rtol=1e-5)
    np.testing.assert_allclose(field.determinant, 0.02**4, rtol=1e-5)
    across = np.eye(3) - field.tangent_axis[..., :, None] * field.tangent_axis[..., None, :]
    expected = 0.02**2 * across[..., ROWS, COLUMNS]
    np.testing.assert_allclose(field.covariance, expected, atol=1e-9)
    np.testing.assert_allclose(field.tangent_axis, field.axis, atol=1e-6)


def test_default_band_limit(camera):
    pixel = camera.get_pixel_angle(HEIGHT)
    assert default_tau(camera, HEIGHT) == pytest.approx(np.sqrt(pixel**2 + 0.002**2))


@pytest.mark.parametrize("tau", [0.0, -0.1, 1.5, np.nan, np.inf])
def test_a_band_limit_out_of_range_is_refused(guides, camera, tau):
    with refuses(InputError, "tau", expected="an angle from 1e-5 to 1 radian"):
        build(guides, camera, tau=tau)


@pytest.mark.parametrize("tau", [1e-5, 1.0])
def test_the_ends_of_the_band_limit_work(guides, camera, tau):
    field = build(guides, camera, tau=tau)
    assert field.valid.all()
    assert (field.determinant > 0.0).all()
    assert np.isfinite(field.sharpness).all()


def test_pixels_without_lobe_are_harmless(guides, camera):
    guides["lobe_kind"][2] = LobeKind.NONE
    guides["lobe_kind"][3] = 4  # not a kind
    guides["depth"][5] = 0.0
    guides["normal"][7] = 0.0
    field = build(guides, camera)
    where = np.zeros((HEIGHT, WIDTH), bool)
    where[[2, 3, 5, 7]] = True
    assert_harmless(field, where)
    assert field.valid[~where].all()


def test_without_lobe_kind_every_surface_is_ggx(guides, camera):
    del guides["lobe_kind"]
    guides["depth"][5] = 0.0
    field = build(guides, camera)
    assert field.valid.sum() == (HEIGHT - 1) * WIDTH
    explicit = build({**guides, "lobe_kind": np.full((HEIGHT, WIDTH), LobeKind.GGX)}, camera)
    assert_equal(field, explicit)


def test_diffuse_fallback(guides, camera):
    guides["lobe_kind"][2:5] = LobeKind.NONE
    guides["depth"][3] = 0.0
    guides["alpha_u"][2] = np.nan  # a diffuse surface's roughness is not looked at
    assert_harmless(build(guides, camera), np.s_[2:5])
    field = build(guides, camera, diffuse_fallback=True)
    assert_harmless(field, np.s_[3])
    normal = guides["normal"][[2, 4]]
    np.testing.assert_allclose(field.axis[[2, 4]], normal, atol=1e-6)
    np.testing.assert_allclose(field.tangent_axis[[2, 4]], normal, atol=1e-6)
    np.testing.assert_array_equal(field.sharpness[[2, 4]], 2.0)
    np.testing.assert_array_equal(field.determinant[[2, 4]], 0.25)
    expected = 0.5 * (np.eye(3) - normal[..., :, None] * normal[..., None, :])
    np.testing.assert_allclose(field.covariance[[2, 4]], expected[..., ROWS, COLUMNS], atol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("channel", ["depth", "position", "normal", "alpha_u", "alpha_v", "lobe_kind"])
def test_a_guide_that_is_not_finite_makes_its_pixel_invalid(guides, camera, channel, value):
    guides["lobe_kind"][:] = LobeKind.GGX
    guides["lobe_kind"] = guides["lobe_kind"].astype(np.float32)
    good = build(guides, camera)
    guides[channel] = guides[channel].copy()
    guides[channel][6, 3] = value
    field = build(guides, camera)
    bad = np.zeros((HEIGHT, WIDTH), bool)
    bad[6, 3] = True
    assert_harmless(field, bad)
    for name in SHAPES:
        np.testing.assert_array_equal(getattr(field, name)[~bad], getattr(good, name)[~bad])


def test_garbage_never_leaves_a_bad_number(rng, camera):
    strange = np.array([0.0, -0.0, 1.0, -1.0, np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-30, 1e-42, 3.4e38], np.float32)

    def junk(*channels):
        values = rng.normal(size=(HEIGHT, WIDTH, *channels)).astype(np.float32)
        where = rng.random(values.shape) < 0.2
        values[where] = rng.choice(strange, where.sum())
        return values

    seen = 0
    for round_ in range(40):
        guides = {"normal": junk(3), "alpha_u": junk(), "tangent": junk(3)}
        guides["position" if round_ % 2 else "depth"] = junk(3) if round_ % 2 else np.abs(junk())
        if round_ % 3:
            guides["alpha_v"] = junk()
        if round_ % 4:
            guides["lobe_kind"] = rng.choice([0, 1, 2, 3, 7, np.nan], (HEIGHT, WIDTH))
        field = build(guides, camera, diffuse_fallback=bool(round_ % 5))
        seen += field.valid.sum()
        for name in SHAPES:
            values = getattr(field, name)
            assert np.isfinite(values).all(), name
            if name == "tangent_axis":
                np.testing.assert_allclose(np.linalg.norm(values, axis=-1), field.tangent_valid, atol=1e-4)
            if name in ("sharpness", "determinant"):
                assert (values > 0.0).all()
    assert seen > 1000


def test_roughness_is_clamped(guides, camera):
    del guides["alpha_v"]
    guides["alpha_u"][0], guides["alpha_u"][1] = -0.5, 3.0
    clamped = {**guides, "alpha_u": np.clip(guides["alpha_u"], 0.0, 1.0)}
    assert_equal(build(guides, camera), build(clamped, camera))


def test_normals_that_face_away_are_bent_until_they_do_not(camera):
    # one row of normals that swings from the viewer to the opposite; lobes must follow without a jump
    width = 721
    rays = camera.make_ray_directions(width, 1).astype(np.float64)
    side = normalize(np.cross(rays, np.array([0.0, 1.0, 0.0])))
    angle = np.linspace(0.0, np.radians(150.0), width)[None, :, None]
    normal = -rays * np.cos(angle) + side * np.sin(angle)
    guides = {"depth": np.full((1, width), 3.0), "normal": normal, "alpha_u": np.full((1, width), 0.2)}
    field = build(guides, camera)
    assert field.valid.all()
    view = -rays
    for axis in (field.axis, field.tangent_axis):
        assert np.linalg.norm(np.diff(axis, axis=1), axis=-1).max() < 0.06
        # no lobe points back through the surface that reflects it: it stays on the viewer's side of grazing
        assert (np.sum(axis * -view, axis=-1) < 1.0 - 1e-5).all()
    assert (np.diff(np.log(field.determinant[0])) < 0.5).all()
    beyond = angle[0, :, 0] > np.pi / 2.0
    assert (field.determinant[0, beyond] > 0.0).all()


def test_pixels_without_covariance_lobe_are_harmless(guides, camera):
    guides["normal"][2] = np.nan
    field = make_ggx_field(GBuffer(**guides), camera, [TAU])
    *zero, large, small = (plane[2] for plane in field.lobes[TAU])
    assert not field.valid[2].any()
    assert all((plane == 0.0).all() for plane in zero)
    assert (large == 1.0).all()
    assert (small == 1.0).all()


def test_lobes_of_one_band_limit_have_the_bits_of_two(guides, camera):
    both, one = (make_ggx_field(GBuffer(**guides), camera, taus) for taus in ((0.3, TAU), (TAU,)))
    for first, second in zip(both.lobes[TAU], one.lobes[TAU], strict=True):
        assert first.tobytes() == second.tobytes()


def test_a_crop_has_the_bits_of_the_whole(guides, camera):
    # with positions a pixel's lobe depends on nothing but its own guides, not even on where vector lanes begin
    whole = build(guides, camera)
    rows, columns = slice(2, 9), slice(3, 14)
    crop = build({name: image[rows, columns] for name, image in guides.items()}, camera)
    for name in ("valid", *SHAPES):
        np.testing.assert_array_equal(getattr(crop, name), getattr(whole, name)[rows, columns])


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 7), (17, 3), (2, 4000)])
def test_every_size(camera, height, width):
    ones = np.ones((height, width))
    normal = np.broadcast_to(-camera.forward, (height, width, 3))
    field = build({"depth": ones, "normal": normal, "alpha_u": 0.3 * ones}, camera)
    assert field.valid.all()
    assert field.covariance.shape == (height, width, 6)


@pytest.mark.parametrize(
    ("missing", "named"),
    [
        (("normal",), "normal"),
        (("alpha_u",), "alpha_u"),
        (("position", "depth"), "position"),
        (("tangent",), "tangent"),
    ],
)
def test_a_missing_channel_is_named_with_its_remedy(guides, camera, missing, named):
    for name in missing:
        del guides[name]
    with refuses(MissingChannelError, f"channel {named}"):
        build(guides, camera)


def test_a_single_gaussian_needs_no_tangent(guides, camera):
    del guides["tangent"]
    assert make_sg_field(GBuffer(**guides), camera, tau=TAU, diffuse_fallback=False).valid.all()


def test_inputs_are_left_alone(guides, camera):
    before = {name: image.copy() for name, image in guides.items()}
    build(guides, camera)
    for name, image in guides.items():
        np.testing.assert_array_equal(image, before[name])


def test_single_precision_is_good_enough_for_similarities(guides, camera):
    # neighbouring pixels of a flat, sharp, grazing floor: the hardest case for float32
    height, width = 20, 60
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    view = -rays
    normal = normalize(np.cross(rays[10, 30], np.array([1.0, 0.0, 0.0])))
    normal = normalize(normal + 0.05 * view[10, 30])
    normal = normal if normal @ view[10, 30] > 0.0 else -normal
    keep = np.sum(normal * view, axis=-1) > 0.02
    alpha = 0.01
    field = build(
        {
            "depth": np.ones((height, width)),
            "normal": np.broadcast_to(normal, (height, width, 3)),
            "alpha_u": np.full((height, width), alpha),
        },
        camera,
        tau=0.005,
    )
    exact = make_tangent_lobe(view, normal, np.full((height, width), alpha), tau=0.005)

    def neighbours(lobe, shift):
        parts = [np.asarray(part, dtype=np.float64) for part in lobe]
        a, b = ([part[s] for part in parts] for s in (np.s_[:, :-shift], np.s_[:, shift:]))
        return tangent_approx_similarity(TangentLobe(*a), TangentLobe(*b), 8.0)

    single = TangentLobe(field.tangent_axis, field.covariance, field.determinant)
    both = keep[:, :-1] & keep[:, 1:]
    assert both.sum() > 100
    error = neighbours(single, 1) - neighbours(exact, 1)
    assert np.abs(error[both]).max() < 2e-3


def compute_turns(valid, axis):
    """Return by how much lobes are spread: the least squared turn of the axis to a neighbour, times its factor."""
    turns = np.zeros(valid.shape)
    for y, x in zip(*np.nonzero(valid), strict=True):
        found = [
            np.sum((axis[y + dy, x + dx] - axis[y, x]) ** 2)
            for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0))
            if 0 <= y + dy < valid.shape[0] and 0 <= x + dx < valid.shape[1] and valid[y + dy, x + dx]
        ]
        turns[y, x] = SPREAD_TURNS * min(found, default=0.0)
    return turns


@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (1, WIDTH), (HEIGHT, 1), (1, 1)], ids=str)
def test_lobes_are_spread_by_the_turn_from_pixel_to_pixel(guides, camera, size):
    guides["lobe_kind"][np.random.default_rng(5).random((HEIGHT, WIDTH)) < 0.2] = 0
    some = {name: image[: size[0], : size[1]] for name, image in guides.items()}
    sg = make_sg_field(GBuffer(**some), camera, tau=TAU, diffuse_fallback=False)
    turns = compute_turns(sg.valid, sg.axis.astype(np.float64))
    found = spread_lobes(sg)
    np.testing.assert_array_equal(found.axis, sg.axis)
    np.testing.assert_allclose(1.0 / found.sharpness, 1.0 / sg.sharpness + turns, rtol=1e-4)
