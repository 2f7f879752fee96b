"""Inputs of denoising that a foreign frame has or lacks, the cost of each, and the renderer's switch for it."""

from __future__ import annotations

from lobewise.interchange.mapping import ChannelMap
from lobewise.io.exr.describe import COSTS, USES, Lack
from lobewise.peers import explain_no_oidn, has_oidn
from lobewise.records.frame import Frame

ADVISED_ROLES = ("normal", "position", "layers", "albedo", "roughness")
"""Roles whose passes the advice names, the most useful one first."""


def list_uses(channels: ChannelMap, frame: Frame) -> tuple[str, ...]:
    """Return the entries of `lobewise.io.exr.describe.USES` that a frame has."""
    guides = frame.gbuffer
    # Without a camera no lobe is compared. The network of "high" reads the roughness, too.
    takes_roughness = frame.is_placed or channels.is_own or not has_oidn()
    there = {
        "normal": "normal" in channels.roles,
        "roughness": guides.alpha_u is not None and takes_roughness,
        "camera": frame.is_placed,
        "layers": frame.radiance.parts is not None,
        "albedo": guides.diffuse_albedo is not None or guides.specular_albedo is not None,
        "silhouettes": guides.coverage is not None and frame.radiance.parts is not None,
        "halves": frame.half_a is not None,
    }
    return tuple(use for use in USES if there[use])


def list_lacks(channels: ChannelMap, frame: Frame, *, is_light_denoised: bool) -> list[Lack]:
    """Return the inputs that a frame lacks, each with a sentence. An image alone has one sentence for all of them."""
    advice, lacks, is_alone = channels.preset.advice, [], bool(describe_alone(channels, frame))
    for role in [role for role in COSTS if role not in list_uses(channels, frame)]:
        # A camera alone places no surface. Positions do, and a camera can be fitted to them.
        advised = "position" if role == "camera" and not frame.gbuffer.is_placed and "position" in advice else role
        sentence = advice.get(advised) or advice.get({"albedo": "diffuse_albedo"}.get(role, ""), "")
        if role in channels.roles:
            sentence = f"none; {channels.roles[role].label} is there, but no layer of light takes it"
        if role == "roughness" and frame.gbuffer.alpha_u is not None:
            sentence = "none; it is there, but without a camera no lobe is compared"
        if role == "layers" and is_light_denoised:
            sentence = "none; the passes of light are denoised by lobewise already"
        if role == "camera" and frame.camera is None and "position" in channels.roles:
            sentence = "none; no camera fits the positions"
        is_refused = bool(channels.refused.keys() & {role, advised})
        if is_refused:
            # The pass is switched on: why it is not used is told by itself.
            sentence = "none; it is there, but cannot be used"
        remedy, reason = ("", sentence.removeprefix("none; ")) if sentence.startswith("none") else (sentence, "")
        # For an unknown renderer there is no menu to name.
        lead = "give" if channels.preset.name == "generic" else f"{channels.preset.title} gives it by:"
        end = f"; {lead} {remedy}" if remedy else f" ({reason})" if reason and not is_refused else ""
        name = "positions" if role == "camera" and frame.camera is not None else role
        kind = f"{name} that can be used" if is_refused else name
        sentence = "" if is_alone else f"No {kind}: {COSTS[role]}{end}."
        lacks.append(Lack(role, COSTS[role], remedy, reason, sentence))
    return lacks


def describe_alone(channels: ChannelMap, frame: Frame) -> list[str]:
    """Return one sentence in place of a list of what is missing, if a frame has nothing but its color image.

    The sentence gives the error over that of Open Image Denoise without guides, measured at 16 samples per pixel: 4,
    9, 16 and 4 on scenes of Blender, 6 and 4 on scenes of LuxCore. On two scenes of Mitsuba the ratio is 0.4: its
    pixel filter spreads each sample over several pixels, and Open Image Denoise leaves such noise.
    """
    guides, preset = frame.gbuffer, channels.preset
    known = (guides.position, guides.depth, guides.diffuse_albedo, guides.specular_albedo, guides.alpha_u)
    if "normal" in channels.roles or frame.radiance.parts is not None or any(image is not None for image in known):
        return []
    # Passes that are there are switched on already: only their pixels are others than those of the image.
    there = [role for role in ADVISED_ROLES if role in channels.refused]
    texts = [preset.advice.get(role, "none") for role in ADVISED_ROLES if role not in there]
    advice = [text for text in dict.fromkeys(texts) if not text.startswith("none")]
    lead = "render with" if preset.name == "generic" else f"switch on in {preset.title}:"
    if there:
        lead = f"give {' and '.join(there)} the channels and the pixels of the image, and {lead}"
    peer = "which is used unless --offline or a quality is given" if has_oidn() else f"but {explain_no_oidn()}"
    # Mitsuba's pixel filter spreads samples. Files of an unknown renderer may be of Mitsuba.
    spread = " Where a pixel filter spreads samples over several pixels Open Image Denoise leaves their noise."
    return [
        "Of a color image alone lobewise's own filters make a weak result, with 4 to 16 times the error of Open Image "
        f"Denoise, {peer}: {lead} {'; '.join(advice)}.{spread if preset.name in ('mitsuba', 'generic') else ''}"
    ]
