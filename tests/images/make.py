r"""Cut the frames of the image tests out of rendered ones: run it once, with the renders at hand.

    python -m benchmarks.users.render RENDERS --group own
    python benchmarks/foreign/render_luxcore.py RENDERS/luxcore --scenes room,sparks --size 192x144
    python benchmarks/foreign/factory RENDERS/factory --kinds fog --seeds 11 --spp 1
    python benchmarks/foreign/render_luxcore.py RENDERS/crops --scenes room,glass --size 192x144 --spp 8 \
        --reference 1024
    python benchmarks/foreign/factory RENDERS/factory --kinds screens --seeds 14 --spp 16 --reference 1536
    python -m benchmarks.foreign.render_mitsuba RENDERS/mitsuba
    python -m tests.images.make RENDERS

The frames in ``RENDERS/blender`` and ``RENDERS/mitsuba`` are those of ``benchmarks/foreign`` and of
``tests/images/render_cycles.py`` at the tag ``trials-2026-11``; this file says there how they are rendered.

The data window of a cut says where it lies in the render, so that the camera is right. Light and albedo become half
floats, as Blender writes them. Normals and roughness keep 12 bits, places 18, so that the files compress. The four
crops are larger and keep fewer bits of everything, see `COARSE` and, for their references, `CLEAN`.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenEXR

import lobewise
from lobewise.interchange import read_image
from lobewise.io.exr import write_frame, write_image
from lobewise.io.exr.sparse import write_sparse_frame
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import make_sparse

HERE = Path(__file__).parent
DATA, REFERENCES = HERE / "data", HERE / "data" / "references"
NORMAL_BITS, PLACE_BITS = 12, 18


class Bits(NamedTuple):
    """Significant bits that light and albedo, normals and roughness, and places keep; half floats have 11."""

    light: int = 11
    normal: int = NORMAL_BITS
    place: int = PLACE_BITS


FINE, COARSE, CLEAN = Bits(), Bits(9, 10, 14), Bits(light=8)
CROPS = DATA / "crops"
CROP_SIZE = 192, 144
ROOM_OUTPUTS = (
    "RGB", "ALBEDO", "AVG_SHADING_NORMAL", "POSITION", "DIRECT_DIFFUSE", "INDIRECT_DIFFUSE", "DIRECT_GLOSSY",
    "INDIRECT_GLOSSY", "INDIRECT_SPECULAR", "EMISSION", "SAMPLECOUNT",
)  # fmt: skip
GLASS_OUTPUTS = ("RGB", "ALBEDO", "AVG_SHADING_NORMAL")
SCREENS_LIGHT = ("Combined", "DiffCol", "DiffDir", "DiffInd", "GlossCol", "GlossDir", "GlossInd")
UNUSED_PASSES = ("IndexOB", "Vector", "Denoising Depth")
PLACES = ("position", "depth", "distance")
"""Words in the names of channels that keep `PLACE_BITS`."""
PARTS = ("color", "diffuse", "specular")
OWN_SIZE = 44, 44
MATTE = "CryptoObject"
AP1_TO_REC709 = np.array(
    [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]], dtype=np.float32
)
"""ACEScg to linear Rec. 709, Bradford's adaptation; computed from the primaries of both."""


