"""The program `lobewise`: typed verbs, one sentence for every mistake, nothing heavy imported before it is needed."""

from __future__ import annotations

from lobewise.cli.main import main

__all__ = ["main"]
