"""One small scene, computed point by point, as each renderer would write it."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from lobewise.records.camera import Camera

REAL = (
    "arnold_multichannel.exr",
    "beachball_multipart.0001.exr",
    "beachball_singlepart.0001.exr",
    "bright_rings_nan_inf.exr",
    "display_window_t03.exr",
    "mitsuba_multi_channels.exr",
    "special_chars.exr",
    "vray_cornellBox_CryptoWildcard.0001.exr",
)
"""Real files of the folder that LOBEWISE_TEST_DATA names."""
HEIGHT, WIDTH = 36, 48
CAMERA = Camera((0.3, -5.0, 1.6), (-0.05, 1.0, -0.2), (0.0, 0.0, 1.0), 0.7)


@dataclass(frozen=True)
class Scene:
    """What there is: a ball on a floor before a far background."""

    position: np.ndarray
    normal: np.ndarray
    depth: np.ndarray
    diffuse_albedo: np.ndarray
    specular_albedo: np.ndarray
    roughness: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    emission: np.ndarray

    @property
    def color(self) -> np.ndarray:
        return self.diffuse + self.specular + self.emission

    @property
    def surface(self) -> np.ndarray:
        return self.depth > 0.0


def make_scene() -> Scene:
    rays = CAMERA.make_ray_directions(WIDTH, HEIGHT).astype(np.float64)
    eye, center, radius = CAMERA.position, np.array([0.0, 0.0, 0.8]), 0.8
    b = (rays * (eye - center)).sum(-1)
    c = (eye - center) @ (eye - center) - radius**2
    under = b * b - c
    ball = np.where(under > 0.0, -b - np.sqrt(np.maximum(under, 0.0)), np.inf)
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 2] < 0.0, -eye[2] / rays[..., 2], np.inf)
    depth = np.minimum(ball, floor)
    there = depth < 40.0
    on_ball = there & (ball < floor)
    depth = np.where(there, depth, 0.0)
    position = np.where(there[..., None], eye + depth[..., None] * rays, 0.0)
    normal = np.where(on_ball[..., None], (position - center) / radius, [0.0, 0.0, 1.0])
    normal = np.where(there[..., None], normal, 0.0)
    squares = ((np.floor(position[..., 0]) + np.floor(position[..., 1])) % 2)[..., None]
    paint = np.where(on_ball[..., None], [0.2, 0.3, 0.7], 0.2 + 0.5 * squares * np.ones(3))
    paint = np.where(there[..., None], paint, 0.0)
    gloss = np.where(there[..., None], np.where(on_ball[..., None], 0.3, 0.04), 0.0) * np.ones(3)
    roughness = np.where(there, np.where(on_ball, 0.2, 0.5), 0.0)
    rng = np.random.default_rng(7)
    light = 0.3 + np.maximum(normal @ np.array([0.4, -0.5, 0.77]), 0.0)
    noise = rng.gamma(4.0, 0.25, (2, HEIGHT, WIDTH, 1))
    diffuse, specular = paint * light[..., None] * noise[0], gloss * (0.5 + light[..., None]) * noise[1]
    emission = np.where(there[..., None], 0.0, [0.4, 0.5, 0.7])
    images = (position, normal, depth, paint, gloss, roughness, diffuse, specular, emission)
    return Scene(*(image.astype(np.float32) for image in images))


@dataclass
class Written:
    """What a renderer's file of the scene holds, and what must be found in it."""

    preset: str
    channels: dict[str, np.ndarray]
    attributes: dict[str, Any] = field(default_factory=dict)
    found: tuple[str, ...] = ()
    """Of ``camera``, ``position``, ``depth``, ``alpha``, ``layers`` and ``spp``."""

    def leave_out(self, *words: str) -> "Written":
        """Remove the channels whose names have one of some words in them; return the file."""
        for key in [key for key in self.channels if any(word in key for word in words)]:
            del self.channels[key]
        return self


