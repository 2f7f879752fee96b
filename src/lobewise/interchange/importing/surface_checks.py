"""Steps that hold positions, depths and normals of a foreign frame against each other, and correct them."""

from __future__ import annotations

from dataclasses import replace

from lobewise.guides.stand_ins import compute_surface_normals
from lobewise.interchange.checks.depths import check_depth_by_normal, check_depth_by_position
from lobewise.interchange.checks.finding import Finding, list_names
from lobewise.interchange.checks.geometry import list_patches
from lobewise.interchange.checks.normals import check_normals, take_assumed
from lobewise.interchange.checks.precision import measure_grain
from lobewise.interchange.importing.draft import Draft, Outcome


def check_position_precision(draft: Draft) -> Outcome:
    """Drop positions that are stored too coarsely where camera and depth are finer; else tell that they are coarse."""
    grain = measure_grain(draft.images["position"])
    if not grain.is_coarse:
        return Outcome(draft)
    note = (
        f"{draft.roles['position'].label} is stored in {grain.bits}-bit floats, whose steps here are {grain.tell()}: "
    )
    depth = draft.images.get("depth")
    is_finer = depth is not None and measure_grain(depth, grain.distance).coarseness < 0.5 * grain.coarseness
    has_rays = draft.camera is not None and not draft.is_orthographic and not draft.wraps
    if is_finer and has_rays and draft.distance is not None:
        note += f"depth ({draft.roles['depth'].label}) and camera stand for it."
        return Outcome(replace(draft, world_position=None), [Finding("positions coarse", note, mended=True)])
    lacks = [*(["a depth"] if depth is None else []), *(["a camera"] if draft.camera is None else [])]
    note += f"store it in 32 bits, or nearer to the origin{f', or give {list_names(lacks)}' if lacks else ''}."
    return Outcome(draft, [Finding("positions coarse", note, mended=False)])


def check_depth(draft: Draft) -> Outcome:
    """Hold the depth against the positions, or without positions against the normals."""
    camera, depth = draft.camera, draft.distance
    position, normal = draft.world_position, draft.world_normal
    if camera is None or depth is None or (position is None and normal is None):
        return Outcome(draft)
    found = draft.roles["depth"]
    planar = "planar" in found.convert
    if position is not None:
        checked = check_depth_by_position(depth, position, camera, found.label, planar=planar)
    else:
        assert normal is not None
        checked = check_depth_by_normal(depth, normal, camera, found.label, planar=planar)
    changed = replace(
        draft, distance=checked.distance, is_depth_replaced=draft.is_depth_replaced or checked.is_replaced
    )
    return Outcome(changed, checked.findings)


def check_normal_space(draft: Draft) -> Outcome:
    """Turn normals to world space, on the camera's side, if the surfaces show that they are in another space."""
    camera, normal, position = draft.camera, draft.world_normal, draft.world_position
    if camera is None or normal is None or (position is None and draft.distance is None):
        return Outcome(draft)
    if position is None:
        assert draft.distance is not None
        position = camera.make_positions(draft.distance)
    found, surface = draft.roles["normal"], position
    normal, findings = check_normals(
        normal,
        found.label,
        take_assumed(found.convert),
        list_patches(surface, camera),
        camera,
        draft.header_camera.camera if draft.header_camera else None,
        lambda: compute_surface_normals(surface, camera),
        sure="depth" in draft.roles and not draft.is_depth_replaced,
    )
    turned = replace(draft, world_normal=normal)
    if findings and draft.world_position is None and "depth" in draft.roles:
        # The depth was held against normals that were not right yet.
        again = check_depth(turned)
        return Outcome(again.draft, [*findings, *again.findings])
    return Outcome(turned, findings)
