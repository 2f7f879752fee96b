"""Steps that import a file in lobewise's own channel names: its values stand as a frame has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lobewise.errors import InputError
from lobewise.interchange.cameras.fitting import MAX_FIT_ERROR, measure_fit
from lobewise.interchange.checks.lacks import list_uses
from lobewise.interchange.importing.draft import Draft, Outcome
from lobewise.io.exr.container import show_name
from lobewise.io.exr.describe import COSTS, Lack
from lobewise.io.exr.header import read_camera, read_lobe_tables, read_spp
from lobewise.io.exr.layout import build_frame
from lobewise.io.exr.schema import CAMERA, SLOTS, SPP
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer

REMEDY = "lobewise render, which writes every guide in one pass"
"""Remedy for images that a file in lobewise's names lacks."""


def make_own_frame(draft: Draft) -> Outcome:
    """Make the frame of the images and of what lobewise wrote into the header."""
    part, tables = draft.image_part, draft.lobe_tables
    camera = read_camera(part)
    frame = build_frame(
        {(slot.owner, slot.field): draft.images[slot.role] for slot in SLOTS if slot.role in draft.images},
        camera if draft.given_camera is None else draft.given_camera,
        read_spp(part),
        read_lobe_tables(part) if tables is None else tuple(tables),
    )
    if draft.given_camera is not None and not draft.wraps:
        _require_fit(draft.given_camera, frame.gbuffer)
    return Outcome(replace(draft, frame=frame.with_changes(wraps=bool(draft.wraps))))


def _require_fit(camera: Camera, guides: GBuffer) -> None:
    """Raise InputError if the user's camera does not see the positions of the file at their pixels."""
    position = guides.position
    if position is None:
        return
    there = np.isfinite(position).all(axis=-1) & (position != 0.0).any(axis=-1)
    if guides.depth is not None:
        there &= guides.depth > 0.0
    error = measure_fit(camera, position, there) if there.any() else 0.0
    if error >= MAX_FIT_ERROR:
        raise InputError(
            "--camera",
            expected="the camera that sees the positions of the file where they are",
            got=f"one that sees half of them more than {error:.1f} pixels away",
            action="leave --camera out, or give that of this frame",
        )


def tell_own_lacks(draft: Draft) -> Outcome:
    """Tell what the frame lacks of what denoising can use, and which parts stay as they are."""
    frame, image = draft.frame, draft.image_part
    assert frame is not None
    told = _explain_no_lobes(frame)
    lacks = [
        Lack(role, COSTS[role], REMEDY, told=told) for role in COSTS if role not in list_uses(draft.channels, frame)
    ]
    notes = [told] if told else []
    if frame.gbuffer.alpha_v is not None and frame.gbuffer.tangent is None:
        notes.append("Without tangent.X/Y/Z the similarity ggx is refused where alpha.V differs from alpha.U.")
    if frame.spp is None:
        notes.append(
            f"Without the attribute {SPP} the amount of noise is judged by the variance, or taken as that of 4 samples."
        )
    for part in draft.container.parts:
        if part.data_window != image.data_window:
            name = show_name(part.name) or str(part.index)
            notes.append(f"Part {name!r} has another data window than the image and is only copied.")
    return Outcome(replace(draft, lacks=tuple(lacks)), notes=notes)


def _explain_no_lobes(frame: Frame) -> str:
    """Return why normals are compared and not reflection lobes; empty where lobes are, or there are no normals."""
    guides = frame.gbuffer
    lacks = {
        "alpha.U": guides.alpha_u is None,
        "depth.Z or position.X/Y/Z": not guides.is_placed,
        f"the camera ({CAMERA}...)": frame.camera is None,
    }
    if guides.normal is None or not any(lacks.values()):
        return ""
    missing = " and ".join(what for what, is_missing in lacks.items() if is_missing)
    return f"Without {missing} only normals can be compared, not reflection lobes."
