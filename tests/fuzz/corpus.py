"""The seeds of the fuzzing: small files of every kind in ``corpus/``, all made here, none of anybody else's.

``python -m tests.fuzz.corpus`` writes the state of a filter over time anew.
"""

from pathlib import Path

import numpy as np

from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance

CORPUS = Path(__file__).parent / "corpus"
WIDTH, HEIGHT = 5, 4
PROOF = "of a frame"


def make_small_frame() -> Frame:
    """Return a frame of 5x4 pixels with what a history needs."""
    rng = np.random.default_rng(1)
    normal = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    normal[..., 2] = 1.0
    return Frame(
        Radiance(rng.random((HEIGHT, WIDTH, 3)).astype(np.float32)),
        GBuffer(normal=normal, depth=np.full((HEIGHT, WIDTH), 2.0, np.float32)),
        Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 0.7),
        spp=4,
    )


def main() -> None:
    """Write what a filter remembers of a frame."""
    from lobewise.recipes.states import save_state
    from tests.fuzz.readers import Remembering

    active = Remembering()
    active.add(make_small_frame())
    save_state(CORPUS / "checkpoint" / "state.npz", PROOF, active.get_state())


if __name__ == "__main__":
    main()
