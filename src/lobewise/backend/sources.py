"""Digests of the code that kernels are made from: of all definitions that a kernel's maker refers to.

A definition is a statement at the top of a module: a function, a class, a constant. It counts together with all
definitions of this package that its code names, directly or through others, in any module. Comments, docstrings and
code that no maker refers to (checks of arguments, messages, help texts of settings) do not change the digest.
Annotations belong to the code of a definition, but the types that they name do not count: no kernel is made from them.

Taking a module apart takes some milliseconds, so the result is kept beside the compiled kernels, by the digest of the
module's bytes.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from lobewise.backend.disk import MAX_FILE_BYTES, locate_trusted_folder, write_whole
from lobewise.backend.trust import read_trusted

PACKAGE = "lobewise"
COMPILER = "lobewise.backend.compiler"
"""The module by which kernels read Halide. It stands for the library, whose version is a part of every key."""
_ROOT = Path(__file__).parents[1]
_KEPT = "sources.json"
_MAX_KEPT_MODULES = 2000

_Statement = tuple[str, list[str]]
"""Digest of a statement's syntax tree, and the dotted names that it reads."""


@dataclass(frozen=True)
class Source:
    """A module, taken apart."""

    definitions: dict[str, list[_Statement]]
    """By name: the statements of the module that define it or may change it."""
    imports: dict[str, list[str]]
    """By local name: the full names that imports of this package bind to it."""


