"""Binary files made at random are read or refused in a sentence."""

import pytest

from tests.fuzz.fuzzing import check_kind


@pytest.mark.sampled("merl")
@pytest.mark.parametrize("kind", ["merl", "camera_glb", "camera_usda", "camera_usdc", "checkpoint", "viewer"])
def test_binary_files(kind: str) -> None:
    check_kind(kind)