def round_floats(values: Any, bits: int) -> Any:
    """Return values with so many significant bits."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.rint(np.ldexp(mantissa, bits)), exponent - bits).astype(np.float32)


def cut(image: Any, size: tuple[int, int]) -> Any:
    """Return the middle of an image, of a width and a height: cameras that tests fit look at the middle."""
    x, y = locate_corner(image, size)
    return np.ascontiguousarray(image[y : y + size[1], x : x + size[0]])


def locate_corner(image: Any, size: tuple[int, int]) -> tuple[int, int]:
    """Return the left column and the top row of the middle of an image."""
    return (image.shape[1] - size[0]) // 2, (image.shape[0] - size[1]) // 2


def shrink(name: str, values: Any, bits: Bits = FINE) -> Any:
    """Return a channel in the type and precision that the file keeps."""
    if MATTE in name or (values.dtype == np.float16 and bits == FINE):
        return values
    if any(word in name.lower() for word in PLACES):
        return round_floats(values, bits.place)
    if "normal" in name.lower() or name.rpartition(".")[2] not in "RGBA":
        return round_floats(values, bits.normal)
    return (values if bits == FINE else round_floats(values, bits.light)).astype(np.float16)


def cut_file(
    source: Path,
    target: Path,
    size: tuple[int, int],
    *,
    keep: Callable[[str], bool] = lambda name: True,
    bits: Bits = FINE,
    others: Sequence[Path] = (),
) -> None:
    """Write a part of a file, or of its mean with others, with those passes that are kept, and its attributes."""
    more = [OpenEXR.File(str(path), separate_channels=True).channels() for path in others]
    with OpenEXR.File(str(source), separate_channels=True) as file:
        part = file.parts[0]
        channels = {}
        for name in filter(keep, part.channels):
            pixels = [each[name].pixels for each in (part.channels, *more)]
            mean = np.mean(pixels, axis=0, dtype=np.float32) if more else pixels[0]
            channels[name] = OpenEXR.Channel(shrink(f"{source.stem}.{name}", cut(mean, size), bits))
        x, y = locate_corner(next(iter(part.channels.values())).pixels, size)
        dropped = ("channels", "chunkCount", "Date", "Time", "RenderTime", "File", "capDate", "compression")
        header = {
            key: value
            for key, value in part.header.items()
            if key not in dropped and (not key.startswith("crypto") or any(MATTE in name for name in channels))
        }
    header["dataWindow"] = (np.array([x, y], np.int32), np.array([x + size[0] - 1, y + size[1] - 1], np.int32))
    header["compression"] = OpenEXR.ZIP_COMPRESSION
    target.parent.mkdir(parents=True, exist_ok=True)
    OpenEXR.File(header, channels).write(str(target))


def keeps_pass(*, matte: bool = False) -> Callable[[str], bool]:
    """Return whether a channel of Cycles is kept."""
    return lambda name: (matte or MATTE not in name) and not any(f"{each}." in name for each in UNUSED_PASSES)


def read_total(path: Path, size: tuple[int, int]) -> FloatArray:
    """Return the middle of the image of a file."""
    image: FloatArray = cut(lobewise.read_frame(path, light_passes=False).radiance.color, size)
    return image


CYCLES: Mapping[str, tuple[str, tuple[int, int], bool]] = {
    "lamps": ("string_16", (40, 40), True),
    "textures": ("textured_4", (40, 48), False),
    "glass": ("glass_16", (48, 44), False),
    "leaves": ("foliage_4", (40, 40), False),
    "one_sample": ("grass_1", (24, 72), False),
    "fog": ("fog_4", (48, 48), False),
    "edges": ("fence_16", (40, 40), True),
}
"""Scene and samples per pixel, width and height, and whether the object mattes are kept."""
SMALL_CYCLES: Mapping[str, tuple[str, tuple[int, int]]] = {
    "lens": ("lens_16", (48, 40)),
    "film": ("film_4", (48, 40)),
    "groups": ("groups_16", (48, 40)),
    "views": ("stereo_4", (40, 32)),
}


def cut_haze(folder: Path) -> None:
    """Cut a shot of fog at one sample per pixel."""
    size, name = (48, 48), "haze"
    cut_file(folder / "1.exr", DATA / f"{name}.exr", size, keep=keeps_pass())
    references = [read_total(folder / f"reference_{part}.exr", size) for part in (1, 2, 3)]
    write_image(REFERENCES / f"{name}.exr", np.mean(references, axis=0, dtype=np.float32), half=True)


def is_image(name: str) -> bool:
    """Return whether a channel of Cycles belongs to the image."""
    return ".Combined." in name


def cut_cycles(folder: Path) -> None:
    """Cut Blender's frames."""
    for name, (stem, size, matte) in CYCLES.items():
        cut_file(folder / f"{stem}_1.exr", DATA / f"{name}.exr", size, keep=keeps_pass(matte=matte))
        write_reference(name, folder, stem, size)
    for name, (stem, size) in SMALL_CYCLES.items():
        cut_file(folder / f"{stem}_1.exr", DATA / f"{name}.exr", size, keep=keeps_pass())
        reference = folder / f"{stem.rpartition('_')[0]}_reference_1.exr"
        cut_file(reference, REFERENCES / f"{name}.exr", size, keep=keeps_pass() if name == "groups" else is_image)
    cut_file(folder / "room_4_1.exr", DATA / "color_alone.exr", (64, 64), keep=is_image)
    write_reference("color_alone", folder, "room_4", (64, 64))


