"""What is checked of a foreign frame, in the order in which one mistake would hide another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from lobewise.frame import FloatArray
from lobewise.interchange.checks.depths import check_depth_by_normal, check_depth_by_position
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.flips import check_flips
from lobewise.interchange.checks.geometry import find_patches
from lobewise.interchange.checks.guides import check_albedos, check_encoding, check_values
from lobewise.interchange.checks.normals import check_normals, take_assumed
from lobewise.interchange.checks.precision import measure_grain
from lobewise.interchange.checks.roughness import check_range, check_roughness
from lobewise.interchange.placing import Places, derive_normal

if TYPE_CHECKING:
    from lobewise.camera import Camera
    from lobewise.interchange.mapping import ChannelMap, Found

GUIDES = ("normal", "position", "depth", "albedo", "diffuse_albedo", "specular_albedo", "roughness")
LOBES = ("diffuse_albedo", "specular_albedo")

Read = Callable[["Found"], FloatArray]


@dataclass
class Guides:
    """The images of a file as they should have been.

    Parameters
    ----------
    images : mapping of str to array
        By role.
    roles : mapping of str to Found
        What is still to become of them.
    findings : list of Finding
        What was mended or is doubtful.
    """

    images: dict[str, FloatArray]
    roles: dict[str, Found]
    findings: list[Finding] = field(default_factory=list)

    def mend(self, mended: tuple[Mapping[str, FloatArray], list[Finding]]) -> None:
        """Take over what a check returns."""
        self.images |= mended[0]
        self.findings += mended[1]

    def lend(self, read: Read, unchecked: Mapping[str, FloatArray]) -> Read:
        """Return what reads an image of the file: those that were mended as they are now."""
        changed = {
            (found.source.part.index, found.channels): self.images[role]
            for role, found in self.roles.items()
            if self.images[role] is not unchecked[role] and role != "normal"
        }
        return lambda found: (
            changed.get((found.source.part.index, found.channels), read(found)) if changed else read(found)
        )


def check_guides(images: Mapping[str, FloatArray], channels: ChannelMap, read: Read) -> Guides:
    """Return the guides of a file, mended where they are surely not what they are taken for.

    Parameters
    ----------
    images : mapping of str to array
        By role, as in the file.
    channels : ChannelMap
        What they were taken for.
    read : callable
        Gives the pixels of one of the file's images.
    """
    checked = Guides(dict(images), dict(channels.roles))
    labels = {role: found.label for role, found in channels.roles.items()}

    # One albedo for all light serves where no lobe has its own.
    own = any(layer.albedo for layer in channels.layers) or any(role in images for role in LOBES)
    used = [role for role in GUIDES if role in images and not (role == "albedo" and own)]

    def guides() -> dict[str, FloatArray]:
        return {role: checked.images[role] for role in used}

    checked.mend(check_values(guides(), labels))
    checked.mend(check_flips(checked.images["color"], guides(), labels))
    if "normal" in images:
        found = checked.roles["normal"]
        normal, findings = check_encoding(checked.images["normal"], found.label, encoded="encoded" in found.convert)
        checked.findings += findings
        if normal is not None:
            checked.images["normal"] = normal
            words = tuple(word for word in found.convert if word != "encoded")
            checked.roles["normal"] = replace(found, convert=words)
    lent = checked.lend(read, images)
    albedos = {labels[role]: image for role, image in guides().items() if role.endswith("albedo")}
    albedos |= {layer.albedo.label: lent(layer.albedo) for layer in channels.layers if layer.albedo}
    checked.findings += check_albedos(albedos)
    return checked


def check_places(places: Places, guides: Guides, header: Camera | None) -> list[Finding]:
    """Mend what is known of where surfaces are, and return what was found.

    Parameters
    ----------
    places : Places
        The camera and surfaces, in one space if the file is what it was taken for.
    guides : Guides
        The images that they were made of, and what those were taken for.
    header : Camera, optional
        That of the header.
    """
    findings = _check_grain(places, guides)
    camera, roles = places.camera, guides.roles
    if camera is None:
        return findings
    findings += _check_depth(places, camera, roles)
    if places.normal is None or (places.position is None and places.depth is None):
        return findings
    position = places.position
    if position is None:
        assert places.depth is not None
        position = camera.make_positions(places.depth)
    found = roles["normal"]
    scratch = Places(camera, position=position)
    size = int(position.shape[0]), int(position.shape[1])
    places.normal, turned = check_normals(
        places.normal,
        found.label,
        take_assumed(found.convert),
        find_patches(position, camera),
        camera,
        header,
        lambda: derive_normal(scratch, size),
        sure="depth" in roles and not any(one.what == "depth of something else" for one in findings),
    )
    findings += turned
    if turned and places.position is None:
        # Depth is held against normals, which were not right yet.
        findings += _check_depth(places, camera, roles)
    return findings


def _check_grain(places: Places, guides: Guides) -> list[Finding]:
    """Leave positions to camera and depth where those are finer, else tell that they are coarse."""
    if "position" not in guides.images or not (grain := measure_grain(guides.images["position"])).is_coarse:
        return []
    told = (
        f"{guides.roles['position'].label} is stored in {grain.bits}-bit floats, whose steps here are {grain.tell()}: "
    )
    depth = guides.images.get("depth")
    fine = depth is not None and measure_grain(depth, grain.distance).coarseness < 0.5 * grain.coarseness
    if fine and places.camera is not None and places.depth is not None and not places.orthographic:
        places.position = None
        told += f"depth ({guides.roles['depth'].label}) and camera stand for it."
        return [Finding("positions coarse", told, mended=True)]
    told += "store it in 32 bits, or nearer to the origin, or give a depth and a camera."
    return [Finding("positions coarse", told, mended=False)]


def _check_depth(places: Places, camera: Camera, roles: Mapping[str, Found]) -> list[Finding]:
    """Mend the depth by positions, else by normals."""
    if places.depth is None or "depth" not in roles:
        return []
    found = roles["depth"]
    planar = "planar" in found.convert
    findings: list[Finding] = []
    if places.position is not None:
        places.depth, findings = check_depth_by_position(
            places.depth, places.position, camera, found.label, planar=planar
        )
    elif places.normal is not None:
        places.depth, findings = check_depth_by_normal(places.depth, places.normal, camera, found.label, planar=planar)
    return findings


def check_alpha(
    alpha: FloatArray | None,
    guides: Guides,
    channels: ChannelMap,
    second: Found | None,
    read: Read,
    albedos: tuple[FloatArray | None, FloatArray | None],
) -> tuple[FloatArray | None, list[Finding]]:
    """Return microfacet alphas (height, width), and what was found of the roughness that they are made of.

    Parameters
    ----------
    alpha : (height, width), optional
        Alphas if the roughness is what it was taken for.
    guides : Guides
        The images.
    channels : ChannelMap
        What they were taken for.
    second : Found, optional
        As `find_second` returns.
    read : callable
        Gives the pixels of an image of the file.
    albedos : pair of (height, width, 3)
        Diffuse and specular.
    """
    if alpha is None:
        return None, []
    found, raw = channels.roles["roughness"], guides.images["roughness"]
    findings = check_range(raw, found.label)
    if second is None:
        return alpha, findings
    alpha, meant = check_roughness(alpha, raw, found, second, read, albedos)
    return alpha, findings + meant
