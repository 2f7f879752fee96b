"""EXR files made at random are read as OpenEXR reads them, or refused in a sentence."""

from tests.fuzz.fuzzing import check_kind


def test_exr_files() -> None:
    check_kind("exr", share=3.0)
