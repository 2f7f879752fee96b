"""The kernel that refines an image: the network, the pyramid of filters, and the tint."""

from __future__ import annotations

from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.pointwise import LARGEST_FLOAT
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import C, X, Y
from lobewise.filters.refinement.convolutions import define_network, measure_levels
from lobewise.filters.refinement.pyramid import define_pyramid
from lobewise.filters.refinement.shape import PLANES, VECTORS, WEIGHTS
from lobewise.filters.schedules.refinement import schedule_refinement


def make_refinement(target: hl.Target) -> Scheduled:
    """Return the kernel."""
    signature = Signature("refinement")
    planes = signature.image("planes", "height", PLANES, "width")
    light = signature.image("light", "height", 2 * COLORS, "width")
    vectors = signature.image("vectors", "height", VECTORS, "width")
    tint = signature.image("tint", "height", "width", COLORS)
    weights = signature.image("weights", WEIGHTS)
    signature.output("refined", "height", "width", COLORS)
    sizes = measure_levels(planes.dim(0).extent(), planes.dim(2).extent())
    network = define_network(planes, weights, sizes)
    pyramid = define_pyramid(network, light, vectors)
    out = hl.Func("refined")
    out[C, X, Y] = hl.min(pyramid.filters[0].out[X, C, Y] * tint[C, X, Y], hl.f32(LARGEST_FLOAT))
    schedule_refinement(network, pyramid, out, target)
    return Scheduled([out], signature)
