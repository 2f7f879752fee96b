"""Exported pipelines of the tests, each exported and run once for all of them."""

import re
import subprocess
from pathlib import Path
from typing import Any

from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.pipeline.writing import export_pipeline

STRICT = ("-Wall", "-Wextra", "-pedantic", "-Werror")
LIBRARIES = ("-lpthread", "-ldl", "-lm")


def build(folder: Path, *words: str) -> str:
    """Run a compiler, or what it made, in a folder; return what it printed, and fail with it."""
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def export(folder: Path, **settings: Any) -> Path:
    """Export a pipeline into a folder and return it."""
    export_pipeline(folder, PipelineSettings(**settings))
    return folder


def run_example(folder: Path, compiler: str) -> list[float]:
    """Build and run the example of an export; return the difference of each frame to Python's result."""
    build(folder, compiler, "-std=c++11", *STRICT, "example.cpp", "liblobewise.a", "-o", "example", *LIBRARIES)
    return [float(word) for word in re.findall(r"difference (\S+)", build(folder, "./example"))]
