"""The packages that lobewise needs, and those of its extras, from the metadata of the installed package."""

from __future__ import annotations

import importlib
import platform
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version

from lobewise.cli.doctor.report import Problem, Section

MODULES = {"numpy": "numpy", "openexr": "OpenEXR", "pillow": "PIL", "halide": "halide", "llvmlite": "llvmlite.binding"}
"""Modules to load of packages that hold machine code, which may be that of another system."""
COMPILER = ("halide", "llvmlite")
"""Packages that compile kernels: without them Open Image Denoise may still denoise."""
_SKIPPED_EXTRAS = ("dev", "demo", "docs")
"""Extras that are other extras together, or are for people who change lobewise."""
_REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)\s*(?P<extras>\[[^\]]*\])?\s*(?P<versions>[^;]*)(?:;(?P<marker>.*))?")


@dataclass(frozen=True)
class Package:
    """A package that lobewise or one of its extras needs."""

    name: str
    versions: str
    """The versions that do, such as ``>=21,<22``; may be empty."""
    extra: str
    """The extra that needs the package; empty if lobewise itself does."""
    installed: str
    """The version that is installed; empty if there is none."""

    @property
    def fits(self) -> bool:
        """Whether the installed version does."""
        return bool(self.installed) and is_version_among(self.installed, self.versions)

    def describe_misfit(self, needer: str) -> str:
        """Return what is wrong with the installed version, which does not do for ``needer``."""
        return (
            f"{self.name} is of version {self.installed}, and {needer} needs {self.versions}, as other versions do not "
            "work or have published faults"
        )


def read_packages() -> list[Package]:
    """Return the packages that lobewise and its extras need; an empty list if lobewise is not installed by pip."""
    try:
        lines = requires("lobewise") or []
    except PackageNotFoundError:
        return []
    return list(parse_requirements(lines, sys.version_info[:2]))


