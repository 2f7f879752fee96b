"""Which public interiors are rendered, where they are cloned from, and what their repositories say of their origin."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """A repository of scenes at one commit.

    Parameters
    ----------
    name : str
        What ``--clone`` calls it.
    url : str
        Where git clones it from.
    commit : str
        In full: branches move.
    """

    name: str
    url: str
    commit: str


DPPM = Source("dppm-scenes", "https://github.com/hchoi405/dppm-scenes.git", "8fdb2dcb3fe575bb04bc586fded35e81d76787d5")
TCC = Source("TCC-2", "https://github.com/tiagoods/TCC-2.git", "be9686fc82606ba7ff633d1e8e7ccfb910bd49c6")


@dataclass(frozen=True)
class Interior:
    """A scene of a repository.

    Parameters
    ----------
    name : str
        Here.
    source : Source
    folder : str
        In the repository.
    size : tuple of int
        Width and height of the frames: about 36 900 pixels in the shape of the scene's own film.
    origin : str
        Title, author and licence, as the repository's LICENSE.txt tells them.
    file : str
        The scene in that folder.
    without : tuple of str
        Meshes and textures that are left out with all that uses them: the figures were measured without these files.
    """

    name: str
    source: Source
    folder: str
    size: tuple[int, int]
    origin: str
    file: str = "scene.xml"
    without: tuple[str, ...] = ()


WIDE, TALL, SQUARE = (256, 144), (144, 256), (192, 192)
_CC_BY = "CC-BY 3.0"

INTERIORS = {
    each.name: each
    for each in (
        Interior("living-room", DPPM, "scenes/living-room", WIDE, f"The White Room, Jay-Artist, {_CC_BY}"),
        Interior("classroom", DPPM, "scenes/classroom", WIDE, f"Japanese Classroom, NovaZeeke, {_CC_BY}"),
        Interior("dining-room", DPPM, "scenes/dining-room", WIDE, "no licence in the repository"),
        Interior("staircase", DPPM, "scenes/staircase", TALL, f"The Wooden Staircase, Wig42, {_CC_BY}"),
        Interior("veach-lamp", DPPM, "scenes/veach-lamp", WIDE, "no licence in the repository"),
        Interior(
            "living-room-2",
            DPPM,
            "scenes/living-room-2",
            WIDE,
            f"The Grey & White Room, Wig42, {_CC_BY}",
            without=("models/Mesh130.obj",),
        ),
        Interior(
            "bathroom",
            DPPM,
            "scenes/bathroom",
            SQUARE,
            "Contemporary Bathroom, Mareck, CC0",
            without=("models/Mesh206.obj", "models/Mesh263.obj", "models/Mesh381.obj", "textures/rug.png"),
        ),
        Interior(
            "country-kitchen",
            TCC,
            "kitchen",
            WIDE,
            f"Country Kitchen, Jay-Artist, {_CC_BY}",
            file="scene_v3.xml",
            without=tuple(f"models/Mesh{number}.obj" for number in ("054", "090", "145", "273", "275", "294")),
        ),
    )
}
"""All were made public by Benedikt Bitterli, https://benedikt-bitterli.me/resources, or Eric Veach (the lamp)."""
