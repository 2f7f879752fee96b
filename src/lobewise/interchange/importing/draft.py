"""The frame of a file while it is imported, the steps that complete it, and the loop that runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum

from lobewise.interchange.cameras.fitting import CameraFit
from lobewise.interchange.cameras.header import Located
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.imported import ImageReader
from lobewise.interchange.lighting import Light, PartOutput
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.interchange.preset import ROLES
from lobewise.interchange.silhouettes import Silhouettes
from lobewise.io.exr.container import Container, Part
from lobewise.io.exr.describe import Lack
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.lobe_table import LobeTable


class Section(IntEnum):
    """Sections of the notes, in the order in which a user reads them."""

    CHANNELS = 0
    SURFACES = 1
    FINDINGS = 2
    LIGHT = 3
    MISSING = 4


@dataclass(frozen=True, kw_only=True)
class Draft:
    """What is known of a frame so far. A draft never changes: each step returns a changed copy.

    Parameters
    ----------
    container : Container
        The file.
    mapped : ChannelMap
        Which channels of the file are which image.
    channels : ChannelMap
        ``mapped`` without the passes of light that lobewise has denoised already.
    read : ImageReader
        Reads an image of the file; light that compression left just below 0 is corrected.
    given_camera : Camera or None
        The user's camera.
    wraps : bool or None
        As of `lobewise.Frame`; None before positions tell.
    lobe_tables : sequence of LobeTable, or None
        The user's lobe tables, for a file in lobewise's own names.
    images : mapping of str to array
        Images by role, as in the file; the checks replace those that they correct.
    flips : mapping of str to str, or None
        The orientations of the guides that lie upside down or mirrored, by role; None before they are measured.
    roles : mapping of str to Found
        The channels of each role, with the conversions that its image still needs.
    light : Light
        The layers, and where each result is written.
    pinhole : CameraFit or None
        The pinhole camera that `fit_camera` finds without blur; None before it is fitted.
    header_camera : Located or None
        The camera of the header.
    camera : Camera or None
        The camera that is used.
    is_mirrored, is_orthographic : bool
        Whether the world was mirrored for the camera (x negated), and whether the camera is a far pinhole that stands
        for an orthographic one.
    world_position : array, shape (height, width, 3), or None
        World positions, 0 where there is no surface.
    blur_radius : array, shape (height, width), or None
        As `lobewise.GBuffer.blur_radius`; None where the lens blurs nothing.
    distance : array, shape (height, width), or None
        Distances along the rays, 0 where there is no surface.
    is_depth_replaced : bool
        Whether ``distance`` was computed from the positions because the file's depth contradicts them.
    world_normal : array, shape (height, width, 3), or None
        Unit normals in world space, 0 where there is no surface.
    mean_normal : array, shape (height, width, 3), or None
        The same normals with the lengths that they have in the file.
    albedos : pair of arrays, shape (height, width, 3), or None
        Diffuse and specular albedo, in [0, 1].
    microfacet_alpha : array, shape (height, width), or None
        Roughness alpha of the specular lobe, in [0, 1].
    silhouettes : Silhouettes
        Coverage and object share.
    frame : Frame or None
        The frame, once everything for it is known.
    outputs : mapping of str to PartOutput
        Where results are written.
    lacks : tuple of Lack
        What the frame lacks of what denoising can use.
    findings : tuple of Finding
        What the checks found, in their order.
    notes : tuple of (Section, str)
        Sentences for the user.
    """

    container: Container
    mapped: ChannelMap
    channels: ChannelMap
    read: ImageReader
    given_camera: Camera | None = None
    wraps: bool | None = None
    lobe_tables: Sequence[LobeTable] | None = None
    images: Mapping[str, FloatArray] = field(default_factory=dict)
    flips: Mapping[str, str] | None = None
    roles: Mapping[str, Found] = field(default_factory=dict)
    light: Light = field(default_factory=Light)
    pinhole: CameraFit | None = None
    header_camera: Located | None = None
    camera: Camera | None = None
    is_mirrored: bool = False
    is_orthographic: bool = False
    world_position: FloatArray | None = None
    blur_radius: FloatArray | None = None
    distance: FloatArray | None = None
    is_depth_replaced: bool = False
    world_normal: FloatArray | None = None
    mean_normal: FloatArray | None = None
    albedos: tuple[FloatArray | None, FloatArray | None] = (None, None)
    microfacet_alpha: FloatArray | None = None
    silhouettes: Silhouettes = field(default_factory=Silhouettes)
    frame: Frame | None = None
    outputs: Mapping[str, PartOutput] = field(default_factory=dict)
    lacks: tuple[Lack, ...] = ()
    findings: tuple[Finding, ...] = ()
    notes: tuple[tuple[Section, str], ...] = ()

    @property
    def image_part(self) -> Part:
        """The part of the file that holds the image."""
        return self.channels.roles["color"].source.part

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        height, width = self.images["color"].shape[:2]
        return height, width

    @property
    def is_light_denoised(self) -> bool:
        """Whether lobewise has denoised the passes of light already, so that they are left out."""
        return self.channels is not self.mapped

    @property
    def labels(self) -> dict[str, str]:
        """The channels of each role, as a user reads them."""
        return {role: found.label for role, found in self.roles.items()}

    def has(self, name: str) -> bool:
        """Return whether the file has an image of a role, or a field of the draft is known."""
        return name in self.images or getattr(self, name, None) is not None

    def with_images(self, changed: Mapping[str, FloatArray]) -> Draft:
        """Return a draft in which some images are replaced."""
        return replace(self, images={**self.images, **changed})

    @property
    def corrected(self) -> ImageReader:
        """A reader of the file that returns guides as they were corrected; normals as the file has them."""
        roles = [role for role in self.roles if role != "normal"]
        return self.read.with_images({self.roles[role].key: self.images[role] for role in roles})


@dataclass(frozen=True)
class Outcome:
    """What a step returns: the draft it leaves, what it found, and sentences for the user."""

    draft: Draft
    findings: Sequence[Finding] = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Step:
    """One step of an import.

    Parameters
    ----------
    run : callable
        The step; its name says what it does.
    needs : tuple of str
        Roles or fields of the draft without which the step is skipped.
    section : Section
        Where its notes stand; sentences of findings always stand under ``Section.FINDINGS``.
    """

    run: Callable[[Draft], Outcome]
    needs: tuple[str, ...] = ()
    section: Section = Section.FINDINGS

    def __post_init__(self) -> None:
        """Raise ValueError for a need that no draft can meet: the step would always be skipped."""
        unknown = set(self.needs) - {*ROLES, *(each.name for each in fields(Draft))}
        if unknown:
            raise ValueError(f"step {self.run.__name__}: no role or field of a draft is named {sorted(unknown)}")


def run_steps(draft: Draft, steps: Sequence[Step]) -> Draft:
    """Run the steps whose needs are met, in their order; return the last draft with all findings and notes."""
    for step in steps:
        if not all(map(draft.has, step.needs)):
            continue
        outcome = step.run(draft)
        notes = [(step.section, note) for note in outcome.notes]
        notes += [(Section.FINDINGS, finding.sentence) for finding in outcome.findings]
        draft = replace(outcome.draft, findings=(*draft.findings, *outcome.findings), notes=(*draft.notes, *notes))
    return draft


def list_notes(draft: Draft) -> tuple[str, ...]:
    """Return the notes section by section, those of one section in the order of the steps."""
    return tuple(note for _, note in sorted(draft.notes, key=lambda noted: noted[0]))
