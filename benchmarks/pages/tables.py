"""Markdown that all pages share: tables, lists of facts, and the machine that measured a result."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

RATIOS = ("error over the noisy one, geometric mean", "largest", "worse than noisy")
"""Heads of the columns of `describe_ratios`."""


def describe_ratios(ratios: NDArray[np.float64], digits: int) -> list[str]:
    """Return the cells of errors over noisy ones, (count,): geometric mean, largest, how many are worse than noisy."""
    worse = f"{np.count_nonzero(ratios > 1.0)} of {len(ratios)}"
    return [f"{np.exp(np.log(ratios).mean()):.{digits}f}", f"{ratios.max():.2f}", worse]


def make_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table. Its first column is aligned to the left, the others to the right."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def list_facts(facts: Mapping[str, object]) -> str:
    """Return a Markdown list with one fact in each line."""
    return "\n".join(f"- {name}: {value}" for name, value in facts.items())


def describe_run(data: Mapping[str, Any]) -> str:
    """Return machine, threads and commit of a result."""
    machine = data["machine"]
    return f"{machine['processor']}, {machine['threads']} threads, commit {machine['commit']}"


def judge(is_met: bool) -> str:
    """Return whether a goal is met, in a word."""
    return "met" if is_met else "missed"
