"""Shares of images in a mixture, predicted by a small network from features of each pixel."""

from __future__ import annotations

from functools import partial

import numpy as np

from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.engine.here import HERE
from lobewise.filters.mixing import Network
from lobewise.filters.mixing_pass import define_network
from lobewise.filters.planes import C, X, Y
from lobewise.filters.schedules.mixing import schedule_network
from lobewise.frame import FloatArray


def find_shares(seen: FloatArray, network: Network, count: int) -> FloatArray:
    """Return the softmax of a network's outputs at every pixel, shape (height, width, count), in [0, 1].

    Parameters
    ----------
    seen : array, shape (height, width, features)
    network : Network
    count : int
        Outputs of the network, at least 2.

    Raises
    ------
    InputError
        If the network has another number of inputs or outputs.
    """
    network.require_fit(seen.shape[-1], count)
    sizes = seen.shape[-1], *(len(bias) for bias in network.biases)
    arrays = {name: np.ascontiguousarray(each, np.float32) for name, each in network.name_arrays().items()}
    images = {"seen": np.ascontiguousarray(seen, np.float32), **arrays}
    return np.asarray(HERE.kernel(("shares", sizes), partial(make_shares, sizes), images, {})["shares"])


def make_shares(sizes: tuple[int, ...], target: hl.Target) -> Scheduled:
    """Return the kernel, scheduled by rows and vectors."""
    signature = Signature("shares")
    seen = signature.image("seen", "height", "width", sizes[0])
    signature.output("shares", "height", "width", sizes[-1])
    features, out = hl.Func("features"), hl.Func("out")
    features[X, C, Y] = seen[C, hl.clamp(X, 0, seen.dim(1).extent() - 1), Y]
    stages = define_network(signature, features, sizes)
    scores = [stages[-1].func[X, k, Y] for k in range(sizes[-1])]
    total = sum(scores[1:], scores[0])
    out[C, X, Y] = hl.mux(C, [score / total for score in scores])
    lanes = target.natural_vector_size(hl.Float(32))
    column, lane = hl.Var("column"), hl.Var("lane")
    out.bound(C, 0, sizes[-1]).reorder(C, X, Y).unroll(C).split(X, column, lane, lanes, hl.TailStrategy.GuardWithIf)
    out.reorder(C, lane, column, Y).vectorize(lane).parallel(Y).never_partition_all()
    schedule_network(stages, out, column, lanes)
    return Scheduled([out], signature)
