"""Options of the verbs that read files of any renderer, and the reading by them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lobewise.interchange import Imported
    from lobewise.lobe_table import LobeTable

Preset = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.toml",
        help="Whose conventions the file follows: cycles, arnold, vray, renderman, karma, redshift, corona, pbrt, "
        "luxcore, mitsuba, unreal, generic, or a file of them.",
        show_default="what the file tells",
    ),
]
Maps = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="ROLE=CHANNELS",
        help="Which channels are what, such as normal=N.X,N.Y,N.Z or roughness=rough.R:square; again for more.",
        show_default=False,
    ),
]
CameraFile = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="FILE",
        help="The camera, where the file does not tell: JSON, a Mitsuba scene (.xml), or glTF (.gltf, .glb).",
        show_default="what the file tells",
    ),
]
Half = Annotated[
    Path | None,
    typer.Option(
        "--half",
        metavar="FILE",
        help="The same frame rendered with another seed: both are halves of the samples.",
        show_default=False,
    ),
]
Also = Annotated[
    list[str] | None,
    typer.Option(
        "--also",
        metavar="PATTERN",
        help="Further noisy passes, such as 'Combined_*', filtered like what they belong to; again for more.",
        show_default=False,
    ),
]
Suffix = Annotated[
    str,
    typer.Option("--suffix", metavar="TEXT", help="Put results beside the noisy passes, in passes whose names end so."),
]
Only = Annotated[bool, typer.Option("--only", help="Write the results alone, no other channel.")]
Confidence = Annotated[
    bool,
    typer.Option(
        "--confidence", help="Add channels that tell how far to trust the result, and which pixels to render again."
    ),
]


@dataclass
class Reading:
    """How files are read: the options, and what has been said of it already."""

    preset: str | None = None
    maps: list[str] | None = None
    camera: Path | None = None
    half: Path | None = None
    also: list[str] | None = None
    tables: Sequence[LobeTable] | None = None
    _told: set[str] = field(default_factory=set)

    @property
    def option(self) -> str:
        """The first option that was given, empty for none."""
        given = {
            "--preset": self.preset,
            "--map": self.maps,
            "--camera": self.camera,
            "--half": self.half,
            "--also": self.also,
        }
        return next((name for name, value in given.items() if value), "")

    def read(self, path: Path, source: Path, *, light_passes: bool = False) -> Imported:
        """Return the frame of a file, one of the sequence ``source`` perhaps; what was made of it is said once."""
        from lobewise.cli.output import print_note
        from lobewise.interchange import import_file
        from lobewise.interchange.camera_files import read_camera_file

        found = import_file(
            path,
            preset=self.preset,
            mapping=parse_maps(self.maps or []),
            camera=None if self.camera is None else read_camera_file(self.camera),
            half=None if self.half is None else _find_same(self.half, path, source),
            lobe_tables=self.tables,
            also=self.also or (),
            light_passes=light_passes,
        )
        if found.map is not None:
            title = f"Read as {found.map.preset.title}, because {found.map.reason}."
            for note in (title, *found.notes):
                if note not in self._told:
                    print_note(note)
                self._told.add(note)
        return found


def parse_maps(given: list[str]) -> Mapping[str, str]:
    """Return channels by role from words ``role=channels``."""
    found: dict[str, Any] = {}
    for text in given:
        role, equals, channels = text.partition("=")
        if not equals or not channels or role.strip() in found:
            raise InputError(
                "--map",
                expected="ROLE=CHANNELS, each role once",
                got=repr(text),
                action="write, for example, --map normal=N.X,N.Y,N.Z",
            )
        found[role.strip()] = channels.strip()
    return found


def _find_same(half: Path, path: Path, source: Path) -> Path:
    """Return the file of the second render that belongs to one of the first."""
    from lobewise.io.sequence import FramePattern, is_pattern

    if is_pattern(half) != is_pattern(source):
        raise InputError(
            "--half",
            expected="a sequence for a sequence, and a file for a file",
            got=f"{str(half)!r} for {str(source)!r}",
            action="name both alike",
        )
    if not is_pattern(half):
        return half
    number = {found: number for number, found in FramePattern.parse(source).find()}[path]
    return FramePattern.parse(half).name(number)