def parse_requirements(lines: list[str], python: tuple[int, ...]) -> Iterator[Package]:
    """Yield the packages of requirements in the form of PEP 508, as far as lobewise's own requirements use it."""
    for line in lines:
        match = _REQUIREMENT.fullmatch(line.strip())
        if match is None or match["name"].lower() == "lobewise":
            continue
        marker = match["marker"] or ""
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)['\"]", marker)
        if not is_wanted_here(marker, python, sys.platform, platform.machine()):
            continue
        if extra is not None and extra[1] in _SKIPPED_EXTRAS:
            continue
        yield Package(
            match["name"], match["versions"].strip(), extra[1] if extra else "", _look_up_version(match["name"])
        )


def is_wanted_here(marker: str, python: tuple[int, ...], system: str, machine: str) -> bool:
    """Return whether a marker of PEP 508 asks for its package here, as far as lobewise's own markers go.

    Such a marker is a list of terms joined by "and"; a term in parentheses may be alternatives joined by "or".

    Examples
    --------
    >>> is_wanted_here("(sys_platform != 'linux' or platform_machine == 'x86_64')", (3, 12), "linux", "aarch64")
    False
    """
    here = {"sys_platform": system, "platform_machine": machine}

    def holds(term: str) -> bool:
        name, sign, value = re.findall(r"(\w+)\s*([<>=!]+)\s*['\"]([^'\"]*)", term)[0]
        if name == "python_version":
            return _compare(python, sign, _parse_version(value))
        return name not in here or (here[name] == value) == (sign == "==")

    terms = re.findall(r"\([^)]*\)|\w+\s*[<>=!]+\s*['\"][^'\"]*['\"]", marker)
    return all(any(map(holds, term.split(" or "))) for term in terms)


def is_version_among(version: str, versions: str) -> bool:
    """Return whether a version lies within limits such as ``>=1.1,<2``; other kinds of limits are not checked.

    Examples
    --------
    >>> is_version_among("1.10.2", ">=1.9,<2"), is_version_among("2.0rc1", ">=1.9,<2")
    (True, False)
    """
    limits = re.findall(r"(<=|>=|<|>)\s*([\d.]+)", versions)
    return all(_compare(_parse_version(version), sign, _parse_version(limit)) for sign, limit in limits)


def examine_packages() -> Section:
    """Return the versions of the packages that lobewise needs, with a problem for each that is missing or broken."""
    packages = [package for package in read_packages() if not package.extra]
    facts = {package.name: package.installed or "not installed" for package in packages}
    problems = []
    if not packages:
        action = "pip install lobewise, or in a checkout pip install -e ."
        problems.append(Problem("lobewise was not installed by pip, so the versions it needs are unknown", action))
    for package in packages:
        want = f"{package.name}{package.versions}"
        if not package.installed and package.name.lower() in COMPILER:
            continue  # `lobewise.cli.doctor.machine.examine_kernels` says what their absence means
        if not package.installed:
            problems.append(Problem(f"{package.name} is not installed", f"pip install '{want}'", fatal=True))
        elif not package.fits:
            problems.append(Problem(package.describe_misfit("lobewise"), f"pip install '{want}'", fatal=True))
    problems += _list_broken(packages, fatal=True)
    return Section("Packages", facts, tuple(problems))


def examine_extras() -> Section:
    """Return what is installed of each extra. A missing extra is no problem; a wrong version is one."""
    extras: dict[str, list[Package]] = {}
    for package in read_packages():
        if package.extra:
            extras.setdefault(package.extra, []).append(package)
    facts, problems = {}, []
    for extra, packages in extras.items():
        versions = ", ".join(f"{package.name} {package.installed or 'not installed'}" for package in packages)
        lacks = not all(package.installed for package in packages)
        facts[extra] = f"{versions} (pip install 'lobewise[{extra}]')" if lacks else versions
        for package in packages:
            if package.installed and not package.fits:
                what = package.describe_misfit(f"lobewise[{extra}]")
                problems.append(Problem(what, f"pip install '{package.name}{package.versions}'"))
        problems += _list_broken(packages, fatal=False)
    return Section("Extras", facts, (*problems, *_list_oidn_problems()))


def _list_oidn_problems() -> list[Problem]:
    """Return a problem if Open Image Denoise is installed and cannot be loaded."""
    try:
        from lobewise.peers import look_up_oidn_fault
    except ImportError:
        return []  # without NumPy, which is a problem of its own
    fault = look_up_oidn_fault()
    return [Problem(fault.reason, fault.action)] if fault and fault.is_installed else []


def _list_broken(packages: list[Package], *, fatal: bool) -> list[Problem]:
    """Return a problem for each package that is installed and cannot be loaded.

    Those that compile kernels are never fatal here: `lobewise.cli.doctor.machine.examine_kernels` judges what is left.
    """
    problems = []
    for package in packages:
        module = MODULES.get(package.name.lower())
        reason = _try_to_load(module) if package.installed and module else ""
        if reason:
            action = f"pip install --force-reinstall --no-deps '{package.name}{package.versions}'"
            is_fatal = fatal and package.name.lower() not in COMPILER
            problems.append(Problem(f"{package.name} cannot be loaded ({reason})", action, is_fatal))
    return problems


def _look_up_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _try_to_load(module: str) -> str:
    """Return why a module cannot be loaded; empty if it can."""
    try:
        importlib.import_module(module)
    except Exception as problem:  # a broken extension can raise anything
        return " ".join(f"{type(problem).__name__}: {problem}".split())[:200]
    return ""


def _parse_version(text: str) -> tuple[int, ...]:
    """Return the release numbers of a version, without trailing zeros."""
    match = re.match(r"\d+(?:\.\d+)*", text)
    numbers = [int(part) for part in match[0].split(".")] if match else []
    while numbers and numbers[-1] == 0:
        numbers.pop()
    return tuple(numbers)


def _compare(one: tuple[int, ...], sign: str, two: tuple[int, ...]) -> bool:
    return {"<": one < two, "<=": one <= two, ">": one > two, ">=": one >= two, "==": one == two}[sign]