def write_reference(
    name: str, folder: Path, stem: str, size: tuple[int, int], join: str = "_reference_", end: str = ".exr"
) -> None:
    """Write the mean of a frame's two references."""
    scene = stem.rpartition(join[0])[0]
    first, second = (read_total(folder / f"{scene}{join}{half}{end}", size) for half in (1, 2))
    REFERENCES.mkdir(parents=True, exist_ok=True)
    write_image(REFERENCES / f"{name}.exr", 0.5 * (first + second), half=True)


def cut_luxcore(folder: Path) -> None:
    """Cut LuxCore's frames, a file for each output."""
    for name, stem, kept in (("luxcore", "room_16", ()), ("sparks", "sparks_4", ("RGB", "ALBEDO", "SHADING_NORMAL"))):
        for path in sorted((folder / f"{stem}_1").glob("*.exr")):
            if not kept or path.stem in kept:
                cut_file(path, DATA / name / path.name, (48, 48))
        write_reference(name, folder, stem, (48, 48), end="/RGB.exr")


def read_images(owner: Any, size: tuple[int, int]) -> dict[str, FloatArray]:
    """Return the middle of every image of a G-buffer or a radiance, by name."""
    return {name: cut(getattr(owner, name), size) for name in owner.names}


def read_middle(path: Path) -> Frame:
    """Return the middle of a frame of our own, in the precision that the tests keep."""
    whole = lobewise.read_frame(path)
    guides = read_images(whole.gbuffer, OWN_SIZE)
    for name, image in guides.items():
        guides[name] = round_floats(image, PLACE_BITS if any(word in name for word in PLACES) else NORMAL_BITS)
    # Shares of neighbours that were cut off go to the pixel itself.
    outside = ~mark_neighbours(*OWN_SIZE)
    guides["coverage"][..., 4] += np.where(outside, guides["coverage"], 0.0).sum(axis=-1)
    guides["coverage"][outside] = 0.0
    light = {}
    for owner in ("radiance", "half_a", "half_b"):
        images = read_images(getattr(whole, owner), OWN_SIZE)
        light[owner] = Radiance(**{part: images[part] for part in PARTS})
    fov_y = 2.0 * np.arctan(np.tan(0.5 * whole.camera.fov_y) * OWN_SIZE[1] / whole.height)
    return Frame(**light, gbuffer=GBuffer(**guides), camera=replace(whole.camera, fov_y=float(fov_y)), spp=whole.spp)


