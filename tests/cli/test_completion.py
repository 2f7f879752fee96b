"""Shells complete verbs, options and values."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("lobewise den", {"denoise"}),
        ("lobewise denoise --qual", {"--quality"}),
        ("lobewise denoise --quality ba", {"balanced"}),
        ("lobewise render sho", {"showroom"}),
    ],
)
def test_words_are_completed(line: str, expected: set[str]) -> None:
    words = {"COMP_WORDS": line, "COMP_CWORD": str(line.count(" ")), "_LOBEWISE_COMPLETE": "complete_bash"}
    done = subprocess.run(
        [sys.executable, "-m", "lobewise"], env={**os.environ, **words}, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == expected
    assert done.stderr == ""
