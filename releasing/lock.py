"""Reads ``lock.txt``: a version of every package that tests and releases need, with the digests of its files.

`uv` writes the file (CONTRIBUTING.md says how) for all versions of Python and all systems, and pip installs it:

    pip install --require-hashes -r lock.txt
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import Distribution, distributions

from packaging.markers import Marker
from packaging.utils import canonicalize_name
from packaging.version import Version

from benchmarks.common import ROOT

LOCK = ROOT / "lock.txt"
PYTHON_MINORS = range(10, 15)
"""Versions of Python 3 that lobewise is for."""
OF_ENVIRONMENTS = frozenset({"pip", "setuptools", "lobewise"})
"""Packages that a fresh environment has, and this one."""
_LOCKED = re.compile(
    r"^(?P<name>[\w.-]+)==(?P<version>\S+)(?: ; (?P<marker>.+?))?"
    r"(?P<digests>(?: \\\n    --hash=sha256:[0-9a-f]{64})+)\n(?P<notes>(?:    #.*\n)*)",
    re.MULTILINE,
)


@dataclass(frozen=True)
class Locked:
    """A version of a package.

    Parameters
    ----------
    name : str
        Normal form of the name.
    version : Version
        The only version for an environment.
    marker : Marker or None
        The environments that get this version; None if all do.
    digests : tuple of str
        SHA-256 of each of its files.
    needers : frozenset of str
        Names of the packages that need it.
    """

    name: str
    version: Version
    marker: Marker | None
    digests: tuple[str, ...]
    needers: frozenset[str]

    def is_for(self, environment: Mapping[str, str] | None = None) -> bool:
        """Return whether an environment, by default this one, gets this version."""
        return self.marker is None or self.marker.evaluate(dict(environment or {}))


def parse_lock(text: str) -> list[Locked]:
    """Return the packages of a lock file. Raises ValueError at a line of any other form."""
    rest = _LOCKED.sub("", text)
    if [line for line in rest.splitlines() if not line.startswith("#")]:
        raise ValueError(f"lock.txt has lines that are no locked packages: {rest[:200]!r}")
    return [_interpret(match) for match in _LOCKED.finditer(text)]


def _interpret(match: re.Match[str]) -> Locked:
    needers = re.findall(r"^    # +(?:via )?([\w.-]+)", match["notes"], re.MULTILINE)
    return Locked(
        match["name"],
        Version(match["version"]),
        Marker(match["marker"]) if match["marker"] else None,
        tuple(re.findall("[0-9a-f]{64}", match["digests"])),
        frozenset(name for name in needers if name != "via"),
    )


def list_environments(systems: Iterable[str]) -> list[dict[str, str]]:
    """Return the values of markers for every version of Python on these systems."""
    return [
        {"python_version": f"3.{minor}", "python_full_version": f"3.{minor}.9", "sys_platform": system}
        for minor in PYTHON_MINORS
        for system in systems
    ]


def read_lock() -> list[Locked]:
    """Return the packages of the lock file."""
    return parse_lock(LOCK.read_text(encoding="utf-8"))


def list_misfits(locked: Iterable[Locked], installed: Iterable[Distribution]) -> Iterator[str]:
    """Yield a sentence for every package of this environment that the lock file does not have in this version."""
    wanted = {each.name: each.version for each in locked if each.is_for()}
    present = {canonicalize_name(each.name): Version(each.version) for each in installed}
    for name, version in sorted(wanted.items()):
        if present.get(name) != version:
            yield f"{name} is {present.get(name, 'not installed')}, and the lock file has {version}."
    for name in sorted(present.keys() - wanted.keys() - OF_ENVIRONMENTS):
        yield f"{name} is installed, and not in the lock file."


def require_locked() -> None:
    """End the program unless this environment has the packages of the lock file, and no others."""
    misfits = list(list_misfits(read_lock(), distributions()))
    if misfits:
        how = "make a fresh environment with `pip install --require-hashes -r lock.txt`"
        raise SystemExit("\n".join([*misfits, f"A release needs the locked packages: {how}."]))
