"""The steps of an import, in the order in which one mistake of a file would hide another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lobewise.interchange.checks.denoised import leave_out_denoised_light
from lobewise.interchange.checks.guides import leave_out_empty
from lobewise.interchange.imported import ImageReader, Imported
from lobewise.interchange.importing.draft import Draft, Section, Step, list_notes, run_steps
from lobewise.interchange.importing.finishing import (
    check_image_noise,
    check_roughness_meaning,
    check_roughness_range,
    choose_albedos,
    compute_known_silhouettes,
    estimate_silhouettes,
    lend_lone_albedo,
    list_outputs,
    make_frame,
    take_known_light,
    take_light,
    take_out_lamps,
    take_roughness,
    tell_assumed_roughness,
    tell_missing,
)
from lobewise.interchange.importing.guides import (
    check_albedo_ranges,
    check_own_result,
    correct_compressed_light,
    decode_declared_normals,
    decode_normals,
    fill_missing_values,
    read_images,
    tell_channels,
    turn_over_guides,
)
from lobewise.interchange.importing.own import make_own_frame, tell_own_lacks
from lobewise.interchange.importing.surface_checks import check_depth, check_normal_space, check_position_precision
from lobewise.interchange.importing.surfaces import (
    choose_camera,
    derive_depth,
    estimate_blur,
    mirror_positions,
    take_depth,
    take_normals,
    take_positions,
)
from lobewise.interchange.importing.unsampled import continue_into_gutters, mark_left_out
from lobewise.interchange.mapping import ChannelMap
from lobewise.io.exr.container import Container
from lobewise.records.camera import Camera
from lobewise.records.lobe_table import LobeTable

STEPS = (
    # Images as they stand in the file
    Step(tell_channels, section=Section.CHANNELS),
    Step(correct_compressed_light),
    Step(mark_left_out),
    Step(check_own_result),
    Step(read_images),
    Step(fill_missing_values),
    Step(turn_over_guides),
    Step(decode_normals, needs=("normal",)),
    Step(check_albedo_ranges),
    # Light
    Step(take_light, section=Section.LIGHT),
    Step(lend_lone_albedo, needs=("albedo",)),
    # Surfaces, converted to world space
    Step(take_positions, needs=("position",)),
    Step(estimate_blur, needs=("world_position",)),
    Step(choose_camera, section=Section.SURFACES),
    Step(take_depth, needs=("depth",), section=Section.SURFACES),
    Step(derive_depth, needs=("world_position", "camera")),
    Step(take_normals, needs=("normal",), section=Section.SURFACES),
    # Surfaces, held against each other
    Step(check_position_precision, needs=("position",)),
    Step(check_depth, needs=("depth", "camera")),
    Step(check_normal_space, needs=("normal", "camera")),
    # Material
    Step(choose_albedos),
    Step(take_roughness, needs=("roughness",), section=Section.CHANNELS),
    Step(check_roughness_range, needs=("roughness", "microfacet_alpha")),
    Step(check_roughness_meaning, needs=("roughness", "microfacet_alpha")),
    Step(estimate_silhouettes, section=Section.CHANNELS),
    Step(tell_assumed_roughness, section=Section.CHANNELS),
    # The frame as a whole
    Step(make_frame),
    Step(check_image_noise),
    Step(tell_missing, section=Section.MISSING),
    Step(take_out_lamps, section=Section.MISSING),
    Step(list_outputs, section=Section.MISSING),
    Step(continue_into_gutters),
)
"""Each step reads, converts or checks one thing. Later steps rely on what earlier ones corrected."""

OWN_STEPS = (
    Step(check_own_result),
    Step(read_images),
    Step(make_own_frame),
    Step(tell_own_lacks, section=Section.MISSING),
    Step(list_outputs),
)
"""The steps for a file in lobewise's own channel names."""

BAND_STEPS = (
    Step(correct_compressed_light),
    Step(read_images),
    Step(fill_missing_values),
    Step(decode_declared_normals, needs=("normal",)),
    Step(take_known_light),
    Step(lend_lone_albedo, needs=("albedo",)),
    Step(take_positions, needs=("position",)),
    Step(mirror_positions, needs=("world_position",)),
    Step(take_depth, needs=("depth",)),
    Step(derive_depth, needs=("world_position", "camera")),
    Step(take_normals, needs=("normal",)),
    Step(choose_albedos),
    Step(take_roughness, needs=("roughness",)),
    Step(compute_known_silhouettes),
    Step(make_frame),
    Step(take_out_lamps),
)
"""The steps for some rows of a file, after what the whole of it tells is known."""


def import_mapped(
    container: Container,
    read: ImageReader,
    channels: ChannelMap,
    camera: Camera | None = None,
    *,
    wraps: bool | None = None,
    lobe_tables: Sequence[LobeTable] | None = None,
    flips: Mapping[str, str] | None = None,
) -> tuple[Imported, ImageReader]:
    """Return the frame of a file whose channels are mapped, and a reader of its images that has the corrected light.

    Parameters
    ----------
    container : Container
        The file.
    read : ImageReader
        Reads its images.
    channels : ChannelMap
        Which channels are which image.
    camera : Camera or None
        The user's camera.
    wraps : bool or None
        As of `lobewise.Frame`; None if positions may tell.
    lobe_tables : sequence of LobeTable, or None
        The user's lobe tables, in place of those in the header.
    flips : mapping of str to str, or None
        As of `lobewise.interchange.import_file`.
    """
    read.expect(channels)
    used = channels
    if not channels.is_own:
        channels = leave_out_empty(channels, read)
        used = leave_out_denoised_light(container, channels)
    start = Draft(
        container=container,
        mapped=channels,
        channels=used,
        read=read,
        given_camera=camera,
        wraps=wraps,
        lobe_tables=lobe_tables,
        flips=flips,
    )
    draft = run_steps(start, OWN_STEPS if channels.is_own else STEPS)
    assert draft.frame is not None
    imported = Imported(
        frame=draft.frame,
        container=container,
        map=used,
        notes=list_notes(draft),
        outputs=draft.outputs,
        findings=draft.findings,
        shown=None if used.shown is None else draft.read(used.shown),
        lacks=draft.lacks,
        flips=draft.flips or {},
    )
    return imported, draft.read
