"""Compression with loss: which channels it changes, and what becomes of light that it left below 0."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from renderers import WRITERS, make_scene

import lobewise
from lobewise.denoising.bad_pixels import mark_bad_pixels
from lobewise.interchange.checks.compression import is_lossy
from lobewise.interchange.reading import import_file
from lobewise.io.exr.parsing import read_container
from lobewise.records.frame import FloatArray

NAMES = ("R", "G", "B", "A", "Y", "RY", "BY", "X", "Z", "r", "g", "b", "y", "a.Y", "a.X", "a.RED", "b.R", "b.G", "b.B")
LOSSY = ("DWAA", "DWAB", "B44", "B44A")
ALL = {"color", "diffuse", "specular"}


def write(path: Path, compression: str, *, zero: float = 0.0) -> Path:
    """Write the scene as Cycles, light in 16 bits as Blender does; ``zero`` is put at the first pixel of its image."""
    written = WRITERS["cycles"](make_scene())
    channels = {}
    for name, plane in written.channels.items():
        light = name.rpartition(".")[2] in "RGB"
        channels[name] = np.ascontiguousarray(plane.astype(np.float16 if light else np.float32))
        if name.endswith("Combined.R") and zero:
            channels[name][0, 0] = zero
    header = {"type": OpenEXR.scanlineimage, "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    OpenEXR.File({**header, **written.attributes}, channels).write(str(path))
    return path


@pytest.mark.parametrize("compression", [*LOSSY, "ZIP", "ZIPS", "PIZ", "RLE", "NO"])
@pytest.mark.parametrize("kind", [np.float16, np.float32, np.uint32])
def test_which_channels_lose_is_what_the_library_does(compression: str, kind: type, tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    planes = {name: (50.0 * rng.random((32, 32))).astype(kind) for name in NAMES}
    header = {"type": OpenEXR.scanlineimage, "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    # The library changes the dictionary that it is given.
    OpenEXR.File(header, dict(planes)).write(str(tmp_path / "a.exr"))
    file = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    read = file.channels()
    (part,) = read_container(tmp_path / "a.exr").parts
    lossy = {channel.name for channel in part.channels if is_lossy(part, channel)}
    assert lossy == {name for name in NAMES if not np.array_equal(read[name].pixels, planes[name])}


def compute_error(a: FloatArray, b: FloatArray) -> float:
    return float(np.mean((a - b) ** 2 / (b**2 + 1e-2)))


def test_light_just_below_0_counts_as_0(tmp_path: Path) -> None:
    """It would be refilled by its neighbours otherwise, which is far from what is there."""
    lossy, whole = (import_file(write(tmp_path / f"{kind}.exr", kind)) for kind in ("DWAA", "ZIP"))
    assert {one.what: one.mended for one in lossy.findings} == {
        "compressed with loss": False,
        "light below 0 by compression": True,
    }
    assert whole.findings == ()
    (told,) = (note for note in lossy.notes if "altered" in note)
    for label in ("Combined.R/G/B", "Normal.X/Y/Z", "Position.X/Y/Z"):
        assert label in told
    assert "Depth" not in told, "its channel is Z"
    assert "with ZIP" in told
    assert not mark_bad_pixels(lossy.frame).any()
    images = [lobewise.denoise(one.frame, quality="fast").image for one in (lossy, whole)]
    assert compute_error(*images) < 0.002


def test_what_compression_cannot_have_made_stays(tmp_path: Path) -> None:
    """A pixel far below 0 is bad, in a file without loss any pixel below 0."""
    far = import_file(write(tmp_path / "a.exr", "DWAA", zero=-5.0)).frame
    assert mark_bad_pixels(far)[0, 0]
    near = import_file(write(tmp_path / "b.exr", "ZIP", zero=-1e-4))
    assert mark_bad_pixels(near.frame)[0, 0]
    assert near.findings == ()
