"""Bring public interiors onto this machine and make them scenes that `lobewise render` takes.

    python -m benchmarks.interiors.fetch --cache FOLDER

Clones two public repositories at a pinned commit (about 300 MB), takes the scenes' folders out of them and writes
``mended.xml`` beside each scene: see `benchmarks/interiors/mending.py` for what is changed. Nothing of it belongs to
this project or may be committed to it; the frames are for judging alone, and no filter is tuned or trained on them.

`benchmarks/interiors/scenes.py` tells each scene's title, author and licence as its repository states them. Two have
no licence there; all were published by Benedikt Bitterli, https://benedikt-bitterli.me/resources, or are Eric Veach's.

``--clone NAME=FOLDER`` takes a clone that is there already, with or without a work tree. Files that it lacks are named
and make the scene fail, unless the scene's entry leaves them out.
"""

import argparse
import subprocess
from collections.abc import Mapping
from pathlib import Path

from benchmarks.interiors.mending import mend_scene
from benchmarks.interiors.scenes import INTERIORS, Interior, Source

CACHE = Path("~/.cache/lobewise/interiors")
SCENE = "mended.xml"


def clone(source: Source, folder: Path) -> Path:
    """Return a repository that has the commit and nothing else, fetched on first use."""
    if not (folder / "HEAD").exists():
        folder.mkdir(parents=True, exist_ok=True)
        run_git(folder, "init", "--bare", "--quiet")
    if subprocess.run(["git", "-C", folder, "cat-file", "-e", source.commit], capture_output=True).returncode:
        run_git(folder, "fetch", "--depth", "1", source.url, source.commit)
    return folder


def run_git(folder: Path, *arguments: str) -> bytes:
    """Return what git says in a repository."""
    return subprocess.run(["git", "-C", folder, *arguments], check=True, stdout=subprocess.PIPE).stdout


def take_out(repository: Path, interior: Interior, target: Path) -> list[str]:
    """Write the files of a scene, but for its variations, and return the names of those that the clone lacks."""
    lacking = []
    listed = run_git(repository, "ls-tree", "-r", "-z", "--full-tree", interior.source.commit, f"{interior.folder}/")
    for entry in listed.decode().split("\0")[:-1]:
        about, _, path = entry.partition("\t")
        name = path.removeprefix(f"{interior.folder}/")
        if (name.endswith(".xml") and name != interior.file) or name in interior.without:
            continue
        found = subprocess.run(["git", "-C", repository, "cat-file", "blob", about.split()[2]], capture_output=True)
        if found.returncode:
            lacking.append(name)
            continue
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(found.stdout)
    return lacking


def prepare(interior: Interior, cache: Path, clones: Mapping[str, Path]) -> Path:
    """Return the scene file of an interior, made on first use."""
    target = cache / interior.name
    scene = target / SCENE
    if not scene.exists():
        source = interior.source
        repository = clones.get(source.name) or clone(source, cache / "clones" / source.name)
        lacking = take_out(repository, interior, target)
        used = (target / interior.file).read_text("utf-8")
        lacking = [name for name in lacking if name in used]
        if lacking:
            raise SystemExit(f"{interior.name}: the clone in {repository} lacks {', '.join(lacking)}: fetch it again")
        mend_scene(target / interior.file, scene, interior.size, interior.without)
    return scene


def parse_clones(texts: list[str]) -> dict[str, Path]:
    """Return the folders of clones by the name of their repository."""
    pairs = (text.partition("=") for text in texts)
    return {name: Path(folder).expanduser() for name, _, folder in pairs}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what says where the scenes are, and which."""
    parser.add_argument("--cache", type=Path, default=CACHE, help=f"folder outside the repository ({CACHE})")
    parser.add_argument("--clone", action="append", default=[], metavar="NAME=FOLDER", help="a clone that is there")
    parser.add_argument("--scene", choices=tuple(INTERIORS), action="append", help="only this (may be repeated)")


def main() -> None:
    """Prepare all scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    asked = parser.parse_args()
    for name in asked.scene or INTERIORS:
        print(prepare(INTERIORS[name], asked.cache.expanduser(), parse_clones(asked.clone)), INTERIORS[name].origin)


if __name__ == "__main__":
    main()
