"""Coverage and means over the areas of pixels, against areas known from geometry."""

from typing import Any

import numpy as np
import pytest

from lobewise.records.frame import GBuffer
from tests.render.items import make_camera, rgb
from tests.render.tolerances import EXACT

pytestmark = pytest.mark.mitsuba

SIZE = 24
EDGE = 1.0 / 16.0 + 1e-6
"""A straight edge, nearly upright or nearly level, splits at most one ray of the 16 rows or columns wrongly."""

SLANTED = 2.0 / 16.0
"""One that is slanted cuts through more of the 16 by 16 cells."""

RED, GREEN = (0.7, 0.2, 0.1), (0.1, 0.6, 0.2)


def make_wall(mi: Any, bsdf: dict[str, Any], *, right: float = 100.0, z: float = 0.0, turn: float = 0.0) -> Any:
    """Return a wall at ``z`` that reaches from far on the left to ``right``, turned about its right edge."""
    place = mi.ScalarTransform4f().translate([right, 0, z]).rotate([0, 0, 1], turn)
    return {"type": "rectangle", "to_world": place.translate([-100, 0, 0]).scale(100), "bsdf": bsdf}


def paint(color: tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "twosided", "inner": {"type": "diffuse", "reflectance": rgb(*color)}}


def render(mi: Any, size: int = SIZE, *, coverage: bool = True, **items: Any) -> GBuffer:
    """Render the guides of a square of ``size`` units, one per pixel, whose left upper corner is (0, size)."""
    from lobewise.render import render_frame

    far = 1000.0 * size
    half = 0.5 * size
    fov = float(np.rad2deg(2.0 * np.arctan(half / far)))
    sensor = make_camera(mi, [half, half, far], [half, half, 0], size=(size, size), fov=fov, far_clip=2.0 * far)
    scene = mi.load_dict({"type": "scene", "sensor": sensor, **items})
    return render_frame(scene, spp=1, aov_only=True, coverage=coverage).gbuffer


