"""Writes the bill of materials of a wheel: what it contains, what that was made with, and what pip installs beside it.

The form is CycloneDX 1.6. The library `cyclonedx-python-lib` writes it and checks it by the standard's schema. Versions
and digests of packages come from ``lock.txt``.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_URL, uuid5

from cyclonedx.model import ExternalReference, ExternalReferenceType, HashAlgorithm, HashType, Property, XsUri
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.model.license import LicenseExpression
from cyclonedx.model.lifecycle import LifecyclePhase, PredefinedLifecycle
from cyclonedx.model.tool import ToolRepository
from cyclonedx.output.json import JsonV1Dot6
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from benchmarks.common import ROOT
from lobewise.backend.prebuilt import INDEX_NAME
from releasing.lock import Locked, list_environments, read_lock

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PYTHON_SYSTEMS = {"linux": "linux", "windows": "win32", "macos": "darwin"}
"""Names of systems in markers, by the first word of those in `releasing.systems`."""
LICENCES = {
    "annotated-doc": "MIT",
    "annotated-types": "MIT",
    "colorama": "BSD-3-Clause",
    "cyclonedx-python-lib": "Apache-2.0",
    "halide": "MIT",
    "hatch-fancy-pypi-readme": "MIT",
    "hatchling": "MIT",
    "lazy-loader": "BSD-3-Clause",
    "llvm": "Apache-2.0 WITH LLVM-exception",
    "lobewise": "BSD-3-Clause",
    "markdown-it-py": "MIT",
    "mdurl": "MIT",
    "numpy": "BSD-3-Clause AND 0BSD AND MIT AND Zlib AND CC0-1.0",
    "openexr": "BSD-3-Clause",
    "packaging": "Apache-2.0 OR BSD-2-Clause",
    "pillow": "MIT-CMU",
    "platformdirs": "MIT",
    "pydantic": "MIT",
    "pydantic-core": "MIT",
    "pygments": "BSD-2-Clause",
    "rich": "MIT",
    "shellingham": "ISC",
    "tomli": "MIT",
    "typer": "MIT",
    "typing-extensions": "PSF-2.0",
    "typing-inspection": "MIT",
    "ziglang": "MIT",
}
"""Licences as expressions of SPDX. The metadata of many packages say them in words, or not at all."""


def read_project() -> dict[str, Any]:
    """Return the table ``project`` of ``pyproject.toml``."""
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project


def list_needed(
    requirements: Iterable[str], locked: Iterable[Locked], environments: Sequence[Mapping[str, str]]
) -> list[Locked]:
    """Return the locked packages that pip installs along with these requirements in any of the environments."""
    present = [each for each in locked if any(each.is_for(one) for one in environments)]
    names = {canonicalize_name(Requirement(line).name) for line in requirements}
    while True:
        found = [each for each in present if each.name in names or each.needers & names]
        if names.issuperset(each.name for each in found):
            return found
        names |= {each.name for each in found}


def describe(name: str, number: str, place: str, marker: str = "", **more: Any) -> Component:
    """Return the component of a package. ``place`` says where it is, ``marker`` for which versions of Python."""
    purl = PackageURL("generic" if name == "llvm" else "pypi", None, name, number)
    properties = {"lobewise:place": place, "lobewise:marker": marker}
    return Component(
        name=name,
        version=number,
        bom_ref=purl.to_string(),
        purl=purl,
        licenses=[LicenseExpression(LICENCES[name])],
        properties=[Property(name=key, value=value) for key, value in properties.items() if value],
        **more,
    )


def describe_needed(package: Locked) -> Component:
    """Return the component of a package that pip installs, with the digests of all its files."""
    page = XsUri(f"https://pypi.org/project/{package.name}/{package.version}/#files")
    hashes = [HashType(alg=HashAlgorithm.SHA_256, content=digest) for digest in package.digests]
    files = ExternalReference(type=ExternalReferenceType.DISTRIBUTION, url=page, hashes=hashes)
    return describe(
        package.name, str(package.version), "beside the wheel", str(package.marker or ""), external_references=[files]
    )


def describe_library(path: Path, number: str) -> Component:
    """Return the component of a library of kernels, which holds Halide's runtime."""
    name = f"lobewise/backend/prebuilt/{path.name}"
    return Component(
        name=name,
        version=number,
        type=ComponentType.FILE,
        bom_ref=name,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=hashlib.sha256(path.read_bytes()).hexdigest())],
        licenses=[LicenseExpression(f"{LICENCES['lobewise']} AND {LICENCES['halide']}")],
        properties=[Property(name="lobewise:place", value="in the wheel")],
    )


def list_tools(index: Mapping[str, Any]) -> list[Component]:
    """Return the components of the programs that made the libraries and the wheel."""
    linker, _, number = index["linker"].partition(" ")
    # A compiler of the system has no number here, and no licence that concerns its output.
    linkers = [describe(linker, number, "")] if number else [Component(name=linker)]
    names = ("hatchling", "hatch-fancy-pypi-readme", "cyclonedx-python-lib")
    builders = [describe(name, version(name), "") for name in names]
    return [describe("llvm", index["llvm"], ""), *linkers, *builders]


def make_sbom(kernels: Path, made: datetime) -> str:
    """Return the bill of materials of the wheel with a folder of libraries, as JSON.

    The same folder and time give the same text. Raises ValueError if the standard's schema refuses it.
    """
    index = json.loads((kernels / INDEX_NAME).read_bytes())
    project = read_project()
    own = describe("lobewise", project["version"], "")
    runtime = describe("halide", index["halide"], "in the wheel", description="Its runtime is part of the libraries.")
    libraries = [describe_library(kernels / level["file"], project["version"]) for level in index["levels"]]
    environments = list_environments([PYTHON_SYSTEMS[index["system"].partition("-")[0]]])
    needed = {each: describe_needed(each) for each in list_needed(project["dependencies"], read_lock(), environments)}
    digests = "".join(each.hashes[0].content for each in libraries)
    bom = Bom(
        serial_number=uuid5(NAMESPACE_URL, f"{own.purl} {index['wheel']} {made.isoformat()} {digests}"),
        metadata=BomMetaData(
            component=own,
            timestamp=made,
            tools=ToolRepository(components=list_tools(index)),
            lifecycles=[PredefinedLifecycle(LifecyclePhase.BUILD)],
        ),
        components=[runtime, *libraries, *needed.values()],
    )
    for library in libraries:
        bom.register_dependency(library, [runtime])
    for package, component in needed.items():
        parts = [part for each, part in needed.items() if is_needed(each, package, environments)]
        bom.register_dependency(component, parts)
    direct = {canonicalize_name(Requirement(line).name) for line in project["dependencies"]}
    bom.register_dependency(own, [*libraries, *(part for each, part in needed.items() if each.name in direct)])
    text = JsonV1Dot6(bom).output_as_string(indent=1)
    problem = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if problem is not None:
        raise ValueError(f"the bill of materials does not follow CycloneDX 1.6: {problem}")
    return text + "\n"


def is_needed(one: Locked, needer: Locked, environments: Iterable[Mapping[str, str]]) -> bool:
    """Return whether a package is there for another one in any environment."""
    return needer.name in one.needers and any(one.is_for(each) and needer.is_for(each) for each in environments)
