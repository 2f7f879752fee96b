"""What a file of fewer passes would give: the frames of the bench with some of their guides alone."""

import numpy as np

from lobewise.interchange.reading import import_planes
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

GUIDE_SETS = ("all", "passes", "plain", "color")
_COMPONENTS = {"normal": "XYZ", "denoiser_normal": "XYZ", "depth": "", "roughness": ""}


def reduce_frame(frame: Frame, guides: str, albedo: FloatArray | None = None) -> Frame | None:
    """Return what `lobewise denoise` makes of a file that has nothing of a frame but some passes.

    "all" is the frame itself. "passes" keeps diffuse and specular light, an albedo of each, the normal averaged over
    the pixel, one roughness, the depth and the camera; None where the light is not told apart. "plain" keeps color,
    one albedo, such a normal and the depth; "color" the color. No set but "all" has halves, a variance or a sample
    count. The channels go through the reading of other renderers' files, under usual names.

    Parameters
    ----------
    frame : Frame
    guides : str
        One of `GUIDE_SETS`.
    albedo : (height, width, 3), optional
        The one of "plain"; by default the sum of the diffuse and specular ones.
    """
    if guides == "all":
        return frame
    images = {"": frame.radiance.color}
    mapping = {}
    if guides in ("passes", "plain"):
        images |= _take_surfaces(frame)
        if frame.gbuffer.denoiser_normal is not None:
            # The peer is handed it, so the file has it.
            images["denoiser_normal"] = frame.gbuffer.denoiser_normal
            mapping["denoiser_normal"] = ",".join(_name_channels("denoiser_normal", images["denoiser_normal"]))
    if guides == "passes":
        if frame.radiance.diffuse is None or frame.radiance.specular is None:
            return None
        images |= _take_split(frame)
        mapping |= {name: ",".join(_name_channels(name, images[name])) for name in ("diffuse", "specular")}
        if "alpha_roughness" in images:
            mapping["roughness"] = "alpha_roughness"
    if guides == "plain":
        one = albedo if albedo is not None else sum_albedos(frame)
        images |= {} if one is None else {"albedo": one}
    planes = {}
    for name, image in images.items():
        whole = np.ascontiguousarray(image, dtype=np.float32)
        for index, channel in enumerate(_name_channels(name, whole)):
            planes[channel] = whole if whole.ndim == 2 else np.ascontiguousarray(whole[..., index])
    camera = frame.camera if guides == "passes" else None
    return import_planes(planes, preset="generic", mapping=mapping, camera=camera).frame


def sum_albedos(frame: Frame) -> FloatArray | None:
    """Return the albedo of all lobes, averaged over the samples, in [0, 1]; None where there is none."""
    guides = frame.gbuffer
    parts = [part for part in (guides.diffuse_albedo, guides.specular_albedo) if part is not None]
    return np.clip(np.sum(parts, axis=0, dtype=np.float32), 0.0, 1.0) if parts else None


def make_peer(frame: Frame) -> Frame:
    """Return the guides that a file without "mean" images has for Open Image Denoise: its one albedo and its normal."""
    normal = _take_surfaces(frame).get("normal")
    return Frame(Radiance(frame.radiance.color), GBuffer(normal=normal, diffuse_albedo=sum_albedos(frame)))


def _take_surfaces(frame: Frame) -> dict[str, FloatArray]:
    guides = frame.gbuffer
    normal = guides.mean_normal if guides.mean_normal is not None else guides.normal
    found = {"normal": normal, "depth": guides.depth}
    return {name: image for name, image in found.items() if image is not None}


def _take_split(frame: Frame) -> dict[str, FloatArray]:
    radiance, guides = frame.radiance, frame.gbuffer
    found = {
        "diffuse": radiance.diffuse,
        "specular": radiance.specular,
        "diffuse_albedo": guides.diffuse_albedo,
        "specular_albedo": guides.specular_albedo,
    }
    if guides.alpha_u is not None:
        along, across = guides.alpha_u, guides.alpha_v if guides.alpha_v is not None else guides.alpha_u
        found["alpha_roughness"] = np.sqrt(along * across)
    return {name: image for name, image in found.items() if image is not None}


def _name_channels(name: str, image: FloatArray) -> list[str]:
    """Return the channels that a file has for an image."""
    if image.ndim == 2:
        return ["depth.Z" if name == "depth" else name]
    letters = _COMPONENTS.get(name, "RGB")
    return [f"{name}.{letter}" if name else letter for letter in letters]
