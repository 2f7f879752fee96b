"""Steps that read the guides of a foreign file and check them as they stand there, before any conversion."""

from __future__ import annotations

from dataclasses import replace

from lobewise.guides import survey
from lobewise.interchange.checks.compression import check_compression
from lobewise.interchange.checks.denoised import check_mark
from lobewise.interchange.checks.flips import check_flips, turn_over
from lobewise.interchange.checks.guides import check_albedos, check_encoding, check_values
from lobewise.interchange.importing.draft import Draft, Outcome
from lobewise.records.frame import FloatArray

GUIDES = ("normal", "position", "depth", "albedo", "diffuse_albedo", "specular_albedo", "roughness")
"""Roles whose images are checked."""
LOBE_ALBEDOS = ("diffuse_albedo", "specular_albedo")


def tell_channels(draft: Draft) -> Outcome:
    """Tell which image is filtered, if the renderer denoised its own."""
    channels = draft.channels
    notes = [*channels.preset.notes]
    if channels.shown is not None:
        notes.append(
            f"{channels.shown.label} was denoised by the renderer: the noisy image, {channels.roles['color'].label}, "
            f"is filtered, and the result goes into {channels.shown.label}."
        )
    return Outcome(draft, notes=notes)


def correct_compressed_light(draft: Draft) -> Outcome:
    """Check what compression with loss did, and set light just below 0 to 0."""
    changed, findings = check_compression(draft.channels, draft.read)
    return Outcome(replace(draft, read=draft.read.with_images(changed)), findings)


def check_own_result(draft: Draft) -> Outcome:
    """Check whether lobewise has denoised the image, or the light that makes it up."""
    return Outcome(draft, check_mark(draft.container, draft.mapped))


def read_images(draft: Draft) -> Outcome:
    """Read the image of every role."""
    roles = draft.channels.roles
    return Outcome(replace(draft, images={role: draft.read(found) for role, found in roles.items()}, roles=dict(roles)))


def list_guides(draft: Draft) -> dict[str, FloatArray]:
    """Return the guides to check. One albedo for all light is used only where no lobe has its own."""
    has_own = any(layer.albedo for layer in draft.channels.layers) or any(map(draft.images.__contains__, LOBE_ALBEDOS))
    used = [role for role in GUIDES if role in draft.images and not (role == "albedo" and has_own)]
    return {role: draft.images[role] for role in used}


def fill_missing_values(draft: Draft) -> Outcome:
    """Fill guides from their neighbours where they are NaN or infinite."""
    changed, findings = check_values(list_guides(draft), draft.labels)
    return Outcome(draft.with_images(changed), findings)


def turn_over_guides(draft: Draft) -> Outcome:
    """Turn over guides that lie upside down or mirrored under the image."""
    images = list_guides(draft)
    flips, findings = check_flips(draft.images["color"], images, draft.labels, draft.flips)
    turned = draft.with_images({role: turn_over(images[role], flip) for role, flip in flips.items()})
    return Outcome(replace(turned, flips=flips), findings)


def decode_normals(draft: Draft) -> Outcome:
    """Decode normals that are stored in [0, 1], whatever the preset says."""
    found = draft.roles["normal"]
    normal, findings = check_encoding(draft.images["normal"], found.label, encoded="encoded" in found.convert)
    if normal is None:
        return Outcome(draft, findings)
    return Outcome(_with_decoded(draft, normal), findings)


def decode_declared_normals(draft: Draft) -> Outcome:
    """Decode normals that the preset says to be stored in [0, 1]."""
    if "encoded" not in draft.roles["normal"].convert:
        return Outcome(draft)
    return Outcome(_with_decoded(draft, survey.decode_normals(draft.images["normal"])))


def _with_decoded(draft: Draft, normal: FloatArray) -> Draft:
    """Return a draft with decoded normals, which need no further decoding."""
    found = draft.roles["normal"]
    decoded = replace(found, convert=tuple(word for word in found.convert if word != "encoded"))
    return replace(draft.with_images({"normal": normal}), roles={**draft.roles, "normal": decoded})


def check_albedo_ranges(draft: Draft) -> Outcome:
    """Check the albedos of roles and layers."""
    labels = draft.labels
    albedos = {labels[role]: image for role, image in list_guides(draft).items() if role.endswith("albedo")}
    layers = [layer.albedo for layer in draft.channels.layers if layer.albedo]
    read = draft.corrected
    albedos |= {albedo.label: read(albedo) for albedo in layers}
    return Outcome(draft, check_albedos(albedos))
