"""Makes ``benchmarks/frames/sample.exr`` from the frame of the repository: ``python -m benchmarks.pictures.sample``.

All but a small part is black, so that the file is small; size and camera are those of the whole frame.
"""

from dataclasses import fields, replace
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import SAMPLE, SHOWROOM

ROWS, COLUMNS = slice(256, 320), slice(304, 400)
"""Part of the frame: spheres and floor of many roughnesses, and some pixels without a specular lobe."""


def blacken_outside(images: Any) -> Any:
    """Return images that are 0 outside the part."""
    changed = {}
    for item in fields(images):
        image = getattr(images, item.name)
        if image is not None:
            changed[item.name] = np.zeros_like(image)
            changed[item.name][ROWS, COLUMNS] = image[ROWS, COLUMNS]
    return replace(images, **changed)


def main() -> None:
    """Write the file."""
    frame = lobewise.read_frame(SHOWROOM)
    part = frame.with_changes(
        radiance=blacken_outside(frame.radiance),
        gbuffer=blacken_outside(frame.gbuffer),
        half_a=None,
        half_b=None,
        variance=None,
    )
    lobewise.write_frame(SAMPLE, part)


if __name__ == "__main__":
    main()
