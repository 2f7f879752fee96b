"""The seeds of the fuzzing: small files of every kind in ``corpus/``, all made here, none of anybody else's.

``python -m tests.fuzz.corpus`` writes the checkpoint anew, whose content is that of the filter's state.
"""

import shutil
import tempfile
from pathlib import Path

import numpy as np

from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance

CORPUS = Path(__file__).parent / "corpus"
WIDTH, HEIGHT = 5, 4


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
    """Write what a sequence that was interrupted after its first frame leaves."""
    from tests.fuzz.readers import go_on

    with tempfile.TemporaryDirectory() as work:
        try:
            go_on(Path(work) / "state.npz", stop=True)
        except KeyboardInterrupt:
            shutil.copy(Path(work) / "state.npz", CORPUS / "checkpoint" / "state.npz")


if __name__ == "__main__":
    main()