def name(head: str, image: np.ndarray, letters: str = "RGB") -> dict[str, np.ndarray]:
    """Return an image as channels."""
    dot = "." if head else ""
    planes = image[..., None] if image.ndim == 2 else image
    return {f"{head}{dot}{letter}": planes[..., k].astype(np.float32) for k, letter in enumerate(letters)}


def to_camera(vectors: np.ndarray, *, back: bool) -> np.ndarray:
    axes = np.stack([CAMERA.right, CAMERA.up, (-1.0 if back else 1.0) * CAMERA.forward])
    return vectors @ axes.T


def make_matrices(*, left_handed: bool = False) -> dict[str, np.ndarray]:
    """Return worldToCamera and worldToNDC, for row vectors; of a left-handed world, x mirrored, z away."""
    turn = np.array([-1.0, 1.0, 1.0]) if left_handed else np.ones(3)
    sign = 1.0 if left_handed else -1.0
    eye = turn * CAMERA.position
    axes = turn * np.stack([CAMERA.right, CAMERA.up, sign * CAMERA.forward])
    to_camera_matrix = np.eye(4)
    to_camera_matrix[:3, :3], to_camera_matrix[3, :3] = axes.T, -axes @ eye
    half_width, half_height = CAMERA.get_half_extent(WIDTH, HEIGHT)
    lens = np.zeros((4, 4))
    lens[0, 0], lens[1, 1] = 1.0 / half_width, 1.0 / half_height
    lens[2, 2], lens[2, 3], lens[3, 2] = sign * 1.0002, sign, -0.1
    return {"worldToCamera": to_camera_matrix.astype("f4"), "worldToNDC": (to_camera_matrix @ lens).astype("f4")}


def write_cycles(s: Scene) -> Written:
    planar = np.where(s.surface, s.depth * (CAMERA.make_ray_directions(WIDTH, HEIGHT) @ CAMERA.forward), 1e10)
    layer = "View Layer.001"
    images = {
        "Combined": s.color, "Normal": s.normal, "Position": s.position, "DiffCol": s.diffuse_albedo,
        "GlossCol": s.specular_albedo, "Emit": 0.0 * s.color, "Env": s.emission,
    }  # fmt: skip
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = {"Diff": s.diffuse / s.diffuse_albedo, "Gloss": s.specular / s.specular_albedo}
    light = {kind: np.nan_to_num(share) for kind, share in shares.items()}
    for kind, image in light.items():
        images |= {f"{kind}Dir": 0.25 * image, f"{kind}Ind": 0.75 * image}
    channels: dict[str, np.ndarray] = {}
    for pass_name, image in images.items():
        letters = "XYZ" if pass_name in ("Normal", "Position") else "RGB"
        channels |= name(f"{layer}.{pass_name}", image, letters)
    mean = (s.diffuse_albedo.mean(-1) + s.roughness * s.specular_albedo.mean(-1)) / np.maximum(
        (s.diffuse_albedo + s.specular_albedo).mean(-1), 1e-6
    )
    channels |= name(f"{layer}.Depth", planar, "Z") | name(f"{layer}.Denoising Roughness", mean, "X")
    attributes = {"cycles.View Layer.001.samples": "16"}
    return Written("cycles", channels, attributes, ("camera", "position", "depth", "alpha", "layers", "spp"))


def write_arnold(s: Scene) -> Written:
    channels = name("", s.color) | name("N", s.normal, "XYZ") | name("P", s.position, "XYZ") | name("Z", s.depth, " ")
    channels["Z"] = channels.pop("Z. ")
    channels |= name("diffuse_albedo", s.diffuse_albedo) | name("specular_albedo", s.specular_albedo)
    channels |= name("diffuse", s.diffuse) | name("specular", s.specular) | name("specular_roughness", s.roughness, "R")
    attributes = {"arnold/AA_samples": 4, **make_matrices()}
    return Written("arnold", channels, attributes, ("camera", "position", "depth", "alpha", "layers", "spp"))


