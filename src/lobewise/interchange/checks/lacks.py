"""What a foreign frame has of what denoising can use, what it lacks, what follows, and what to switch on."""

from __future__ import annotations

from collections.abc import Iterable

from lobewise.frame import Frame
from lobewise.interchange.checks.alone import describe_alone
from lobewise.interchange.checks.denoised import MARKED
from lobewise.interchange.checks.finding import Finding
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
        "silhouettes": guides.coverage is not None and frame.radiance.parts is not None,
        "halves": frame.half_a is not None,
    }
    return tuple(use for use in USES if there[use])


def list_lacks(channels: ChannelMap, frame: Frame, findings: Iterable[Finding]) -> list[Lack]:
    """Return what a frame lacks, each with the sentence that says so, unless one sentence says it of an image alone."""
    advice, lacks, is_alone = channels.preset.advice, [], bool(describe_alone(channels, frame))
    is_marked = any(one.what == MARKED and one.mended for one in findings)
    for role in [role for role in COSTS if role not in list_uses(channels, frame)]:
        # A camera alone places nothing, and positions bring a camera.
        asked = "position" if role == "camera" and not frame.gbuffer.is_placed and "position" in advice else role
        told = advice.get(asked) or advice.get({"albedo": "diffuse_albedo"}.get(role, ""), "")
        if role in channels.roles:
            told = f"none; {channels.roles[role].label} is there, but no layer of light takes it"
        if role == "layers" and is_marked:
            told = "none; the passes of light are denoised by lobewise already"
        remedy, reason = ("", told.removeprefix("none; ")) if told.startswith("none") else (told, "")
        # A renderer that is not known has no menu.
        lead = "give" if channels.preset.name == "generic" else f"{channels.preset.title} gives it by:"
        more = f"; {lead} {remedy}" if remedy else f" ({reason})" if reason else ""
        name = "positions" if role == "camera" and frame.camera is not None else role
        kind = f"{name} that can be used" if channels.refused.keys() & {role, asked} else name
        told = "" if is_alone else f"No {kind}: {COSTS[role]}{more}."
        lacks.append(Lack(role, COSTS[role], remedy, reason, told))
    return lacks
