"""What a file holds and what denoising makes of it, whoever wrote it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from lobewise.camera import Camera
from lobewise.errors import InputError
from lobewise.frame import Frame
from lobewise.interchange.checks import MARKED, Finding, check_own_mark, describe_alone, list_uses
from lobewise.interchange.imported import Imported
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.interchange.preset import CONVERSIONS, ROLES, Preset
from lobewise.interchange.reading import import_file, is_own
from lobewise.interchange.replacing import require_target
from lobewise.interchange.siblings import FIRST_INDEX
from lobewise.io.exr.container import Container, show_name
from lobewise.io.exr.describe import (
    FileDescription,
    ImageDescription,
    RoleDescription,
    describe_part,
    list_similarities,
)
from lobewise.io.exr.describe import describe_file as describe_own
from lobewise.io.exr.layout import find_beauty
from lobewise.io.exr.parsing import read_container
from lobewise.io.files import PathLike
from lobewise.peers import name_oidn_guides


def describe_file(
    path: PathLike,
    *,
    preset: PathLike | None = None,
    mapping: Mapping[str, str] | None = None,
    camera: Camera | None = None,
    half: PathLike | None = None,
    also: Sequence[str] = (),
) -> FileDescription:
    """Return what an EXR file holds, by whose conventions it is read and why, and what becomes of it.

    Of files in lobewise's own names no pixel is read; others are read as `import_file` reads them, whose parameters
    these are.

    Raises
    ------
    FileError, MissingChannelError, InputError
        As `import_file`, for a file of another renderer; of one's own what is wrong is among the notes.
    """
    container = read_container(path)
    asked = preset is not None or mapping or camera is not None or half is not None or also
    if not container.parts or (not asked and is_own(container)):
        own = describe_own(path)
        marks = _list_refusals(check_own_mark(container)) if find_beauty(container.parts) else ()
        return replace(own, notes=(*own.notes, *marks), refusals=(*own.refusals, *marks))
    found = import_file(path, preset=preset, mapping=mapping, camera=camera, half=half, also=also, light_passes=True)
    # Whoever says which image is noisy is believed.
    marks = () if "color" in (mapping or {}) else _list_refusals(found.findings)
    described = describe_import(found)
    try:
        require_target(found)
    except InputError as problem:
        told = f"Denoising will refuse this: {problem}"
        return replace(described, notes=(*described.notes, told), refusals=(*marks, told))
    return replace(described, refusals=marks)


def _list_refusals(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Return the sentences of marks for which ``lobewise denoise`` refuses a file."""
    return tuple(one.told for one in findings if one.what == MARKED and not one.mended)


def describe_import(found: Imported) -> FileDescription:
    """Return the description of a file that was read."""
    container, frame, channels = found.container, found.frame, found.map
    if channels is None:
        return describe_own(container.path)
    image_part = channels.roles["color"].source.part.index
    used = {(one.source.part.index, name): what for what, one in _list_found(channels, found) for name in one.channels}
    guides = set(frame.gbuffer.names)
    return FileDescription(
        path=str(container.path),
        bytes=container.path.stat().st_size,
        parts=tuple(describe_part(part, used) for part in container.parts),
        image_part=image_part if image_part < FIRST_INDEX else None,
        images=list_roles(channels, frame),
        camera=frame.camera,
        spp=frame.spp,
        materials=(),
        similarities=list_similarities(guides, frame.camera if frame.gbuffer.is_placed else None),
        notes=found.notes,
        preset=channels.preset.title,
        reason=channels.reason,
        roles=tuple(
            RoleDescription(what, one.label, "; ".join(CONVERSIONS[word] for word in one.convert))
            for what, one in _list_found(channels, found)
        ),
        version=_find_version(channels.preset, container),
        uses=list_uses(channels, frame),
        layers=tuple(layer.name for layer in frame.layers) or (("diffuse", "specular") if frame.radiance.parts else ()),
        exact=tuple(dict.fromkeys(name.partition("/")[0] for name in frame.unscattered)),
        lacks=found.lacks,
        outputs=tuple(
            dict.fromkeys(one.found.label for name, one in found.outputs.items() if name not in frame.unscattered)
        ),
        unusable=tuple(channels.refused.values()),
        alone=" ".join(describe_alone(channels, frame)),
        oidn_guides=name_oidn_guides(frame),
    )


def _find_version(preset: Preset, container: Container) -> str:
    """Return what the header tells of the renderer's version, without what stands in brackets; empty for nothing."""
    values = {item.name: item.value for part in container.parts for item in part.attributes if item.type == "string"}
    for name in preset.versions:
        if name in values:
            return show_name(values[name].decode("utf-8", "replace").partition("[")[0].strip())
    return ""


def list_roles(channels: ChannelMap, frame: Frame) -> tuple[ImageDescription, ...]:
    """Return every image that a file has, and those that it could have but a normal that one renderer alone makes."""
    roles = [role for role in ROLES if role != "denoiser_normal" or role in channels.roles]
    return tuple(_describe_role(channels, frame, role) for role in roles)


def _describe_role(channels: ChannelMap, frame: Frame, role: str) -> ImageDescription:
    """Return whether a file has a role, what it means, and where it is missing how to have it."""
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
    """Return whether a layer of light has an albedo of its own: one for all light serves only where none has."""
    names = {layer.name for layer in frame.layers}
    return any(layer.albedo for layer in channels.layers if layer.rule.name in names)


def _list_found(channels: ChannelMap, imported: Imported) -> list[tuple[str, Found]]:
    """Return what is taken from a file: roles, passes of the layers that the frame has, Cryptomatte."""
    names = {layer.name for layer in imported.frame.layers}
    found = list(channels.roles.items())
    for layer in channels.layers:
        if layer.rule.name in names or layer.rule.lobe == "exact":
            found += [(f"light: {layer.rule.name}", one) for one in layer.light]
            found += [(f"albedo: {layer.rule.name}", layer.albedo)] if layer.albedo else []
    if imported.frame.gbuffer.coverage is not None and channels.cryptomatte:
        found += [("silhouettes", one) for one in channels.cryptomatte[0]]
    return found + [(f"also: {name}", imported.outputs[name].found) for name in imported.frame.also]