def write_vray(s: Scene) -> Written:
    channels = name("", s.color) | name("bump_normals", to_camera(s.normal, back=True), "XYZ")
    channels |= name("diffuse", s.diffuse_albedo) | name("reflectionFilter", s.specular_albedo)
    channels |= name("lighting", 0.5 * s.diffuse) | name("GI", 0.5 * s.diffuse) | name("selfIllum", s.emission)
    channels |= name("reflect", 0.5 * s.specular) | name("specular", 0.5 * s.specular)
    channels |= name("worldPositions", s.position, "XYZ") | name("materialReflectGlossiness", 1.0 - s.roughness, "R")
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([CAMERA.right, CAMERA.up, -CAMERA.forward])
    matrix[3, :3] = CAMERA.position
    angle = np.rad2deg(2.0 * np.arctan(CAMERA.get_half_extent(WIDTH, HEIGHT)[0]))
    attributes = {"vrayInfo/camera": "c", "cameraTransform": matrix.astype("f4"), "cameraFov": float(angle)}
    return Written("vray", channels, attributes, ("camera", "position", "alpha", "layers"))


def write_renderman(s: Scene) -> Written:
    planar = s.depth * (CAMERA.make_ray_directions(WIDTH, HEIGHT) @ CAMERA.forward)
    channels = name("Ci", s.color, "rgb") | name("normal", to_camera(s.normal, back=False), "xyz")
    channels |= (
        name("__Pworld", s.position, "xyz") | name("zfiltered", planar, "r") | name("mse", 0.01 * s.color, "rgb")
    )
    channels |= name("albedo", s.diffuse_albedo + s.specular_albedo, "rgb")
    channels |= name("diffuse", s.diffuse, "rgb") | name("specular", s.specular, "rgb")
    return Written("renderman", channels, {"rman_version": "26"}, ("camera", "position", "depth", "layers"))


def write_karma(s: Scene) -> Written:
    channels = name("C", s.color, "rgb") | name("N", s.normal, "xyz") | name("P", s.position, "xyz")
    channels |= name("albedo", s.diffuse_albedo + s.specular_albedo, "rgb") | name("roughness", s.roughness, "r")
    channels |= name("combineddiffuse", s.diffuse, "rgb") | name("combinedglossyreflection", s.specular, "rgb")
    channels |= name("combinedemission", s.emission, "rgb")
    return Written("karma", channels, {"husk:render_time": "1"}, ("camera", "position", "alpha", "layers"))


def write_redshift(s: Scene) -> Written:
    channels = name("", s.color) | name("BumpNormals", s.normal) | name("P", s.position)
    channels |= name("DiffuseFilter", s.diffuse_albedo) | name("ReflectionsFilter", s.specular_albedo)
    channels |= name("DiffuseLighting", 0.6 * s.diffuse) | name("GI", 0.4 * s.diffuse)
    channels |= name("SpecularLighting", 0.6 * s.specular) | name("Reflections", 0.4 * s.specular)
    return Written("redshift", channels, {}, ("camera", "position", "layers"))


def write_corona(s: Scene) -> Written:
    channels = name("CShading_Beauty", s.color) | name("CGeometry_NormalsShading", s.normal)
    channels |= name("CGeometry_WorldPosition", s.position) | name("CShading_SourceColor", s.diffuse_albedo)
    channels |= name("CShading_DirectDiffuse", 0.5 * s.diffuse) | name("CShading_IndirectDiffuse", 0.5 * s.diffuse)
    channels |= name("CShading_Reflect", s.specular) | name("CShading_SelfIllumination", s.emission)
    return Written("corona", channels, {}, ("camera", "position", "layers"))


def write_pbrt(s: Scene) -> Written:
    turn = np.array([-1.0, 1.0, 1.0])
    channels = name("", s.color) | name("Albedo", s.diffuse_albedo) | name("P", turn * s.position, "XYZ")
    channels |= name("N", turn * s.normal, "XYZ") | name("Ns", turn * s.normal, "XYZ")
    channels |= {"dzdx": s.depth, "dzdy": s.depth, **name("Variance", 0.1 * s.color)}
    attributes = {"samplesPerPixel": 8, **make_matrices(left_handed=True)}
    return Written("pbrt", channels, attributes, ("camera", "position", "spp"))


