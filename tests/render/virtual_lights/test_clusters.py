"""Clusters of virtual lights against sums over the lights."""

import numpy as np
import pytest

pytestmark = pytest.mark.mitsuba


def draw_lights(count: int, seed: int = 0):
    """Return lights on the walls of a cube, some of them glossy."""
    from lobewise.render.virtual_lights.clusters import Lights

    rng = np.random.default_rng(seed)
    side, position = rng.integers(0, 6, count), rng.uniform(-1.0, 1.0, (count, 3))
    normal = np.zeros((count, 3))
    sign = np.where(side % 2, 1.0, -1.0)
    normal[np.arange(count), side // 2] = -sign
    position[np.arange(count), side // 2] = sign
    axis = normal + 0.3 * rng.normal(size=(count, 3))
    return Lights(
        position=position,
        normal=normal,
        axis=axis / np.linalg.norm(axis, axis=1)[:, None],
        sharpness=rng.uniform(1.0, 500.0, count),
        diffuse=rng.uniform(0.0, 1.0, (count, 3)),
        glossy=rng.uniform(0.0, 1.0, (count, 3)) * (rng.uniform(size=(count, 1)) < 0.3),
    )


@pytest.mark.parametrize(("count", "size"), [(1, 1), (1, 8), (7, 1), (64, 8), (100, 8), (1000, 5)])
def test_flux_of_clusters_is_that_of_the_lights(count: int, size: int) -> None:
    from lobewise.render.virtual_lights.clusters import make_clusters

    lights = draw_lights(count)
    found = make_clusters(lights, size)
    assert found.count & (found.count - 1) == 0
    assert found.count * size >= count > (found.count // 2) * size
    for flux, whole in ((found.diffuse, lights.diffuse), (found.glossy, lights.glossy)):
        np.testing.assert_allclose(flux[found.count :].sum(axis=0), whole.sum(axis=0), rtol=1e-12)
        for node in range(1, found.count):
            np.testing.assert_allclose(flux[node], flux[2 * node] + flux[2 * node + 1], rtol=1e-12, atol=1e-15)


def test_a_cluster_of_one_light_is_the_light() -> None:
    from lobewise.render.virtual_lights.clusters import make_clusters

    lights = draw_lights(50)
    found = make_clusters(lights, 1)
    bright = np.flatnonzero(found.diffuse[found.count :].sum(axis=1) > 0)
    assert len(bright) == 50
    member = found.members[bright, 0]
    assert sorted(member) == list(range(50))
    leaf = bright + found.count
    np.testing.assert_allclose(found.position[leaf], lights.position[member], atol=1e-12)
    np.testing.assert_allclose(found.covariance[leaf], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.normal[leaf], lights.normal[member], atol=1e-12)
    np.testing.assert_allclose(found.normal_length[leaf], 1.0)
    glossy = lights.glossy[member].sum(axis=1) > 0
    assert 5 < glossy.sum() < 45
    np.testing.assert_allclose(found.axis[leaf][glossy], lights.axis[member][glossy], atol=1e-12)
    # The length of the mean is turned to a sharpness again, with an error of some per cent.
    np.testing.assert_allclose(found.sharpness[leaf][glossy], lights.sharpness[member][glossy], rtol=0.06)


def test_the_root_describes_all_lights() -> None:
    from lobewise.lobes.vectors import LUMINANCE
    from lobewise.render.virtual_lights.clusters import make_clusters

    lights = draw_lights(64)
    found = make_clusters(lights, 8)
    weight = (lights.diffuse + lights.glossy) @ np.array(LUMINANCE)
    mean = np.average(lights.position, axis=0, weights=weight)
    np.testing.assert_allclose(found.position[1], mean, rtol=1e-9)
    expected = np.cov(lights.position.T, aweights=weight)[np.triu_indices(3)]
    np.testing.assert_allclose(found.covariance[1], expected, rtol=1e-9)
    normal = np.average(lights.normal, axis=0, weights=weight)
    np.testing.assert_allclose(found.normal_length[1] * found.normal[1], normal, atol=1e-12)


def test_clusters_are_small_and_flat() -> None:
    from lobewise.render.virtual_lights.clusters import make_clusters

    lights = draw_lights(4096)
    found = make_clusters(lights, 8)
    assert found.count == 512
    normals = lights.normal[found.members]
    # Few clusters join two walls of the cube.
    assert np.ptp(normals, axis=1).max(axis=1).astype(bool).mean() < 0.1
    variance = found.covariance[found.count :][:, [0, 3, 5]].sum(axis=1)
    # 4096 lights on 24 square units: cells of 0.047 square units have a variance of their area over 6.
    assert np.median(variance) < 2.0 * (24.0 / 512) / 6.0


def test_members_are_drawn_by_their_flux() -> None:
    from lobewise.render.virtual_lights.clusters import Lights, make_clusters

    flux = np.array([0.0, 1.0, 2.0, 5.0])[:, None] * np.ones(3)
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    position = np.arange(12.0).reshape(4, 3)
    found = make_clusters(Lights(position, up, up, np.full(4, 1e3), flux, 0.0 * flux), 4)
    assert found.count == 1
    # Of four members in proportion to 0, 1, 2 and 5, at an eighth, three, five and seven eighths.
    assert sorted(found.members[0]) in ([1, 2, 3, 3], [2, 2, 3, 3], [1, 3, 3, 3], [2, 3, 3, 3])
