"""`lobewise upsample` of files of other renderers: the image is replaced in a copy of the file."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.interchange.channels import list_passes
from lobewise.io.exr.parsing import read_container
from tests.interchange import renderers


def write_sparse(path: Path, scale: int) -> dict[str, np.ndarray]:
    """Write a file of Arnold with light at one pixel of every block; return its channels."""
    written = renderers.write_arnold(renderers.make_scene())
    channels, light = dict(written.channels), ("", "diffuse", "specular")
    for name, plane in written.channels.items():
        if name.rpartition(".")[0] in light and name != "Z":
            channels[name] = np.zeros_like(plane)
            channels[name][1::scale, ::scale] = plane[1::scale, ::scale]
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, **written.attributes}
    OpenEXR.File(header, dict(channels)).write(str(path))
    return channels


def test_the_image_of_a_foreign_file_is_upsampled_in_a_copy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "in.exr", tmp_path / "out.exr"
    channels = write_sparse(source, 2)
    assert run(["upsample", str(source), "-o", str(out), "--scale", "2", "--place", "1,0"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "Read as Arnold" in told
    assert "Only the image is upsampled. Left as rendered: passes 'diffuse', 'specular'." in told
    sparse = lobewise.make_sparse(lobewise.read_frame(source), 2, (1, 0))
    # Lobes are compared: the guides of the file came along.
    assert sparse.camera is not None
    assert sparse.gbuffer.alpha_u is not None
    image, found = lobewise.upsample(sparse, radius=5).image, renderers.read_channels(out)
    assert found.keys() == channels.keys()
    for number, name in enumerate("RGB"):
        assert np.array_equal(found.pop(name), image[..., number])
    assert all(np.array_equal(plane, channels[name]) for name, plane in found.items())
    assert list_passes(read_container(out))[0].channels.keys() >= set("rgb")


def test_a_sequence_of_foreign_files_has_a_history(tmp_path: Path) -> None:
    for number in (1, 2):
        write_sparse(tmp_path / f"s.{number}.exr", 2)
    line = ["upsample", str(tmp_path / "s.#.exr"), "-o", str(tmp_path / "o.#.exr"), "--scale", "2", "--place", "1,0"]
    assert run([*line, "--temporal"]) == 0
    first, second = (renderers.read_channels(tmp_path / f"o.{number}.exr")["G"] for number in (1, 2))
    assert np.isfinite(second).all()
    assert not np.array_equal(first, second)
