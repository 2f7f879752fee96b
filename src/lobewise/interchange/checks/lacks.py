"""What a foreign frame has of what denoising can use, what it lacks, what follows, and what to switch on."""

from __future__ import annotations

from lobewise.frame import Frame
from lobewise.interchange.mapping import ChannelMap
from lobewise.io.exr.describe import COSTS, USES, Lack


def list_uses(channels: ChannelMap, frame: Frame) -> tuple[str, ...]:
    """Return what denoising uses of a frame, of `lobewise.io.exr.describe.USES`."""
    guides = frame.gbuffer
    there = {
        "normal": "normal" in channels.roles,
        "roughness": guides.alpha_u is not None,
        "camera": frame.is_placed,
        "layers": frame.radiance.parts is not None,
        "albedo": guides.diffuse_albedo is not None or guides.specular_albedo is not None,
        "silhouettes": guides.coverage is not None,
        "halves": frame.half_a is not None,
        "variance": frame.variance is not None,
    }
    return tuple(use for use in USES if there[use])


def list_lacks(channels: ChannelMap, frame: Frame) -> list[Lack]:
    """Return what a frame lacks, each with the sentence that says so."""
    advice, lacks = channels.preset.advice, []
    for role in [role for role in COSTS if role not in list_uses(channels, frame)]:
        # A camera alone places nothing, and positions bring a camera.
        asked = "position" if role == "camera" and not frame.gbuffer.is_placed and "position" in advice else role
        told = advice.get(asked) or advice.get({"albedo": "diffuse_albedo"}.get(role, ""), "")
        if role in channels.roles:
            told = f"none; {channels.roles[role].label} is there, but no layer of light takes it"
        remedy, reason = ("", told.removeprefix("none; ")) if told.startswith("none") else (told, "")
        more = f"; {channels.preset.title} gives it by: {remedy}" if remedy else f" ({reason})" if reason else ""
        name = "positions" if role == "camera" and frame.camera is not None else role
        lacks.append(Lack(role, COSTS[role], remedy, reason, f"No {name}: {COSTS[role]}{more}."))
    return lacks
