"""Documents made at random are read or refused in a sentence."""

import pytest

from tests.fuzz.fuzzing import check_kind


@pytest.mark.nightly
@pytest.mark.parametrize(
    "kind",
    [
        "lobes",
        "camera_path",
        "object_paths",
        "camera_json",
        "camera_xml",
        "camera_gltf",
        "preset",
        "map",
        "definitions",
    ],
)
def test_documents(kind: str) -> None:
    check_kind(kind)
