"""Describe an EXR file of any renderer: its contents, and how denoising uses them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from lobewise.errors import InputError, LobewiseError
from lobewise.interchange.checks import MARKED, Finding, describe_alone, list_uses
from lobewise.interchange.imported import Imported
from lobewise.interchange.mapping import ChannelMap, Found, is_own
from lobewise.interchange.preset import CONVERSIONS, ROLES, Preset
from lobewise.interchange.reading import import_file, list_selections
from lobewise.interchange.replacing import require_target
from lobewise.interchange.siblings import FIRST_SIBLING_INDEX
from lobewise.io.exr.container import Container, show_name
from lobewise.io.exr.describe import (
    FileDescription,
    ImageDescription,
    RoleDescription,
    describe_part,
)
from lobewise.io.exr.layout import look_up_beauty
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import SLOTS
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import SIMILARITY_NAMES


def describe_file(
    path: PathLike,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
    half: PathLike | None = None,
    also: Sequence[str] = (),
    all_layers: bool = False,
    wraps: bool | None = None,
) -> FileDescription:
    """Return a description of an EXR file: its contents, its preset and the reason for it, and the use of each pass.

    The parameters are those of `import_file`; ``all_layers`` describes all view layers. Pixels are read only if the
    file does not use lobewise's channel names.

    Raises
    ------
    FileError, MissingChannelError, InputError
        As `import_file`, for a file of another renderer. Errors in a lobewise file become notes instead.
    """
    return inspect_file(
        path,
        preset=preset,
        mapping=mapping,
        camera=camera,
        half=half,
        also=also,
        all_layers=all_layers,
        wraps=wraps,
    )[0]


def inspect_file(
    path: PathLike,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
    half: PathLike | None = None,
    also: Sequence[str] = (),
    all_layers: bool = False,
    wraps: bool | None = None,
) -> tuple[FileDescription, Imported | None]:
    """Return the description of a file as `describe_file`, and the file itself if its pixels were read."""
    container = read_container(path)
    is_plain = preset is None and not mapping and camera is None and half is None and not also
    options = {"preset": preset, "mapping": mapping, "camera": camera, "half": half, "also": also, "light_passes": True}
    options |= {"wraps": wraps, "header_only": is_plain}
    try:
        selections = list_selections(path, preset=preset, mapping=mapping, all_layers=all_layers)
        first, *others = (
            import_file(path, view=selected.view or None, layer=selected.layer or None, denoised=selections, **options)  # type: ignore[arg-type]
            for selected in selections
        )
    except LobewiseError as problem:
        if is_plain and is_own(container):
            return _describe_refused(container, problem), None
        raise
    # A user who maps the color says that this image is noisy, so the checks must not refuse it.
    marks = (
        ()
        if "color" in (mapping or {})
        else _list_refusals(one for selected in (first, *others) for one in selected.findings)
    )
    described = describe_import(first, others)
    try:
        for selected in (first, *others):
            require_target(selected)
    except InputError as problem:
        refusal = f"Denoising will refuse this: {problem}"
        return replace(described, notes=(*described.notes, refusal), refusals=(*marks, refusal)), first
    return replace(described, refusals=marks), None if is_plain and first.map.is_own else first


def _describe_refused(container: Container, problem: LobewiseError) -> FileDescription:
    """Return the description of a file in lobewise's own names that cannot be read."""
    refusal, beauty = f"Denoising will refuse this file: {problem}", look_up_beauty(container.parts)
    return FileDescription(
        path=str(container.path),
        bytes=container.path.stat().st_size,
        parts=tuple(describe_part(part, {}) for part in container.parts),
        image_part=None if beauty is None else beauty.index,
        notes=(refusal,),
        refusals=(refusal,),
    )