def describe_definitions(names: Iterable[str]) -> str:
    """Return a digest of definitions, given as "lobewise.module.name", and of all definitions that they refer to.

    The name of a module stands for all its definitions.
    """
    lines = (f"{name} {digest}" for name, digests in sorted(digest_definitions(names).items()) for digest in digests)
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def digest_definitions(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the digests of definitions and of all that they refer to, by their full names."""
    digests: dict[str, list[str]] = {}
    waiting = list(names)
    sources = _open_kept(locate_trusted_folder())
    while waiting:
        for module, name, source in _resolve(waiting.pop(), sources):
            full_name = f"{module}.{name}"
            if full_name not in digests:
                statements = source.definitions[name]
                digests[full_name] = [digest for digest, _ in statements]
                waiting += [each for _, reads in statements for read in reads for each in _locate(module, source, read)]
    sources.write()
    return digests


def _resolve(full_name: str, sources: _Kept) -> Iterator[tuple[str, str, Source]]:
    """Yield module, name and source of the definitions that a full name means; nothing for names of no module."""
    module, rest = full_name, ""
    while (path := _locate_file(module)) is None:
        module, _, last = module.rpartition(".")
        rest = f"{last}.{rest}" if rest else last
        if not module:
            return
    source = sources.fetch(path)
    if full_name == module:
        for name in [*source.definitions, *source.imports]:
            yield from _resolve(f"{module}.{name}", sources)
    first, _, beyond = rest.partition(".")
    if first in source.definitions:
        yield module, first, source
    for target in source.imports.get(first, []):
        yield from _resolve(f"{target}.{beyond}" if beyond else target, sources)


def _locate(module: str, source: Source, read: str) -> list[str]:
    """Return the full names that a dotted name may mean in the code of a module."""
    first, _, beyond = read.partition(".")
    targets = [f"{target}.{beyond}" if beyond else target for target in source.imports.get(first, [])]
    return [*targets, f"{module}.{first}"] if first in source.definitions else targets


def take_apart(text: str) -> Source:
    """Return the definitions and imports of a module."""
    tree = ast.parse(text)
    imports: dict[str, list[str]] = defaultdict(list)
    definitions: dict[str, list[_Statement]] = defaultdict(list)
    for node in ast.walk(tree):
        for name, target in _list_imports(node):
            imports[name].append(target)
        body = getattr(node, "body", None)
        if isinstance(body, list):
            # Drop docstrings, also those below constants.
            node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
    statements: list[tuple[list[str], str, set[str]]] = []
    for node in tree.body:
        if not isinstance(node, (ast.Import, ast.ImportFrom)):
            digest = hashlib.sha256(ast.dump(node).encode()).hexdigest()[:32]
            statements.append((_list_defined(node), digest, set(_list_reads(node))))
    known = {*imports, *(name for names, _, _ in statements for name in names)}
    for names, digest, reads in statements:
        statement = digest, sorted(read for read in reads if read.partition(".")[0] in known)
        for name in names:
            definitions[name].append(statement)
    return Source(dict(definitions), {name: sorted(set(targets)) for name, targets in imports.items()})


def _list_imports(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield the local and the full name of everything of this package that a statement imports."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            if alias.name.partition(".")[0] == PACKAGE:
                yield (alias.asname, alias.name) if alias.asname else (PACKAGE, PACKAGE)
    elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == PACKAGE:
        for alias in node.names if node.module != COMPILER else ():
            yield alias.asname or alias.name, f"{node.module}.{alias.name}"


def _list_defined(node: ast.stmt) -> list[str]:
    """Return the names that a statement of a module defines or may change: of a loop, say, all that it mentions."""
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
        return [node.name]
    if isinstance(node, (ast.Assign, ast.AnnAssign)):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        return [each.partition(".")[0] for target in targets for each in _list_reads(target)]
    return sorted({each.partition(".")[0] for each in _list_reads(node)})


def _list_reads(node: ast.AST) -> Iterator[str]:
    """Yield the dotted names that code reads; annotations are left out."""
    if isinstance(node, ast.Name):
        yield node.id
        return
    if isinstance(node, ast.Attribute):
        names, root = [node.attr], node.value
        while isinstance(root, ast.Attribute):
            names.append(root.attr)
            root = root.value
        if isinstance(root, ast.Name):
            yield ".".join([root.id, *reversed(names)])
            return
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _list_reads(child)


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


@cache
def _locate_file(name: str) -> Path | None:
    first, *rest = name.split(".")
    if first != PACKAGE:
        return None
    path = _ROOT.joinpath(*rest)
    return next((each for each in (path.with_suffix(".py"), path / "__init__.py") if each.is_file()), None)


class _Kept:
    """Modules taken apart, by the digest of their bytes, of this code and of Python's version, remembered on disk."""

    def __init__(self, folder: Path | None) -> None:
        self._path = None if folder is None else folder / _KEPT
        # Versions of Python write syntax trees in different ways.
        self._maker = Path(__file__).read_bytes() + repr(sys.version_info[:2]).encode()
        self._known: dict[str, Any] = {}
        self._fetched: dict[Path, Source] = {}
        self._changed = False
        if self._path is not None:
            # A file that cannot be trusted or read is written anew.
            with suppress(OSError, ValueError, TypeError, AttributeError, RecursionError):
                text, _ = read_trusted(self._path, MAX_FILE_BYTES)
                self._known = dict(json.loads(text).items())

    def fetch(self, path: Path) -> Source:
        """Return the module of a file."""
        if path not in self._fetched:
            content = path.read_bytes()
            key = hashlib.sha256(self._maker + content).hexdigest()
            try:
                self._fetched[path] = _check_source(*self._known[key])
            except (KeyError, ValueError, TypeError, AttributeError):
                source = self._fetched[path] = take_apart(content.decode())
                self._known[key] = [source.definitions, source.imports]
                self._changed = True
        return self._fetched[path]

    def write(self) -> None:
        """Write the file if a module was taken apart. Without a folder, or if writing fails, nothing is remembered."""
        if self._changed and self._path is not None:
            newest = dict(list(self._known.items())[-_MAX_KEPT_MODULES:])
            write_whole(self._path, json.dumps(newest).encode())
            self._changed = False


_open_kept = cache(_Kept)


def _check_source(definitions: Any, imports: Any) -> Source:
    """Return a module as it was kept; raise ValueError if the file holds anything else."""
    statements = [each for name, parts in definitions.items() for each in parts]
    if not all(isinstance(digest, str) and _are_texts(reads) for digest, reads in statements):
        raise ValueError(statements)
    if not all(map(_are_texts, imports.values())):
        raise ValueError(imports)
    return Source(definitions, imports)


def _are_texts(values: Any) -> bool:
    return isinstance(values, list) and all(isinstance(value, str) for value in values)
