"""Fuzz one kind of file by coverage: ``python -m tests.fuzz.guided KIND [SECONDS]``; needs ``pip install atheris``.

atheris keeps files that reach new code and changes them further, beginning with the corpus. The property is that of
`tests.fuzz.readers`: a result or a sentence. The first file that breaks it ends the run and is kept among the
regressions. Nothing limits the process, so that a crash or a hang (60 seconds) ends it too.
"""

import sys
import tempfile
import warnings
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["lobewise"]):
    from lobewise.errors import LobewiseError as LobewiseError
    from tests.fuzz.corpus import CORPUS
    from tests.fuzz.readers import READERS
from tests.fuzz.watch import save_finding

MAX_SECONDS_OF_A_FILE = 60


def main(kind: str, seconds: int) -> None:
    """Fuzz files of a kind for some seconds."""
    reader = READERS[kind]
    warnings.simplefilter("error")
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as kept:
        with atheris.instrument_imports(include=["lobewise"]):
            # What a reader imports when it is first called.
            reader.prepare(Path(folder))
        path = Path(folder) / f"case{reader.ending}"

        def try_one(data: bytes) -> None:
            path.write_bytes(data)
            try:
                reader.read(path, lambda **_: None)
            except Exception:
                print(f"kept as {save_finding(kind, data, reader.ending)}", flush=True)
                raise

        # New files go into the first folder, the corpus is only read.
        folders = [kept, str(CORPUS / kind)]
        limits = [f"-max_total_time={seconds}", f"-timeout={MAX_SECONDS_OF_A_FILE}"]
        atheris.Setup([sys.argv[0], *folders, *limits], try_one)
        atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 600)
