"""Make a scene written for older Mitsuba one that Mitsuba 3 renders as the author meant it."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable
from pathlib import Path

MAX_DEPTH = 16
"""Longest path, in vertices after the camera. The authors ask for 6 to 65."""
SUN_APERTURE_DEGREES = 0.5358
"""What Mitsuba 3 takes for the sun's width; older scenes tell a factor of it."""


def mend_scene(source: Path, target: Path, size: tuple[int, int], without: Iterable[str]) -> None:
    """Write a scene file that Mitsuba 3 loads: another integrator and film, and no plugin that it lacks.

    The version in the file stays: by it Mitsuba renames the parameters of older scenes itself.
    """
    tree = ET.parse(source)
    scene = tree.getroot()
    leave_out(scene, set(without))
    for element in list(scene):
        if element.tag in ("default", "integrator"):
            scene.remove(element)
    scene.insert(0, _make("integrator", "path", ("integer", "max_depth", str(MAX_DEPTH))))
    for sensor in scene.iter("sensor"):
        replace_film(sensor, size)
    for parent in scene.iter():
        for child in parent:
            mend = MENDED.get((child.tag, child.get("type", "")))
            if mend:
                mend(child)
    tree.write(target, encoding="utf-8", xml_declaration=True)


def leave_out(scene: ET.Element, files: set[str]) -> None:
    """Remove the shapes of files that are not at hand; a texture that is not becomes an even grey."""
    for shape in list(scene.findall("shape")):
        if files & {item.get("value") for item in shape.iter("string")}:
            scene.remove(shape)
    for parent in scene.iter():
        for index, child in enumerate(parent):
            if child.tag == "texture" and files & {item.get("value") for item in child.iter("string")}:
                name = child.get("name")
                parent[index] = ET.Element("rgb", {**({"name": name} if name else {}), "value": "0.5, 0.5, 0.5"})


def replace_film(sensor: ET.Element, size: tuple[int, int]) -> None:
    """Give a camera a film of another size, and the plain sampler."""
    for child in list(sensor):
        if child.tag in ("film", "sampler"):
            sensor.remove(child)
    film = _make("film", "hdrfilm", ("integer", "width", str(size[0])), ("integer", "height", str(size[1])))
    film.append(_make("rfilter", "box"))
    sensor.append(film)


def _mend_sky(sky: ET.Element) -> None:
    """Keep the sun where it was: in older scenes up is Y, and the sun's width is a factor."""
    for item in list(sky):
        name = item.get("name")
        if name in ("sunColor", "skyColor"):
            sky.remove(item)
        elif name == "sunRadiusScale":
            item.set("name", "sun_aperture")
            item.set("value", str(SUN_APERTURE_DEGREES * float(item.get("value", "1"))))
    turn = ET.SubElement(sky, "transform", {"name": "to_world"})
    ET.SubElement(turn, "rotate", {"x": "1", "angle": "-90"})


def _mend_rough_diffuse(bsdf: ET.Element) -> None:
    """Take the smooth law: Mitsuba 3 has no Oren-Nayar."""
    bsdf.set("type", "diffuse")
    for item in list(bsdf):
        if item.get("name") in ("alpha", "useFastApprox"):
            bsdf.remove(item)


def _mend_phong(bsdf: ET.Element) -> None:
    """Take a coat as rough as the exponent says, on the same base: alpha is the root of 2 over exponent plus 2."""
    bsdf.set("type", "roughplastic")
    for item in list(bsdf):
        if item.get("name") == "exponent":
            item.tag = "float"
            item.set("name", "alpha")
            item.set("value", str(math.sqrt(2.0 / (float(item.get("value", "30")) + 2.0))))


def _mend_bitmap(texture: ET.Element) -> None:
    """Take the best filter that Mitsuba 3 has; a gamma of 1 is its "raw"."""
    for item in list(texture):
        if item.get("name") == "filterType" and item.get("value") != "nearest":
            item.set("value", "bilinear")
        elif item.get("name") == "gamma" and float(item.get("value", "0")) == 1.0:
            item.tag = "boolean"
            item.set("name", "raw")
            item.set("value", "true")


def _mend_conductor(bsdf: ET.Element) -> None:
    """Leave out what lies outside the metal: it is air in all of these scenes, which Mitsuba 3 takes for granted."""
    for item in list(bsdf):
        if item.get("name") == "extEta":
            bsdf.remove(item)


def _mend_ward(bsdf: ET.Element) -> None:
    """Take a rough metal of the same color: the scene that has the law has no diffuse part in it."""
    bsdf.set("type", "roughconductor")
    for item in list(bsdf):
        if item.get("name") == "diffuseReflectance":
            bsdf.remove(item)
    ET.SubElement(bsdf, "string", {"name": "material", "value": "none"})


MENDED: dict[tuple[str, str], Callable[[ET.Element], None]] = {
    ("emitter", "sunsky"): _mend_sky,
    ("bsdf", "roughdiffuse"): _mend_rough_diffuse,
    ("bsdf", "phong"): _mend_phong,
    ("bsdf", "ward"): _mend_ward,
    ("texture", "bitmap"): _mend_bitmap,
    ("bsdf", "conductor"): _mend_conductor,
    ("bsdf", "roughconductor"): _mend_conductor,
}
"""What turns a plugin that Mitsuba 3 lacks, or has another way, into one that it has."""


def _make(tag: str, kind: str, *items: tuple[str, str, str]) -> ET.Element:
    element = ET.Element(tag, {"type": kind})
    for tag_of_item, name, value in items:
        ET.SubElement(element, tag_of_item, {"name": name, "value": value})
    return element
