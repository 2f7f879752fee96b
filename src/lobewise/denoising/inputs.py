"""The images of a frame that a recipe reads, by its quality and its similarity."""

from __future__ import annotations

from collections.abc import Iterator

from lobewise.denoising.automatic import choose_similarity
from lobewise.records.frame import Frame
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_quality, get_similarity

Images = frozenset[tuple[str, str]]
"""Images of a frame: names of the record that holds an image, and of its field."""

_PARTS = ("color", "diffuse", "specular")
_SURFACE = (
    "depth", "position", "normal", "tangent", "alpha_u", "alpha_v", "lobe_kind", "diffuse_albedo", "specular_albedo",
    "material",
)  # fmt: skip
_GUIDED = ("mean_diffuse_albedo", "mean_specular_albedo", "mean_emission", "coverage", "blur_radius")
_LOBES = ("alpha_u", "alpha_v", "lobe_kind", "tangent", "material")


def list_images(settings: DenoiseSettings) -> Images:
    """Return the images that `denoise` may read of any frame; the quality of ``settings`` is chosen."""
    images = {("radiance", part) for part in _PARTS} | {("gbuffer", name) for name in _SURFACE}
    if get_quality(settings.quality).reads_halves:
        images |= {(half, part) for half in ("half_a", "half_b") for part in _PARTS}
        images |= {("gbuffer", name) for name in _GUIDED}
        if get_quality(settings.quality).refines:
            images.add(("gbuffer", "mean_normal"))
    else:
        images.add(("variance", "color"))
    return frozenset(images)


POSITION_WITHOUT_CAMERA = "position is given without a camera, so places are not compared."
DEPTH_WITHOUT_CAMERA = "depth is given without a camera, so it tells surfaces from the background, but no places."


def describe_lacks(frame: Frame, named: DenoiseSettings) -> Iterator[str]:
    """Yield a sentence for each image that waits for another one, which the frame lacks.

    ``named`` are the settings of the user: what they leave out is not missed, and what they ask for is an error.
    """
    guides, radiance = frame.gbuffer, frame.radiance
    places = guides.is_placed
    is_auto = named.similarity == "auto"
    if places and frame.camera is None and (is_auto or not get_similarity(named.similarity).has_lobes):
        yield DEPTH_WITHOUT_CAMERA if guides.position is None else POSITION_WITHOUT_CAMERA
    if is_auto and guides.alpha_u is not None and not get_similarity(choose_similarity(frame, named)).has_lobes:
        lacks = [*(["a camera"] if frame.camera is None else []), *([] if places else ["position or depth"])]
        yield f"alpha_u is given without {' and '.join(lacks)}, so normals are compared instead of reflection lobes."
    for one, other in (("half_a", "half_b"), ("half_b", "half_a")):
        if getattr(frame, one) is not None and getattr(frame, other) is None:
            yield f"{one} is given without {other}, so it is not used."
    for one, other in (("diffuse", "specular"), ("specular", "diffuse")):
        if getattr(radiance, one) is not None and getattr(radiance, other) is None:
            yield f"radiance.{one} is given without radiance.{other}, so the light is filtered as a whole."


def list_unused(frame: Frame, settings: ResolvedSettings) -> tuple[str, ...]:
    """Return the images of a frame that change nothing with these settings, by their names.

    Motion is used by `lobewise.TemporalFilter` alone; the direct and the indirect part of the light only tell what the
    total holds.
    """
    used = {name for owner, name in list_images(settings) if owner == "gbuffer"}
    similarity, quality = get_similarity(settings.similarity), get_quality(settings.quality)
    if not similarity.has_lobes and settings.band_limit is None:
        # The network that refines the image reads the roughness.
        used -= set(_LOBES) - ({"alpha_u", "alpha_v"} if quality.refines else set())
    elif not similarity.has_covariance:
        used -= {"tangent"}
    if not similarity.is_mixture:
        used -= {"material"}
    apart = frame.radiance.parts is not None
    if not apart:
        used -= set(_GUIDED)
    if settings.with_oidn or quality.refines:
        used |= {"mean_normal", "mean_diffuse_albedo", "mean_specular_albedo"}
    # Readers keep albedo and normal a second time, for Open Image Denoise: the file has them once.
    used |= {"denoiser_albedo", "denoiser_normal"}
    unused = [name for name in frame.gbuffer.names if name not in used]
    unused += [f"radiance.{name}" for name in ("direct", "indirect") if getattr(frame.radiance, name) is not None]
    if not apart:
        unused += [f"radiance.{name}" for name in ("diffuse", "specular") if getattr(frame.radiance, name) is not None]
    if not quality.reads_halves:
        unused += [name for name in ("half_a", "half_b") if getattr(frame, name) is not None]
    elif frame.variance is not None:
        # Halves tell the noise, and without them residuals do.
        unused.append("variance")
    return tuple(unused)
