"""EXR files made at random are read as OpenEXR reads them, or refused in a sentence."""

import pytest

from tests.fuzz.fuzzing import check_kind


@pytest.mark.sampled("1.0")
@pytest.mark.parametrize("share", [1.0, 3.0])
def test_exr_files(share: float) -> None:
    check_kind("exr", share=share)
