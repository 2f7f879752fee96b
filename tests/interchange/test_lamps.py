"""Lamps in images whose light is not told apart do not spoil what is around them."""

import numpy as np

import lobewise
from lobewise.interchange.reading import import_planes
from lobewise.metrics import rel_mse

LAMP, INSIDE = np.s_[10:20, 12:30], np.s_[12:18, 14:28]


def make_planes(rng: np.random.Generator) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the channels of a noisy wall with a lamp on it, normals and a striped albedo, and its truth."""
    stripes = np.where(np.arange(48) % 8 < 4, 0.2, 0.8)[None, :, None] * np.ones((40, 1, 3))
    truth, noisy = 0.5 * stripes, 0.5 * stripes * rng.gamma(4.0, 0.25, (40, 48, 1))
    for image in truth, noisy:
        image[LAMP] += 40.0
    planes = {name: noisy[..., k] for k, name in enumerate("RGB")}
    planes |= {f"albedo.{name}": stripes[..., k] for k, name in enumerate("RGB")}
    planes |= {f"sh_normal.{name}": np.full((40, 48), float(k == 2)) for k, name in enumerate("XYZ")}
    return {name: plane.astype(np.float32) for name, plane in planes.items()}, truth


def test_a_lamp_passes_as_it_is_and_nothing_takes_of_it(rng: np.random.Generator) -> None:
    planes, truth = make_planes(rng)
    found = import_planes(planes)
    assert any("show lamps" in note for note in found.notes)
    for quality in ("fast", "balanced", "high"):
        clean = lobewise.denoise(found.frame, quality=quality).image
        # The network of "high" smooths the edges of lamps.
        kept = INSIDE if quality == "high" else LAMP
        np.testing.assert_array_equal(clean[kept], found.frame.radiance.color[kept])
        assert rel_mse(clean, truth) < 0.3 * rel_mse(found.frame.radiance.color, truth)


def test_light_that_is_told_apart_needs_no_search(rng: np.random.Generator) -> None:
    planes, _ = make_planes(rng)
    planes |= {f"{name}.{letter}": 0.5 * planes[letter] for name in ("diffuse", "specular") for letter in "RGB"}
    mapping = {name: f"{name}.R,{name}.G,{name}.B" for name in ("diffuse", "specular")}
    found = import_planes(planes, mapping=mapping)
    assert not any("lamps" in note for note in found.notes)
    assert found.frame.gbuffer.normal[LAMP].any()
