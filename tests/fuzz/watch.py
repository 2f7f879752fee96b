"""Reads files in a process of its own, so that a crash, a hang or a bomb is a finding and not the end of the tests."""

from __future__ import annotations

import hashlib
import json
import os
import re
import select
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
REGRESSIONS = Path(__file__).parent / "regressions"
MAX_SECONDS = 60.0
"""Of one case. A machine that does other things is ten times as slow; a hang is for ever."""
START_SECONDS = 300.0
"""Of the first case of a kind: libraries are loaded and kernels compiled."""
MAX_BYTES = 10**9
"""Peak memory of the whole process, the libraries included."""


@dataclass(frozen=True)
class Verdict:
    """What became of a case.

    Parameters
    ----------
    outcome : str
        ``opened`` or ``refused``; or what must not be: ``error``, ``crash``, ``hang``, ``memory``.
    told : str
        The sentence of a refusal, or what there is to know of a failure.
    peak : int
        The most memory that the process held, bytes.
    """

    outcome: str
    told: str = ""
    peak: int = 0

    @property
    def is_bad(self) -> bool:
        """Whether this must not be."""
        return self.outcome not in ("opened", "refused")

    @property
    def signature(self) -> str:
        """What findings of one cause have in common: of an error its type, and its innermost place in lobewise."""
        ours = re.findall(r'File "[^"]*/src/lobewise/([^"]+)", line (\d+)', self.told)
        places = ours or re.findall(r'File "[^"]*?([^/"]+)", line (\d+)', self.told)
        kind = self.told.strip().rpartition("\n")[2].partition(":")[0][:60]
        return f"{self.outcome} {kind} {':'.join(places[-1]) if places else ''}".strip()


class Watcher:
    """A worker and the clock beside it; after a crash or a hang there is another worker."""

    def __init__(self, readers: str = "tests.fuzz.readers") -> None:
        """``readers`` is the module with the table of them."""
        self._readers = readers
        self._process: subprocess.Popen[bytes] | None = None
        self._ready: set[str] = set()
        self._received = b""
        self._log = tempfile.NamedTemporaryFile(suffix=".log")  # noqa: SIM115  # closed with the watcher

    def __enter__(self) -> Watcher:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._log.close()

    def judge(self, kind: str, data: bytes, *, seconds: float = MAX_SECONDS) -> Verdict:
        """Return what becomes of a file of a kind."""
        process = self._start()
        limit = seconds if kind in self._ready else START_SECONDS
        stage = "ours"
        try:
            process.stdin.write(json.dumps({"kind": kind, "size": len(data)}).encode() + b"\n" + data)
            process.stdin.flush()
            until = time.monotonic() + limit
            while True:
                answer = self._receive(process, until)
                if "stage" not in answer:
                    break
                stage = answer["stage"]
        except TimeoutError:
            self._end()
            return Verdict("hang", f"no answer in {limit:g} s") if stage == "ours" else Verdict("opened")
        except (BrokenPipeError, EOFError):
            code = process.wait()
            self._end()
            log = Path(self._log.name).read_text("utf-8", "replace")
            # What OpenEXR itself does with a file that lobewise has read is not lobewise's.
            return Verdict("crash", f"exit code {code}\n{log}") if stage == "ours" else Verdict("opened")
        self._ready.add(kind)
        verdict = Verdict(answer["outcome"], answer["told"], answer["peak"])
        if verdict.outcome in ("opened", "refused") and verdict.peak > MAX_BYTES:
            return Verdict("memory", f"{verdict.peak} bytes; {verdict.told}", verdict.peak)
        if "not enough memory" in verdict.told:
            return Verdict("memory", verdict.told, verdict.peak)
        return verdict

    def _start(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            command = [sys.executable, "-m", "tests.fuzz.worker", self._log.name, self._readers]
            self._process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            self._ready.clear()
            self._received = b""
        return self._process

    def _receive(self, process: subprocess.Popen[bytes], until: float) -> dict[str, Any]:
        while b"\n" not in self._received:
            if not select.select([process.stdout], [], [], max(until - time.monotonic(), 0.0))[0]:
                raise TimeoutError
            more = os.read(process.stdout.fileno(), 1 << 16)
            if not more:
                raise EOFError
            self._received += more
        line, _, self._received = self._received.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    try:
                        stream.close()
                    except BrokenPipeError:
                        continue
            self._process = None


def save_finding(kind: str, data: bytes, ending: str) -> Path:
    """Keep a file that failed among the regressions, which every run of the tests reads again."""
    folder = REGRESSIONS / kind
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{hashlib.sha256(data).hexdigest()[:12]}{ending}"
    path.write_bytes(data)
    return path
