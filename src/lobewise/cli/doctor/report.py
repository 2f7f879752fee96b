"""The report of `lobewise doctor`: facts in sections, and problems with what to do about each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lobewise.errors import make_printable


@dataclass(frozen=True)
class Problem:
    """Something that is wrong with this machine."""

    what: str
    """What is wrong, without a full stop."""
    action: str
    """What to do about it, without a full stop."""
    fatal: bool = False
    """Whether lobewise cannot denoise because of it."""


@dataclass(frozen=True)
class Section:
    """Facts of one kind, and the problems among them."""

    title: str
    facts: dict[str, str]
    problems: tuple[Problem, ...] = ()


@dataclass(frozen=True)
class Report:
    """What `lobewise doctor` found."""

    version: str
    """Version of lobewise."""
    sections: tuple[Section, ...] = field(default_factory=tuple)

    @property
    def problems(self) -> tuple[Problem, ...]:
        """All problems, the fatal ones first."""
        listed = [problem for section in self.sections for problem in section.problems]
        return tuple(sorted(listed, key=lambda problem: not problem.fatal))

    @property
    def works(self) -> bool:
        """Whether lobewise can denoise here."""
        return not any(problem.fatal for problem in self.problems)

    def list_lines(self) -> Iterator[str]:
        """Yield the lines of the report as plain text."""
        yield f"lobewise {self.version}: {'works here' if self.works else 'cannot work here'}"
        width = max((len(name) for section in self.sections for name in section.facts), default=0)
        for section in self.sections:
            yield ""
            yield section.title
            for name, value in section.facts.items():
                yield f"  {name:<{width}}  {make_printable(value)}"
        yield ""
        yield "Problems"
        for problem in self.problems:
            yield f"  {make_printable(f'{problem.what}: {problem.action}')}."
        if not self.problems:
            yield "  none"

    def to_record(self) -> dict[str, Any]:
        """Return the report for JSON."""
        return {
            "version": self.version,
            "works": self.works,
            "sections": {section.title: section.facts for section in self.sections},
            "problems": [vars(problem) for problem in self.problems],
        }


def name_path(path: str | Path) -> str:
    """Return a path for a report that strangers read: the home folder is written as ``~``."""
    text = str(path)
    try:
        inside = Path(text).relative_to(Path.home())
    except (RuntimeError, ValueError):
        return text
    return str(Path("~") / inside)