def mark_neighbours(width: int, height: int) -> Any:
    """Return which of the 3x3 neighbours of every pixel lie in the image, shape (height, width, 9)."""
    inside = np.pad(np.ones((height, width), dtype=bool), 1)
    shifted = [inside[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.stack(shifted, axis=-1)


def break_pixels(frame: Frame) -> Frame:
    """Return a frame with pixels that are NaN or infinite, and with a firefly, in the total and in its parts."""
    light = {}
    for owner in ("radiance", "half_a"):
        images = {name: np.array(getattr(getattr(frame, owner), name)) for name in PARTS}
        for name in ("color", "specular"):
            images[name][10, 10:13], images[name][30, 20] = np.nan, np.inf
            images[name][20, 33] += 200.0
        light[owner] = Radiance(**images)
    return frame.with_changes(**light)


def cut_own(folder: Path) -> None:
    """Cut frames of our own renderer, of which one has broken pixels, one is sparse, one has colours out of gamut."""
    for name, stem in (("halves", "showroom-4"), ("brushed", "brushed-16"), ("broken", "parlour-4")):
        frame = read_middle(folder / f"{stem}.exr")
        write_frame(DATA / f"{name}.exr", break_pixels(frame) if name == "broken" else frame)
        write_reference(name, folder, stem, OWN_SIZE, join="-ref-")
    write_sparse_frame(DATA / "sparse.exr", make_sparse(read_middle(folder / "parlour-16.exr"), 2))
    write_reference("sparse", folder, "parlour-16", OWN_SIZE, join="-ref-")
    write_out_of_gamut(folder)


def write_out_of_gamut(folder: Path) -> None:
    """Write a frame that was rendered in another space than the file's: saturated colours are below 0."""
    frame = read_middle(folder / "showroom-16.exr")
    guides = frame.gbuffer
    albedo = guides.mean_diffuse_albedo + guides.mean_specular_albedo
    images = {"": frame.radiance.color @ AP1_TO_REC709.T, "albedo.": albedo, "nn.": guides.mean_normal}
    channels = {}
    for name, image in images.items():
        for letter, plane in zip("XYZ" if name == "nn." else "RGB", np.moveaxis(image, -1, 0), strict=True):
            channels[name + letter] = OpenEXR.Channel(shrink(name + letter, np.ascontiguousarray(plane)))
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(DATA / "gamut.exr"))
    write_reference("gamut", folder, "showroom-16", OWN_SIZE, join="-ref-")
    path = REFERENCES / "gamut.exr"
    write_image(path, read_image(path) @ AP1_TO_REC709.T, half=True)


def cut_mitsuba(folder: Path) -> None:
    """Keep the frame that Mitsuba's own integrators make."""
    cut_file(folder / "principled_4_1.exr", DATA / "mitsuba.exr", (52, 40), keep=lambda name: "nested" not in name)
    write_reference("mitsuba", folder, "principled_4", (52, 40))


def cut_crops(renders: Path) -> None:
    """Cut the four large frames; the reference of Cycles keeps its passes of light."""
    luxcore, shot, metals = renders / "crops", renders / "factory" / "screens_14", renders / "mitsuba" / "metals"
    for name, kept in (("room", ROOM_OUTPUTS), ("glass", GLASS_OUTPUTS)):
        for output in kept:
            source = luxcore / f"{name}_8_1" / f"{output}.exr"
            cut_file(source, CROPS / name / source.name, CROP_SIZE, bits=COARSE)
        write_crop_reference(name, [luxcore / f"{name}_reference_{half}" / "RGB.exr" for half in (1, 2)])
    cut_file(shot / "16.exr", CROPS / "screens.exr", CROP_SIZE, keep=is_in_screens, bits=COARSE)
    parts = [shot / f"reference_{part}.exr" for part in (1, 2, 3)]
    write_crop_reference("screens", parts, keep=lambda name: name.split(".")[1] in SCREENS_LIGHT)
    cut_file(
        Path(f"{metals}_4_1.exr"), CROPS / "metals.exr", CROP_SIZE, keep=lambda name: "img" not in name, bits=COARSE
    )
    halves = [Path(f"{metals}_reference_{half}.exr") for half in (1, 2)]
    write_crop_reference("metals", halves, keep=lambda name: name in "RGB")


def is_in_screens(name: str) -> bool:
    """Return whether a channel is kept of the crop of Cycles, in which no light is transmitted."""
    return keeps_pass()(name) and ".Trans" not in name


def write_crop_reference(name: str, paths: Sequence[Path], keep: Callable[[str], bool] = lambda name: True) -> None:
    """Write the mean of a crop's references."""
    first, *others = paths
    cut_file(first, REFERENCES / CROPS.name / f"{name}.exr", CROP_SIZE, keep=keep, bits=CLEAN, others=others)


def main() -> None:
    """Cut all."""
    renders = Path(sys.argv[1])
    cut_cycles(renders / "blender")
    cut_haze(renders / "factory" / "fog_11")
    cut_luxcore(renders / "luxcore")
    cut_own(renders / "own")
    cut_mitsuba(renders / "mitsuba")
    cut_crops(renders)


if __name__ == "__main__":
    main()