def gather(image: np.ndarray, k: int) -> np.ndarray:
    """Return the image of every pixel's neighbour ``k``, the border repeated."""
    height, width = image.shape[:2]
    wide = np.pad(image, ((1, 1), (1, 1), *((0, 0),) * (image.ndim - 2)), mode="edge")
    return wide[k // 3 : k // 3 + height, k % 3 : k % 3 + width]


def rebuild(coverage: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the sum over neighbours of coverage times image, pixel by pixel."""
    return sum(coverage[..., k, None] * gather(image, k) for k in range(9))


def check_shares(coverage: np.ndarray) -> None:
    """Check that shares are sixteenths, sum to 1, and leave out what is outside the image."""
    assert np.array_equal(coverage.sum(-1), np.ones(coverage.shape[:2]))
    assert np.array_equal(coverage * 16, np.rint(coverage * 16))
    assert coverage.min() >= 0
    for outside in (coverage[0, :, :3], coverage[-1, :, 6:], coverage[:, 0, ::3], coverage[:, -1, 2::3]):
        assert not outside.any()


def test_pattern_is_a_net(mi: Any) -> None:
    """Every block of the pixel of a sixteenth of its area holds one ray: 16x1, 8x2, 4x4, 2x8, 1x16."""
    from lobewise.render.coverage import RAYS, place_ray

    x, y = (np.array(each) for each in place_ray(mi.UInt32(np.arange(RAYS))))
    assert x.mean() == y.mean() == 0.5
    for columns in (1, 2, 4, 8, 16):
        blocks = np.floor(x * columns) + columns * np.floor(y * (16 // columns))
        assert len(set(blocks)) == 16


def test_interior_is_the_pixel_itself(mi: Any) -> None:
    gbuffer = render(mi, wall=make_wall(mi, paint(RED)))
    assert np.array_equal(gbuffer.coverage, np.broadcast_to(np.eye(9)[4], (SIZE, SIZE, 9)))
    assert np.allclose(gbuffer.mean_normal, (0, 0, 1), atol=EXACT)
    assert np.allclose(gbuffer.mean_diffuse_albedo, RED, atol=EXACT)
    assert not gbuffer.mean_specular_albedo.any()


def test_curved_surface_stands_for_itself(mi: Any) -> None:
    """A sphere, away from where it bends by a scale within a pixel."""
    ball = {"type": "sphere", "center": [12, 12, 0], "radius": 200.0, "bsdf": paint(RED)}
    coverage = render(mi, ball=ball).coverage
    assert np.array_equal(coverage[..., 4], np.ones((SIZE, SIZE)))


@pytest.mark.sampled(
    "texture-0.1", "texture-0.5", "silhouette-0.3", "silhouette-0.8", "step-0.8", "fold-0.5", "alpha-0.3", "kind-0.3"
)
@pytest.mark.parametrize("place", [0.1, 0.3, 0.5, 0.8])
@pytest.mark.parametrize("kind", ["texture", "silhouette", "step", "fold", "alpha", "kind"])
def test_upright_edge(mi: Any, kind: str, place: float) -> None:
    """Left of x = 8 + place is one surface and right of it another: the share is the place, whatever differs."""
    x = 8.0 + place
    # So dark that albedos, which differ with the lobes, tell nothing.
    dark = {"type": "roughconductor", "specular_reflectance": 0.02}
    rough, smooth = ({**dark, "alpha": alpha} for alpha in (0.4, 0.15))
    kindred = {**rough, "distribution": "ggx"}
    others = {
        "texture": {"back": make_wall(mi, paint(GREEN), z=-0.5)},
        "silhouette": {},
        "step": {"back": make_wall(mi, paint(RED), z=-20.0)},
        "fold": {"back": make_wall(mi, paint(RED), z=-0.5)},
        "alpha": {"back": make_wall(mi, smooth, z=-0.5)},
        "kind": {"back": make_wall(mi, kindred, z=-0.5)},
    }
    front = make_wall(mi, rough if kind in ("alpha", "kind") else paint(RED), right=x)
    if kind == "fold":
        place_of = mi.ScalarTransform4f().translate([x, 0, 0]).rotate([0, 1, 0], 30)
        front["to_world"] = place_of.translate([-100, 0, 0]).scale(100)
    coverage = render(mi, front=front, **others[kind]).coverage
    check_shares(coverage)
    inner = slice(1, -1)
    # The centre of pixel 8 shows the front where the edge is right of its middle.
    left, right = coverage[inner, 8][:, [0, 3, 6]].sum(-1), coverage[inner, 8][:, [2, 5, 8]].sum(-1)
    share = 1.0 - right if place >= 0.5 else left
    assert np.allclose(share, place, atol=EDGE)
    assert np.array_equal(left if place >= 0.5 else right, np.zeros(SIZE - 2))
    away = np.arange(SIZE) != 8
    assert np.array_equal(coverage[:, away, 4], np.ones((SIZE, SIZE - 1)))


def test_slanted_edge_and_means(mi: Any) -> None:
    """An edge through (8.3, 0), 20 degrees off the upright: exact areas from a fine grid of points."""
    front = make_wall(mi, paint(RED), right=8.3, turn=-20.0)
    gbuffer = render(mi, front=front, back=make_wall(mi, paint(GREEN), z=-0.5))
    check_shares(gbuffer.coverage)
    fine = 64
    x = (np.arange(SIZE * fine) + 0.5) / fine
    y = SIZE - x[:, None]
    on_front = (x - 8.3) * np.cos(np.deg2rad(20)) - y * np.sin(np.deg2rad(20)) < 0
    share = on_front.reshape(SIZE, fine, SIZE, fine).mean(axis=(1, 3))[..., None]
    assert np.count_nonzero((share > 0.05) & (share < 0.95)) > 20
    means = share * RED + (1.0 - share) * GREEN
    assert np.allclose(gbuffer.mean_diffuse_albedo, means, atol=SLANTED * 0.6)
    on_centre = on_front[fine // 2 :: fine, fine // 2 :: fine]
    front_share = rebuild(gbuffer.coverage, on_centre[..., None].astype(np.float32))
    assert np.abs(front_share - share).max() <= SLANTED
    assert np.abs(front_share - share).mean() < 0.01
    # What the pixel's centre alone tells is off by up to a half.
    assert np.abs(on_centre[..., None] - share).max() > 0.4


def test_round_silhouette(mi: Any) -> None:
    """The area of a disc, and the mean normal beside it: shorter by the share of the background."""
    ball = {"type": "sphere", "center": [12, 12, 0], "radius": 7.3, "bsdf": paint(RED)}
    gbuffer = render(mi, ball=ball)
    check_shares(gbuffer.coverage)
    on_ball = (gbuffer.depth > 0)[..., None].astype(np.float32)
    assert rebuild(gbuffer.coverage, on_ball).sum() == pytest.approx(np.pi * 7.3**2, rel=2e-3)
    assert gbuffer.mean_diffuse_albedo[..., 0].sum() / RED[0] == pytest.approx(np.pi * 7.3**2, rel=2e-3)
    # Normals of a ball add up to its disc: none are left over sideways.
    assert np.allclose(gbuffer.mean_normal.sum((0, 1)), (0, 0, 2 / 3 * np.pi * 7.3**2), atol=0.5)


def test_surface_of_no_centre_goes_to_a_surface(mi: Any) -> None:
    """A wire that no centre meets, where a wall ends: rays that meet it count to the wall, however unlike it is."""
    wire = make_wall(mi, {"type": "roughconductor", "alpha": 0.05}, right=9.0)
    wire["to_world"] = mi.ScalarTransform4f().translate([8.85, 0, 1.0]).scale([0.15, 100, 1])
    gbuffer = render(mi, wall=make_wall(mi, paint(RED), right=8.7), wire=wire)
    check_shares(gbuffer.coverage)
    assert gbuffer.position[..., 2].max() < 0.5
    assert np.array_equal(gbuffer.coverage[:, 8, 4], np.ones(SIZE))
    assert np.allclose(gbuffer.mean_diffuse_albedo[:, 8], 0.7 * np.array(RED), atol=EDGE)
    # A metal without a colour reflects nearly all.
    assert np.allclose(gbuffer.mean_specular_albedo[:, 8], 0.3, atol=EDGE + 0.03)


@pytest.mark.parametrize("opacity", [0.3, 0.7])
def test_mask_shows_what_is_behind_it_by_its_opacity(mi: Any, opacity: float) -> None:
    mask = {"type": "mask", "opacity": opacity, "nested": paint(RED)}
    gbuffer = render(mi, pane=make_wall(mi, mask, right=8.5), wall=make_wall(mi, paint(GREEN), z=-20.0, right=16.5))
    check_shares(gbuffer.coverage)
    mixed = opacity * np.array(RED) + (1.0 - opacity) * np.array(GREEN)
    assert np.allclose(gbuffer.mean_diffuse_albedo[:, :8], mixed, atol=EXACT)
    assert np.allclose(gbuffer.mean_diffuse_albedo[:, 9:16], GREEN, atol=EXACT)
    assert not gbuffer.mean_diffuse_albedo[:, 17:].any()
    assert np.allclose(gbuffer.mean_normal[:, :16], (0, 0, 1), atol=EXACT)
    # Coverage is of what centres show: a pane that is rather transparent has no edge.
    assert np.array_equal(gbuffer.coverage[:, 8, 4], np.full(SIZE, 1.0 if opacity < 0.5 else 0.5))


@pytest.mark.parametrize("opacity", [1.0, 0.3])
def test_mean_emission_is_that_of_the_area(mi: Any, opacity: float) -> None:
    """A lamp up to x = 8.3, behind a mask, before a sky: each by its share of the pixel and of the light."""
    lamp = make_wall(mi, paint(RED), right=8.3, z=-20.0)
    lamp["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": [5.0, 3.0, 1.0]}}
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.1, 0.2, 0.4]}}
    pane = make_wall(mi, {"type": "mask", "opacity": 1.0 - opacity, "nested": paint(GREEN)})
    gbuffer = render(mi, lamp=lamp, sky=sky, **({"pane": pane} if opacity < 1.0 else {}))
    bright, dim = opacity * np.array([5.0, 3.0, 1.0]), opacity * np.array([0.1, 0.2, 0.4])
    assert np.allclose(gbuffer.mean_emission[:, :8], bright, atol=1e-3)
    assert np.allclose(gbuffer.mean_emission[:, 9:], dim, atol=1e-3)
    assert np.allclose(gbuffer.mean_emission[:, 8], 0.3 * bright + 0.7 * dim, atol=5.0 * EDGE)


def test_indirect_light_has_no_mean_emission(mi: Any) -> None:
    from lobewise.render import render_frame

    camera = {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}}
    wall = make_wall(mi, paint(RED), z=-20.0)
    scene = mi.load_dict({"type": "scene", "camera": camera, "wall": wall, "sky": {"type": "constant"}})
    both, indirect = (render_frame(scene, spp=1, light=light).gbuffer for light in ("all", "indirect"))
    assert both.mean_emission is not None
    assert indirect.mean_emission is None


@pytest.mark.parametrize("pixels", [5, 20])
def test_tiles_change_nothing(mi: Any, monkeypatch: pytest.MonkeyPatch, pixels: int) -> None:
    from lobewise.render import renderer

    ball = {"type": "sphere", "center": [4, 4, 0], "radius": 2.7, "bsdf": paint(RED)}
    whole = render(mi, 8, ball=ball)
    monkeypatch.setattr(renderer, "TILE_PIXELS", pixels)
    tiled = render(mi, 8, ball=ball)
    for name in ("coverage", "mean_normal", "mean_diffuse_albedo", "mean_specular_albedo", "mean_emission"):
        assert np.array_equal(getattr(tiled, name), getattr(whole, name)), name


def test_coverage_can_be_left_out(mi: Any) -> None:
    whole, bare = (render(mi, 4, coverage=on, wall=make_wall(mi, paint(RED), right=2.3)) for on in (True, False))
    for name in GBuffer.__dataclass_fields__:
        image = getattr(bare, name)
        if name == "coverage" or name.startswith("mean_"):
            assert image is None
        else:
            assert np.array_equal(image, getattr(whole, name)), name


@pytest.mark.sampled("1")
@pytest.mark.parametrize("size", [1, 2])
def test_smallest_images(mi: Any, size: int) -> None:
    check_shares(render(mi, size, wall=make_wall(mi, paint(RED), right=0.7)).coverage)