def _list_refusals(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the messages of the findings because of which ``lobewise denoise`` refuses a file."""
    return tuple(one.sentence for one in findings if one.what == MARKED and not one.mended)


def describe_import(imported: Imported, others: Sequence[Imported] = ()) -> FileDescription:
    """Return the description of an imported file; ``others`` are further views of it that are denoised."""
    container, frame, channels = imported.container, imported.frame, imported.map
    image_part = channels.roles["color"].source.part.index
    used = {
        (one.source.part.index, name): what
        for each in (*others, imported)
        for what, one in _list_found(each.map, each)
        for name in one.channels
    }
    has_lobes = frame.is_placed and frame.gbuffer.alpha_u is not None
    return FileDescription(
        path=str(container.path),
        bytes=container.path.stat().st_size,
        parts=tuple(describe_part(part, used) for part in container.parts),
        image_part=image_part if image_part < FIRST_SIBLING_INDEX else None,
        images=list_roles(channels, frame),
        camera=frame.camera,
        spp=frame.spp,
        materials=tuple(map(_describe_table, frame.lobe_tables)),
        similarities=SIMILARITY_NAMES if has_lobes else ("normal",),
        notes=(
            *_tell_selections(imported, others),
            *frame.notes,
            *imported.notes,
            *_list_further_notes(imported, others),
        ),
        preset=channels.preset.title,
        reason=channels.reason,
        roles=tuple(
            RoleDescription(what, one.label, "; ".join(CONVERSIONS[word] for word in one.convert))
            for what, one in (() if channels.is_own else _list_found(channels, imported))
        ),
        version=_read_version(channels.preset, container),
        uses=list_uses(channels, frame),
        layers=tuple(layer.name for layer in frame.layers) or (("diffuse", "specular") if frame.radiance.parts else ()),
        exact=tuple(dict.fromkeys(name.partition("/")[0] for name in frame.unscattered)),
        lacks=imported.lacks,
        outputs=tuple(
            dict.fromkeys(
                one.target.label
                for each in (imported, *others)
                for name, one in each.outputs.items()
                if name not in each.frame.unscattered
            )
        ),
        unusable=tuple(channels.refused.values()),
        alone="" if channels.is_own else " ".join(describe_alone(channels, frame)),
    )


def _tell_selections(imported: Imported, others: Sequence[Imported]) -> list[str]:
    """Return sentences that name the views and the view layers of a file that has several, and say what is denoised."""
    denoised = [each.map.selection for each in (imported, *others)]
    notes = []
    for what, name in (("view", "views"), ("layer", "view layers")):
        all_names = list(dict.fromkeys(getattr(each, what) for each in imported.map.selections))
        is_whole = set(all_names) <= {getattr(each, what) for each in denoised}
        ending = "each is denoised with its own guides" if is_whole else "--all-layers denoises all"
        if len(all_names) > 1 and (is_whole or what == "layer"):
            names = ", ".join(repr(show_name(each)) for each in all_names)
            notes.append(f"This file has {len(all_names)} {name}: {names}; {ending}.")
    return notes


def _list_further_notes(imported: Imported, others: Sequence[Imported]) -> list[str]:
    """Return the notes on further views of a kind that the first does not have, each with the name of its view."""
    first = imported.map.selection
    known = {first.name_kind(note) for note in (*imported.frame.notes, *imported.notes)}
    notes: list[str] = []
    for other in others:
        own = other.map.selection
        new = [note for note in (*other.frame.notes, *other.notes) if own.name_kind(note) not in known]
        notes += [own.begin_note(note, first) for note in new]
    return notes


def _read_version(preset: Preset, container: Container) -> str:
    """Return the renderer's version from the header, cut off before any bracket; empty if the header has none."""
    values = {item.name: item.value for part in container.parts for item in part.attributes if item.type == "string"}
    for name in preset.versions:
        if name in values:
            return show_name(values[name].decode("utf-8", "replace").partition("[")[0].strip())
    return ""


def _describe_table(table: LobeTable) -> str:
    kind = f"{table.lobe_count} {table.kind} lobe{'s' if table.lobe_count > 1 else ''}"
    where = f"{table.cosine.size} views" + ("" if table.is_isotropic else f" at {table.azimuth.size} azimuths")
    return f"{show_name(table.name)!r}: {kind} for each of {where}"


def list_roles(channels: ChannelMap, frame: Frame) -> tuple[ImageDescription, ...]:
    """Return all roles, present or missing; "denoiser_normal" only if present, because one renderer alone writes it."""
    if channels.is_own:
        return tuple(
            ImageDescription(slot.label, slot.role in channels.roles, slot.meaning, slot.missing) for slot in SLOTS
        )
    roles = [role for role in ROLES if role != "denoiser_normal" or role in channels.roles]
    return tuple(_describe_role(channels, frame, role) for role in roles)


def _describe_role(channels: ChannelMap, frame: Frame, role: str) -> ImageDescription:
    """Return whether the file has a role, the meaning of the role, and advice how to get a missing one."""
    found, layers = channels.roles.get(role), "of the layers" if frame.layers else "of albedo"
    advice = channels.preset.advice.get("layers" if role in ("diffuse", "specular") else role, "not needed to denoise")
    missing = advice.removeprefix("none; ")
    if found is not None:
        spare = role == "albedo" and _has_own_albedo(channels, frame)
        meaning = f"{ROLES[role]}; for Open Image Denoise, as layers have their own" if spare else ROLES[role]
        return ImageDescription(found.label, True, meaning, missing)
    derived = frame.radiance if role in ("diffuse", "specular") else frame.gbuffer if "albedo" in role else None
    if getattr(derived, role, None) is not None:
        return ImageDescription(f"{role} ({layers})", True, ROLES[role], missing)
    return ImageDescription(role, False, ROLES[role], missing)


def _has_own_albedo(channels: ChannelMap, frame: Frame) -> bool:
    """Return whether any layer has its own albedo. The albedo of all light is used only if no layer has one."""
    names = {layer.name for layer in frame.layers}
    return any(layer.albedo for layer in channels.layers if layer.rule.name in names)


def _list_found(channels: ChannelMap, imported: Imported) -> list[tuple[str, Found]]:
    """Return the images that are used, each with its purpose: roles, passes of the frame's layers, Cryptomatte."""
    if channels.is_own:
        return [
            (f"{slot.owner}.{slot.field}", channels.roles[slot.role]) for slot in SLOTS if slot.role in channels.roles
        ]
    names = {layer.name for layer in imported.frame.layers}
    found = list(channels.roles.items())
    for layer in channels.layers:
        if layer.rule.name in names or layer.rule.lobe == "exact":
            found += [(f"light: {layer.rule.name}", one) for one in layer.light]
            found += [(f"albedo: {layer.rule.name}", layer.albedo)] if layer.albedo else []
    if imported.frame.gbuffer.coverage is not None and channels.cryptomatte:
        found += [("silhouettes", one) for one in channels.cryptomatte[0]]
    return found + [(f"also: {name}", imported.outputs[name].target) for name in imported.frame.also]
