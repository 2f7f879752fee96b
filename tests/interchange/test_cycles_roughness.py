"""What Blender's "Denoising Roughness" means, held against a shader AOV that is the roughness itself."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from lobewise.interchange.values import undo_mean_roughness
from lobewise.records.frame import FloatArray

FRAME = Path(__file__).parents[1] / "data" / "foreign" / "blender_5.2_multipart.exr"


@pytest.fixture(scope="module")
def passes() -> dict[str, FloatArray]:
    """Every pass by its name, components in the order of the alphabet."""
    found: dict[str, list[FloatArray]] = {}
    with OpenEXR.File(str(FRAME), separate_channels=True) as file:
        for part in file.parts:
            for name in sorted(part.channels):
                pixels = np.asarray(part.channels[name].pixels, dtype=np.float32)
                found.setdefault(name.split(".")[1], []).append(pixels)
    return {name: np.stack(planes, axis=-1) for name, planes in found.items()}


def test_undone_mean_roughness_is_that_of_the_material(passes: dict[str, FloatArray]) -> None:
    mean, wanted = (passes[name][..., 0] for name in ("Denoising Roughness", "Roughness"))
    specular = passes["Glossy Color"] + passes["Transmission Color"]
    undone = undo_mean_roughness(mean, passes["Diffuse Color"], specular)
    roughness, known = undone
    # Channels a, b, g, r: id and share of the pixel's first object are r and g. At silhouettes all are mixtures.
    inside = known & (passes["CryptoObject00"][..., 2] > 0.99)
    assert inside.mean() > 0.5
    assert len(np.unique(np.round(wanted[inside], 2))) >= 5
    apart = np.abs(roughness - wanted)[inside]
    assert np.median(apart) < 1e-3
    assert np.quantile(apart, 0.95) < 0.02
    # As it comes the pass is another number.
    assert np.median(np.abs(mean - wanted)[inside]) > 0.05
