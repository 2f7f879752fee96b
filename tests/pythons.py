"""Interpreters that run programs of tests: this one, and those of programs that bring their own Python."""

import importlib.util
import os
import subprocess
import sys

import pytest


def run_python(*words: str, **more: str) -> str:
    """Return what this interpreter prints with some words, and fail with what it says; ``more`` are variables."""
    command, variables = [sys.executable, *words], {**os.environ, **more}
    done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def choose_python(module: str) -> str:
    """Return an interpreter that has a renderer's module: this one, or the one that a variable of its name tells."""
    variable = f"LOBEWISE_{module.upper()}_PYTHON"
    if importlib.util.find_spec(module):
        return sys.executable
    if variable not in os.environ:
        pytest.skip(f"no {module} here: pip install it, or set {variable} to a Python that has it")
    return os.environ[variable]


def run_without_paths(command: list[str], **more: str) -> None:
    """Run a program of another interpreter, which must not see the modules that PYTHONPATH shows to this one."""
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(command, check=True, env={**clean, **more}, capture_output=True, timeout=300)
