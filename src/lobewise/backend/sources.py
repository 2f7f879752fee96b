"""What kernels are made from: a digest of the code of modules, which neither comments nor docstrings change.

A module counts with all modules of this package that it imports, and those that these import. The digest is that of its
syntax tree without docstrings, so that an edit of a text compiles nothing anew. Taking a module apart takes some
milliseconds; what came out is kept beside the compiled kernels, by the bytes of the file.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from lobewise.backend.disk import MAX_FILE_BYTES, find_trusted_folder, write_whole
from lobewise.backend.trust import read_trusted

PACKAGE = "lobewise"
_ROOT = Path(__file__).parents[1]
_KEPT = "sources.json"
_MOST_KEPT = 2000
"""Files of which it is remembered what they hold; more are old ones."""


@dataclass(frozen=True)
class Source:
    """What a file holds."""

    digest: str
    imports: tuple[str, ...]
    """Names of modules of this package, or of something in one."""


def describe_modules(names: Iterable[str]) -> str:
    """Return what tells the code of some modules of this package, and of all that they import."""
    found: dict[str, Source] = {}
    waiting = list(names)
    kept = _Kept()
    while waiting:
        name = waiting.pop()
        path = _find_file(name)
        if path is None:
            # What is imported may be a name in a module.
            name, _, _ = name.rpartition(".")
            path = _find_file(name)
        if path is None or name in found:
            continue
        found[name] = kept.fetch(path)
        waiting += found[name].imports
    kept.write()
    told = "\n".join(f"{name} {source.digest}" for name, source in sorted(found.items()))
    return hashlib.sha256(told.encode()).hexdigest()


def take_apart(text: str) -> Source:
    """Return the digest of a module's syntax tree without docstrings, and what it imports of this package."""
    tree = ast.parse(text)
    imports: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            imports += [f"{node.module}.{alias.name}" for alias in node.names]
        body = getattr(node, "body", None)
        if isinstance(body, list):
            # Docstrings, and texts below a constant that say what it is.
            node.body = [each for each in body if not _is_text(each)]  # type: ignore[attr-defined]
    digest = hashlib.sha256(ast.dump(tree).encode()).hexdigest()
    return Source(digest, tuple(sorted({name for name in imports if name.startswith(f"{PACKAGE}.")})))


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _check(digest: Any, imports: Any) -> Source:
    """Return what was remembered of a file; raise ValueError if it is something else."""
    if not isinstance(digest, str) or not all(isinstance(name, str) for name in imports):
        raise ValueError(digest)
    return Source(digest, tuple(imports))


@cache
def _find_file(name: str) -> Path | None:
    first, *rest = name.split(".")
    if first != PACKAGE or not rest:
        return None
    path = _ROOT.joinpath(*rest)
    return next((each for each in (path.with_suffix(".py"), path / "__init__.py") if each.is_file()), None)


class _Kept:
    """What files hold, by the digest of their bytes, remembered on disk."""

    def __init__(self) -> None:
        folder = find_trusted_folder()
        self._path = None if folder is None else folder / _KEPT
        self._known: dict[str, Source] = {}
        self._changed = False
        if self._path is not None:
            # A file that cannot be trusted or read is written anew.
            with suppress(OSError, ValueError, TypeError, AttributeError, RecursionError):
                text, _ = read_trusted(self._path, MAX_FILE_BYTES)
                self._known = {key: _check(*told) for key, told in json.loads(text).items()}

    def fetch(self, path: Path) -> Source:
        """Return what a file holds."""
        content = path.read_bytes()
        key = hashlib.sha256(content).hexdigest()
        if key not in self._known:
            self._known[key] = take_apart(content.decode())
            self._changed = True
        return self._known[key]

    def write(self) -> None:
        """Remember it; where nothing can be written it is done without."""
        if self._changed and self._path is not None:
            newest = dict(list(self._known.items())[-_MOST_KEPT:])
            told = {key: [source.digest, source.imports] for key, source in newest.items()}
            write_whole(self._path, json.dumps(told).encode())
