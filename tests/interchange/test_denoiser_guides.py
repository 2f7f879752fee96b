"""Albedo and normal reach Open Image Denoise as the file has them; our own filters get what they can divide by."""

import numpy as np

from lobewise import peers
from lobewise.interchange.describing import list_roles
from lobewise.interchange.preset import ROLES
from lobewise.interchange.reading import import_planes

SHAPE = (24, 32)


def make_planes(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return an image whose albedo is partly black, and whose normals are shorter in the middle, as at an edge."""
    color = rng.uniform(0.2, 0.8, (*SHAPE, 3))
    albedo = np.full((*SHAPE, 3), 0.6)
    albedo[:4] = 0.0
    normal = np.zeros((*SHAPE, 3))
    normal[:, :16, 2], normal[:, 16:, 0] = 1.0, 1.0
    normal[:, 16] = 0.5, 0.0, 0.5
    images = {"": color, "albedo.": albedo, "normal.": normal}
    letters = {"": "RGB", "albedo.": "RGB", "normal.": "XYZ"}
    return {
        f"{name}{letter}": image[..., k].astype(np.float32)
        for name, image in images.items()
        for k, letter in enumerate(letters[name])
    }


def test_the_peer_gets_the_file_s_own_guides(rng: np.random.Generator) -> None:
    planes = make_planes(rng)
    frame = import_planes(planes).frame
    guides = frame.gbuffer
    np.testing.assert_array_equal(guides.denoiser_albedo[..., 0], planes["albedo.R"])
    np.testing.assert_array_equal(guides.denoiser_normal[..., 2], planes["normal.Z"])
    # Ours: normals of length 1, and no albedo that light is divided by near 0.
    np.testing.assert_allclose(np.linalg.norm(guides.normal, axis=-1), 1.0, atol=1e-6)
    assert guides.diffuse_albedo.min() >= 0.1
    albedos, normal = peers._choose_guides(frame.gbuffer, "prefiltered")
    (albedo,) = albedos
    assert albedo is guides.denoiser_albedo
    assert normal is guides.denoiser_normal
    # "centre" are those of the ray through the pixel's centre.
    albedos, normal = peers._choose_guides(frame.gbuffer, "centre")
    assert albedos[0] is guides.diffuse_albedo
    assert normal is guides.normal


def test_they_are_not_called_unused(rng: np.random.Generator) -> None:
    import lobewise

    frame = import_planes(make_planes(rng)).frame
    result = lobewise.denoise(frame, quality="fast", similarity="normal")
    assert "denoiser_albedo" not in result.unused
    assert "denoiser_normal" not in result.unused


def test_a_normal_made_for_denoisers_comes_before_the_other(rng: np.random.Generator) -> None:
    planes = {f"ViewLayer.Combined.{letter}": rng.random(SHAPE).astype(np.float32) for letter in "RGB"}
    planes["ViewLayer.Depth.Z"] = np.ones(SHAPE, np.float32)
    for name in ("Normal", "Denoising Normal"):
        planes |= {f"ViewLayer.{name}.{letter}": rng.uniform(-1.0, 1.0, SHAPE).astype(np.float32) for letter in "XYZ"}
    found = import_planes(planes)
    guides = found.frame.gbuffer
    own = [planes[f"ViewLayer.Normal.{letter}"] for letter in "XYZ"]
    np.testing.assert_allclose(guides.normal, np.stack(own, -1) / np.linalg.norm(own, axis=0)[..., None], atol=1e-5)
    np.testing.assert_array_equal(guides.denoiser_normal[..., 1], planes["ViewLayer.Denoising Normal.Y"])
    for one, listed in ((found, True), (import_planes(make_planes(rng)), False)):
        # Nobody misses it in files without.
        meanings = {each.meaning for each in list_roles(one.map, one.frame)}
        assert (ROLES["denoiser_normal"] in meanings) == listed
