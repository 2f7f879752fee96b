"""Steps that take the light and the material of a foreign frame, make the frame, and check it as a whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lobewise.guides.lamps import describe_lamps, keep_lamps
from lobewise.interchange.cameras.header import read_sample_count
from lobewise.interchange.checks.lacks import describe_alone, list_lacks
from lobewise.interchange.checks.noise import check_noise
from lobewise.interchange.checks.roughness import check_range, check_roughness, look_up_second, name_assumption
from lobewise.interchange.importing.draft import Draft, Outcome
from lobewise.interchange.lighting import (
    PartOutput,
    lend_albedo,
    make_radiance,
    take_albedos,
    take_known_layers,
    take_layers,
)
from lobewise.interchange.siblings import FIRST_SIBLING_INDEX
from lobewise.interchange.silhouettes import compute_silhouettes, take_silhouettes
from lobewise.interchange.values import convert_plain, undo_mean_roughness
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.images import make_read_only


def take_light(draft: Draft) -> Outcome:
    """Take the layers of light, unless diffuse and specular light are passes themselves."""
    if draft.has("diffuse") and draft.has("specular"):
        return Outcome(draft)
    light, notes = take_layers(draft.images["color"], draft.channels.layers, draft.corrected)
    return Outcome(replace(draft, light=light), notes=notes)


def take_known_light(draft: Draft) -> Outcome:
    """Take the layers of light for which there are outputs already."""
    light = take_known_layers(draft.images["color"], draft.channels.layers, draft.corrected, draft.outputs)
    return Outcome(replace(draft, light=light))


def lend_lone_albedo(draft: Draft) -> Outcome:
    """Give the albedo of all light to the diffuse layers, if no layer has its own."""
    layers = lend_albedo(draft.light.layers, draft.images["albedo"])
    return Outcome(replace(draft, light=replace(draft.light, layers=layers)))


def choose_albedos(draft: Draft) -> Outcome:
    """Choose the diffuse and specular albedo."""
    return Outcome(replace(draft, albedos=take_albedos(draft.images, draft.light.layers)))


def take_roughness(draft: Draft) -> Outcome:
    """Convert the roughness to microfacet alpha."""
    found, roughness, notes = draft.roles["roughness"], draft.images["roughness"], []
    if "cycles_roughness" in found.convert:
        undone = undo_mean_roughness(roughness, *draft.albedos)
        if undone is None:
            note = (
                f"{found.label} is a mean over diffuse and specular lobes, which the albedos of both would undo; "
                "without them it is not used."
            )
            return Outcome(draft, notes=[note])
        roughness, known = undone
        share = 100.0 * float(known.mean())
        notes.append(
            f"{found.label} was a mean over all lobes; that of the specular ones is known at {share:.0f} % of pixels."
        )
    alpha = np.clip(np.nan_to_num(convert_plain(roughness, found.convert), nan=1.0, posinf=1.0), 0.0, 1.0)
    return Outcome(replace(draft, microfacet_alpha=alpha), notes=notes)


def check_roughness_range(draft: Draft) -> Outcome:
    """Check whether the roughness is within [0, 1]."""
    return Outcome(draft, check_range(draft.images["roughness"], draft.roles["roughness"].label))


def check_roughness_meaning(draft: Draft) -> Outcome:
    """Check by a second pass whether the roughness is perceptual, alpha or glossiness."""
    second = look_up_second(draft.channels)
    if second is None or draft.microfacet_alpha is None:
        return Outcome(draft)
    alpha, findings = check_roughness(
        draft.microfacet_alpha,
        draft.images["roughness"],
        draft.roles["roughness"],
        second,
        draft.read,
        draft.albedos,
    )
    return Outcome(replace(draft, microfacet_alpha=alpha), findings)


def estimate_silhouettes(draft: Draft) -> Outcome:
    """Find which surfaces share a pixel. Light that is not told apart is not resolved by silhouettes."""
    if not draft.light.layers and not (draft.has("diffuse") and draft.has("specular")):
        return Outcome(draft)
    silhouettes, notes = take_silhouettes(draft.channels, draft.read, wraps=bool(draft.wraps))
    return Outcome(replace(draft, silhouettes=silhouettes), notes=notes)


def compute_known_silhouettes(draft: Draft) -> Outcome:
    """Compute the silhouettes that are shown by passes that are known already."""
    source = draft.silhouettes.source
    return Outcome(replace(draft, silhouettes=compute_silhouettes(source, draft.read)) if source else draft)


def make_frame(draft: Draft) -> Outcome:
    """Make the frame of everything that is known."""
    images, (diffuse_albedo, specular_albedo) = draft.images, draft.albedos
    motion, coverage = images.get("motion"), draft.silhouettes.coverage
    spp = read_sample_count(draft.container.parts, draft.channels.preset)
    guides = make_read_only(
        depth=draft.distance,
        position=draft.world_position if draft.camera is not None else None,
        normal=draft.world_normal,
        alpha_u=draft.microfacet_alpha,
        diffuse_albedo=diffuse_albedo,
        specular_albedo=specular_albedo,
        motion=None if motion is None else convert_plain(motion, draft.roles["motion"].convert),
        coverage=coverage,
        blur_radius=draft.blur_radius,
        # Other renderers' albedos are means over the pixel's area.
        mean_diffuse_albedo=None if coverage is None else diffuse_albedo,
        mean_specular_albedo=None if coverage is None else specular_albedo,
        # Open Image Denoise gets both as the file has them: at edges their means are shorter, and black is black.
        denoiser_albedo=images.get("albedo"),
        denoiser_normal=images.get("denoiser_normal", draft.mean_normal),
    )
    frame = Frame(
        make_radiance(images["color"], images, draft.light),
        GBuffer(**guides),
        draft.camera,
        variance=_take_variance(draft, spp),
        spp=spp,
        layers=draft.light.layers,
        unscattered=draft.light.unscattered,
        wraps=bool(draft.wraps),
    )
    return Outcome(replace(draft, frame=frame))


def _take_variance(draft: Draft, spp: int | None) -> Radiance | None:
    """Return the variance of the mean; None if only that of one sample is known."""
    if "variance" not in draft.images:
        return None
    variance = draft.images["variance"]
    if "of_samples" in draft.roles["variance"].convert:
        if spp is None:
            return None
        variance = variance / np.float32(spp)
    return Radiance(variance)


def tell_assumed_roughness(draft: Draft) -> Outcome:
    """Tell which meaning of the roughness is assumed where neither the renderer nor the user says it."""
    return Outcome(draft, notes=name_assumption(draft.channels))


def check_image_noise(draft: Draft) -> Outcome:
    """Check whether the image is denoised already, and whether neighbouring pixels share their noise."""
    assert draft.frame is not None
    has_others = any("noisy" in one.path.lower() for one in draft.channels.beside)
    is_shared, findings = check_noise(draft.frame, has_normals=draft.has("normal"), has_others=has_others)
    return Outcome(replace(draft, frame=draft.frame.with_changes(noise_is_shared=is_shared)), findings)


def tell_missing(draft: Draft) -> Outcome:
    """Tell which passes are not used and why, and what the frame lacks of what denoising can use."""
    channels, frame = draft.channels, draft.frame
    assert frame is not None
    lacks = list_lacks(channels, frame, is_light_denoised=draft.is_light_denoised)
    sentences = describe_alone(channels, frame) or [one.told for one in lacks]
    return Outcome(replace(draft, lacks=tuple(lacks)), notes=[*channels.refused.values(), *sentences])


def take_out_lamps(draft: Draft) -> Outcome:
    """Keep filters from changing lamps."""
    assert draft.frame is not None
    frame, count = keep_lamps(draft.frame)
    return Outcome(replace(draft, frame=frame), notes=describe_lamps(count))


def list_outputs(draft: Draft) -> Outcome:
    """List the passes into which results are written."""
    roles = draft.channels.roles
    outputs = {"color": PartOutput(draft.channels.target), **draft.light.outputs}
    outputs |= {name: PartOutput(roles[name]) for name in ("diffuse", "specular") if name in roles}
    inside = {name: one for name, one in outputs.items() if one.target.source.part.index < FIRST_SIBLING_INDEX}
    note = "Passes in files of their own stay as they are there: only the image is written."
    return Outcome(replace(draft, outputs=inside), notes=[note] if len(inside) < len(outputs) else [])