def write_luxcore(s: Scene) -> Written:
    channels = name("RGB", s.color) | name("SHADING_NORMAL", s.normal) | name("POSITION", s.position)
    depth = np.where(s.surface, s.depth, np.inf)
    channels |= name("DEPTH", np.repeat(depth[..., None], 3, -1)) | name("ALBEDO", s.diffuse_albedo)
    channels |= name("DIRECT_DIFFUSE", 0.5 * s.diffuse) | name("INDIRECT_DIFFUSE", 0.5 * s.diffuse)
    channels |= name("DIRECT_GLOSSY", 0.5 * s.specular) | name("INDIRECT_GLOSSY", 0.5 * s.specular)
    channels |= name("EMISSION", s.emission)
    return Written("luxcore", channels, {}, ("camera", "position", "depth", "layers"))


def write_mitsuba(s: Scene) -> Written:
    channels = name("", s.color) | name("image", s.color) | name("sh_normal", s.normal, "XYZ")
    channels |= name("position", s.position, "XYZ") | name("depth", s.depth, "T")
    channels |= name("albedo", s.diffuse_albedo + s.specular_albedo)
    return Written("mitsuba", channels, {"generatedBy": "Mitsuba version 3.6.0"}, ("camera", "position", "depth"))


def write_unreal(s: Scene) -> Written:
    head = "FinalImageMovieRenderQueue_"
    channels = name("", s.color) | name(f"{head}WorldNormal", 0.5 + 0.5 * s.normal)
    channels |= name(f"{head}BaseColor", s.diffuse_albedo) | name(f"{head}Roughness", s.roughness, "R")
    return Written("unreal", channels, {"unreal/version": "5.4"}, ("alpha",))


WRITERS = {
    writer.__name__.removeprefix("write_"): writer
    for writer in (
        write_cycles, write_arnold, write_vray, write_renderman, write_karma, write_redshift, write_corona, write_pbrt,
        write_luxcore, write_mitsuba, write_unreal,
    )
}  # fmt: skip


def write(path: Path, written: Written, *, half: bool = False, part_each: bool = False, packed: bool = True) -> None:
    """Write a file of one part, or of a part for each pass; ``packed`` takes longer and makes it smaller."""
    kind_of_packing = OpenEXR.ZIP_COMPRESSION if packed else OpenEXR.NO_COMPRESSION
    compression = {"compression": kind_of_packing, "type": OpenEXR.scanlineimage}
    header = dict(written.attributes)
    kind = np.float16 if half else np.float32
    channels = {key: np.ascontiguousarray(plane, kind) for key, plane in written.channels.items()}
    if not part_each:
        OpenEXR.File({**header, **compression}, channels).write(str(path))
        return
    parts: dict[str, dict[str, np.ndarray]] = {}
    for key, plane in channels.items():
        head, _, last = key.rpartition(".")
        parts.setdefault(head or ("rgba" if last in "RGBA" else last), {})[last] = plane
    made = [
        OpenEXR.Part({**(header if k == 0 else {}), **compression}, each, part)
        for k, (part, each) in enumerate(parts.items())
    ]
    OpenEXR.File(made).write(str(path))


def write_denoised(path: Path, *, part_each: bool = False) -> dict[str, np.ndarray]:
    """Write a frame of Blender whose own denoiser was on; return the channels."""
    written = write_cycles(make_scene())
    for key in [key for key in written.channels if "Combined" in key]:
        noisy = written.channels[key]
        written.channels[key.replace("Combined", "Noisy Image")] = noisy
        written.channels[key] = np.full_like(noisy, noisy.mean())
    write(path, written, part_each=part_each)
    return written.channels


def read_channels(path: Path) -> dict[str, np.ndarray]:
    """Return the channels of a file of one part by name."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {key: channel.pixels.copy() for key, channel in file.channels().items()}
