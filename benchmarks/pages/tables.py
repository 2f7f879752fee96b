"""What the pages share: tables in Markdown, and on what a result was measured."""

from __future__ import annotations

from typing import Any


def make_table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def describe_run(data: dict[str, Any]) -> str:
    """Return machine, threads and commit of a result."""
    machine = data["machine"]
    return f"{machine['processor']}, {machine['threads']} threads, commit {machine['commit']}"
