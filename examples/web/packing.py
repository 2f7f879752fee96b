"""A short sequence of frames in one small file, which a page in the browser can read.

The file is compressed by gzip. It holds the length of a header (4 bytes, little endian), the header in JSON, and for
each frame the planes of the header's channels. A plane has the high bytes of all its half floats, then their low bytes.
Planes of guides hold differences of the bits along each row, because neighbours are alike. Light has fewer bits than a
half float: its mantissa is rounded, which is small beside its noise.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance

LIGHT_BITS = 5
"""Bits of the mantissa of noisy light: a rounding error of at most 1.6 %, where the noise is 100 % and more."""

HIT_BITS = 6
"""The same for hit distances: an error of 0.8 %, a tenth of what separates two hits."""
LARGEST_NUMBER = 6e4
"""Numbers are clamped to it. Rounding would make an infinite number of the largest half floats."""


@dataclass(frozen=True)
class _Channels:
    """An image of a frame: its number of channels, the bits of its mantissa (10 are all), and whether it is smooth."""

    count: int
    bits: int = 10
    is_smooth: bool = False


CHANNELS = {
    "diffuse": _Channels(3, LIGHT_BITS),
    "specular": _Channels(3, LIGHT_BITS),
    "emission": _Channels(3, 8),
    "diffuse_albedo": _Channels(3, 7),
    "specular_albedo": _Channels(3, 7),
    "normal": _Channels(3, is_smooth=True),
    "alpha": _Channels(1, is_smooth=True),
    "depth": _Channels(1, is_smooth=True),
    "motion": _Channels(2, is_smooth=True),
    "hits": _Channels(1, HIT_BITS),
}
"""The images of a frame, in the order of their planes."""


def round_half(image: FloatArray, bits: int) -> NDArray[np.uint16]:
    """Return the bits of half floats whose mantissa is rounded to ``bits`` bits."""
    image = np.where(np.isinf(image), image, np.clip(image, -LARGEST_NUMBER, LARGEST_NUMBER))
    whole = image.astype(np.float16).view(np.uint16).astype(np.uint32)
    step = 1 << (10 - bits)
    return ((whole + step // 2) // step * step).astype(np.uint16)


def collect_images(frame: Frame) -> dict[str, FloatArray]:
    """Return the images of a frame by the names of `CHANNELS`."""
    guides, radiance = frame.gbuffer, frame.radiance
    assert radiance.diffuse is not None
    assert radiance.specular is not None
    size = frame.height, frame.width
    rest = np.maximum(radiance.color - radiance.diffuse - radiance.specular, 0.0)
    rest = np.where(rest > 1e-3 * radiance.color, rest, 0.0)
    motion = guides.motion if guides.motion is not None else np.zeros((*size, 2), np.float32)
    return {
        "diffuse": radiance.diffuse,
        "specular": radiance.specular,
        "emission": guides.mean_emission if guides.mean_emission is not None else rest,
        "diffuse_albedo": guides.require("diffuse_albedo", "a bundle"),
        "specular_albedo": guides.require("specular_albedo", "a bundle"),
        "normal": guides.require("normal", "a bundle"),
        "alpha": guides.require("alpha_u", "a bundle"),
        "depth": guides.require("depth", "a bundle"),
        "motion": motion,
        "hits": guides.hit_distance if guides.hit_distance is not None else np.zeros(size, np.float32),
    }


def pack_frames(frames: Sequence[Frame]) -> bytes:
    """Return frames as a compressed file. All have cameras, one size, and diffuse and specular light."""
    first = frames[0]
    header = {
        "width": first.width,
        "height": first.height,
        "spp": first.spp,
        "channels": [[name, channel.count, channel.is_smooth] for name, channel in CHANNELS.items()],
        "cameras": [_describe_camera(frame) for frame in frames],
    }
    text = json.dumps(header).encode()
    parts = [len(text).to_bytes(4, "little"), text]
    for frame in frames:
        images = collect_images(frame)
        for name, channel in CHANNELS.items():
            planes = round_half(np.atleast_3d(images[name]), channel.bits)
            for k in range(channel.count):
                plane = planes[..., k]
                if channel.is_smooth:
                    plane = np.diff(plane, axis=1, prepend=np.uint16(0))
                parts += [(plane >> 8).astype(np.uint8).tobytes(), (plane & 255).astype(np.uint8).tobytes()]
    return gzip.compress(b"".join(parts), 9, mtime=0)


def _describe_camera(frame: Frame) -> dict[str, Any]:
    """Return the arguments of a camera, and what follows from them and a page would compute again."""
    camera = frame.require_camera("a bundle")
    return {
        "right": camera.right.tolist(),
        "half_extent": camera.get_half_extent(frame.width, frame.height),
        "position": camera.position.tolist(),
        "forward": camera.forward.tolist(),
        "up": camera.up.tolist(),
        "fov_y": camera.fov_y,
        "fov_x": camera.fov_x,
    }


def read_frames(path: Path) -> list[Frame]:
    """Return the frames of a file of `pack_frames`."""
    data = gzip.decompress(path.read_bytes())
    length = int.from_bytes(data[:4], "little")
    header = json.loads(data[4 : 4 + length])
    height, width = header["height"], header["width"]
    planes = np.frombuffer(data, np.uint8, offset=4 + length).reshape(-1, 2, height, width)
    frames, at = [], 0
    for described in header["cameras"]:
        images: dict[str, FloatArray] = {}
        for name, count, is_smooth in header["channels"]:
            byte_planes = planes[at : at + count].astype(np.uint16)
            bits = byte_planes[:, 0] << 8 | byte_planes[:, 1]
            if is_smooth:
                bits = np.cumsum(bits, axis=2, dtype=np.uint16)
            images[name] = np.moveaxis(bits.view(np.float16), 0, -1).astype(np.float32)
            at += count
        camera = Camera(
            described["position"], described["forward"], described["up"], described["fov_y"], described["fov_x"]
        )
        frames.append(_make_frame(images, camera, header["spp"]))
    return frames


def _make_frame(images: dict[str, FloatArray], camera: Camera, spp: int | None) -> Frame:
    depth = images["depth"][..., 0]
    guides = GBuffer(
        depth=depth,
        position=camera.make_positions(depth),
        normal=images["normal"],
        alpha_u=images["alpha"][..., 0],
        diffuse_albedo=images["diffuse_albedo"],
        specular_albedo=images["specular_albedo"],
        mean_emission=images["emission"],
        motion=images["motion"],
        hit_distance=images["hits"][..., 0],
    )
    diffuse, specular = images["diffuse"], images["specular"]
    color = diffuse + specular + images["emission"]
    return Frame(Radiance(color, diffuse=diffuse, specular=specular), guides, camera, spp=spp)
