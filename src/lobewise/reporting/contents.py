"""A page of everything that lobewise understood of a file: each image as a picture, and every channel by name."""

from __future__ import annotations

import html
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lobewise.display.cards import encode_bytes, thin_out
from lobewise.display.colors import convert_light
from lobewise.display.guides import paint_guide, paint_light
from lobewise.io import FileDescription
from lobewise.io.exr.header import read_chromaticities
from lobewise.io.exr.parsing import read_container
from lobewise.records.frame import Frame, Radiance
from lobewise.reporting.report import fill_page

MEANINGS = {
    "depth": "distance from the camera",
    "position": "where the surface is",
    "normal": "which way the surface faces",
    "tangent": "the direction of brushing",
    "alpha_u": "roughness along the tangent",
    "alpha_v": "roughness across the tangent",
    "lobe_kind": "kind of the reflection",
    "diffuse_albedo": "color of diffuse light",
    "specular_albedo": "color of reflections",
    "hit_distance": "how far away the reflected surface is",
    "hit_position": "where the reflected surface is",
    "mean_normal": "the normal, averaged over the pixel",
    "mean_diffuse_albedo": "color of diffuse light, averaged over the pixel",
    "mean_specular_albedo": "color of reflections, averaged over the pixel",
    "denoiser_albedo": "the renderer's color for denoisers",
    "denoiser_normal": "the renderer's normal for denoisers",
    "mean_emission": "light of lamps and background, averaged over the pixel",
    "coverage": "how much of the pixel its own surface covers",
    "blur_radius": "how far the lens blurs, in pixels",
    "motion": "motion since the frame before: right is red, down is green",
    "reflected_motion": "motion of the reflected surface",
    "material": "number of the fitted material",
}
"""What each image of the G-buffer means to a person."""
ROLES = {"alpha_u": "roughness", "alpha_v": "roughness", "mean_emission": "emission", "coverage": "silhouettes"}
"""Names by which a file's description calls images of the G-buffer, where the names differ."""


def make_contents_page(description: FileDescription, frame: Frame) -> str:
    """Return the page as one HTML text that holds every picture.

    Parameters
    ----------
    description : FileDescription
        The file (`lobewise.interchange.describe_file`).
    frame : Frame
        Its frame.
    """

    def tell_source(name: str) -> str:
        roles = [role for role in description.roles if role.role == name]
        roles = roles or [role for role in description.roles if role.role == ROLES.get(name)]
        ways = dict.fromkeys(role.conversion for role in roles if role.conversion)
        return "; ".join([f"from {', '.join(role.channels for role in roles)}", *ways]) if roles else ""

    primaries = read_chromaticities(read_container(description.path))
    lights = [
        _show(
            name,
            tell_source("color" if name == "image" else name),
            image,
            paint_light(convert_light(thin_out(image), primaries)),
        )
        for name, image in _list_light(frame)
    ]
    guides = [
        _show(name, f"{MEANINGS[name]}\n{tell_source(name)}".strip(), image, paint_guide(name, thin_out(image)))
        for name in frame.gbuffer.names
        for image in [getattr(frame.gbuffer, name)]
    ]
    sections = {"Light": lights, "Guides": guides}
    height, width = frame.shape
    facts = [description.preset, description.version, f"{width}x{height} pixels"]
    facts += [f"{frame.spp} samples per pixel"] if frame.spp else []
    facts += ["camera known" if frame.camera else "camera unknown"]
    notes = "".join(
        f"<li>{html.escape(note)}</li>" for note in (*description.refusals, *description.unusable, *description.notes)
    )
    return fill_page(
        "inspect.html",
        {
            "title": html.escape(description.path),
            "facts": html.escape(", ".join(filter(None, facts))),
            "notes": f'<ul class="notes">{notes}</ul>' if notes else "",
            "sections": "".join(
                f'<h2>{name}</h2><div class="grid">{"".join(shown)}</div>' for name, shown in sections.items() if shown
            ),
            "channels": "".join(_list_channels(description)),
        },
    )


def _list_light(frame: Frame) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Yield the name and image of all light."""
    yield "image", frame.radiance.color
    for name in frame.radiance.names:
        if name != "color":
            yield name, getattr(frame.radiance, name)
    for layer in frame.layers:
        yield f"light: {layer.name}", layer.radiance
    yield from frame.unscattered.items()
    for name, image in frame.also.items():
        yield name, image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=-1)
    halves: dict[str, Radiance | None] = {"half a": frame.half_a, "half b": frame.half_b, "variance": frame.variance}
    for name, half in halves.items():
        if half is not None:
            yield name, half.color


def _show(name: str, text: str, image: NDArray[np.float32], picture: NDArray[np.uint8]) -> str:
    """Return the figure of an image, with its range."""
    finite = image[np.isfinite(image)]
    span = f"{finite.min():.4g} to {finite.max():.4g}" if finite.size else "no finite number"
    lost = 1.0 - finite.size / image.size
    span += f"; {100.0 * lost:.2g} % not finite" if lost else ""
    lines = "".join(f"{html.escape(line)}<br>" for line in text.splitlines())
    return (
        f'<figure><img alt="{html.escape(name)}" src="{encode_bytes(picture)}"><figcaption>'
        f"<b>{html.escape(name)}</b>{lines}{html.escape(span)}</figcaption></figure>"
    )


def _list_channels(description: FileDescription) -> Iterator[str]:
    """Yield a row of the table for every channel."""
    for part in description.parts:
        for channel in part.channels:
            cells = (part.name, channel.name, channel.pixel_type, channel.used_as or "copied as it is")
            yield "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"
