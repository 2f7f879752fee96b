"""Options of verbs that read files of any renderer: what a file holds, where the file does not tell."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from lobewise.cli.terminal.help import file_detail, file_option
from lobewise.errors import InputError

if TYPE_CHECKING:
    from lobewise.recipes.files import FileRequest


@dataclass(frozen=True)
class Reading:
    """Options that tell what a file holds where the file does not."""

    preset: Annotated[
        str | None,
        file_option(
            metavar="NAME|FILE.toml",
            help="Conventions of the file: cycles, arnold, vray, renderman, karma, redshift, corona, pbrt, luxcore, "
            "mitsuba, unreal, generic, or a file of them.",
            show_default="what the file tells",
        ),
    ] = None
    maps: Annotated[
        list[str] | None,
        file_option(
            "--map",
            metavar="ROLE=CHANNELS",
            help="Channels of an image, such as normal=N.X,N.Y,N.Z or roughness=rough.R:square; again for more.",
            show_default=False,
        ),
    ] = None
    camera: Annotated[
        Path | None,
        file_option(
            metavar="FILE",
            help="The camera, where the file does not tell: JSON, a Mitsuba scene (.xml), glTF (.gltf, .glb) or USD.",
            show_default=False,
        ),
    ] = None
    half: Annotated[
        Path | None,
        file_option(
            metavar="FILE",
            help="The same frame rendered with another seed: both are halves of the samples.",
            show_default=False,
        ),
    ] = None

    wrap: Annotated[
        bool | None,
        file_detail(
            "--wrap/--no-wrap",
            help="The left and the right border are neighbours: a panorama of 360 degrees.",
            show_default="what the header tells",
        ),
    ] = None

    def list_words(self) -> list[str]:
        """Return the options that the user gave, as words of a command line."""
        options = {"--preset": [self.preset], "--map": self.maps, "--camera": [self.camera], "--half": [self.half]}
        return [*_list_words(options), *({True: ["--wrap"], False: ["--no-wrap"], None: []}[self.wrap])]

    def list_fields(self) -> dict[str, Any]:
        """Return the options as fields of `lobewise.recipes.files.FileRequest`."""
        return {
            "preset": self.preset,
            "mapping": parse_maps(self.maps or []),
            "camera": self.camera,
            "half": self.half,
            "wraps": self.wrap,
        }

    def make_request(self, **more: Any) -> FileRequest:
        """Return the request that these options make, with more fields."""
        from lobewise.recipes.files import FileRequest

        return FileRequest(**self.list_fields(), **more)

    def parse(self) -> dict[str, Any]:
        """Return the conventions, channels, camera and borders, as parameters of `lobewise.read_frame`.

        Raises InputError or FileError if one of them is wrong in every file.
        """
        return self.make_request().make_read_options()


@dataclass(frozen=True)
class PassReading(Reading):
    """Options that tell what a file holds, further noisy passes included."""

    also: Annotated[
        list[str] | None,
        file_option(
            metavar="PATTERN",
            help="Further noisy passes, such as 'Combined_*', AO or '*nm', which are filtered alike; again for more.",
            show_default=False,
        ),
    ] = None

    light_groups: Annotated[
        bool, file_detail("--light-groups/--no-light-groups", help="Denoise the light groups of the file as well.")
    ] = True

    all_layers: Annotated[bool, file_option("--all-layers", help="Denoise every view layer of the file.")] = False

    def list_words(self) -> list[str]:
        """Return the options that the user gave, as words of a command line."""
        own = _list_words({"--also": self.also}) + ([] if self.light_groups else ["--no-light-groups"])
        own += ["--all-layers"] if self.all_layers else []
        return super().list_words() + own

    def list_fields(self) -> dict[str, Any]:
        """Return the options as fields of `lobewise.recipes.files.FileRequest`."""
        own = {"also": tuple(self.also or ()), "light_groups": self.light_groups, "all_layers": self.all_layers}
        return {**super().list_fields(), **own}

    def require_one(self, count: int) -> None:
        """Raise InputError if a second render is named for several inputs."""
        if self.half is not None and count > 1:
            got = f"{count} inputs"
            raise InputError("--half", expected="one input beside it", got=got, action="denoise them one by one")


def _list_words(options: Mapping[str, Iterable[object] | None]) -> list[str]:
    return [word for name, values in options.items() for one in values or [] if one for word in (name, str(one))]


def parse_maps(pairs: list[str]) -> Mapping[str, str]:
    """Return channels by role from words ``role=channels``."""
    mapping: dict[str, Any] = {}
    for text in pairs:
        role, equals, channels = text.partition("=")
        if not equals or not channels or role.strip() in mapping:
            raise InputError(
                "--map",
                expected="ROLE=CHANNELS, each role once",
                got=repr(text),
                action="write, for example, --map normal=N.X,N.Y,N.Z",
            )
        mapping[role.strip()] = channels.strip()
    return mapping
