"""An image without any guide: that lobewise is weak there, and what to do, said once and honestly."""

from __future__ import annotations

from lobewise.frame import Frame
from lobewise.interchange.mapping import ChannelMap

SWITCHES = ("normal", "position", "layers", "albedo", "roughness")
"""Roles whose passes are worth naming, in the order of what they bring."""


def describe_alone(channels: ChannelMap, frame: Frame) -> list[str]:
    """Return what is said, in place of everything that is missing, where there is nothing to denoise by but the image.

    Measured at 16 samples per pixel, the error over that of Open Image Denoise, which has no guides either: 4, 9, 16
    and 4 on scenes of Blender, 6 and 4 on those of LuxCore; on two of Mitsuba 0.4, for its pixel filter spreads every
    sample over several pixels, and Open Image Denoise leaves such noise.
    """
    guides, preset = frame.gbuffer, channels.preset
    known = (guides.position, guides.depth, guides.diffuse_albedo, guides.specular_albedo, guides.alpha_u)
    if "normal" in channels.roles or frame.radiance.parts is not None or any(image is not None for image in known):
        return []
    advice = [text for role in SWITCHES if (text := preset.advice.get(role, "none")) and not text.startswith("none")]
    lead = "render with" if preset.name == "generic" else f"switch on in {preset.title}:"
    return [
        "Of a color image alone lobewise's own filters make a weak result, with 4 to 16 times the error of Open Image "
        "Denoise, which is used where it is installed (pip install 'lobewise[best]') and neither --offline nor a "
        f"quality is given: {lead} {'; '.join(advice)}. Where a pixel filter spreads samples over several pixels "
        "(Mitsuba's) Open Image Denoise leaves their noise."
    ]
