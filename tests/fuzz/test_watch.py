"""The watcher notices every way to fail; otherwise nothing that it says is worth anything."""

from collections.abc import Iterator

import pytest

from tests.fuzz import exr_files, fuzzing
from tests.fuzz.strategies import read_seeds
from tests.fuzz.watch import Verdict, Watcher


@pytest.fixture(scope="module")
def watcher() -> Iterator[Watcher]:
    with Watcher("tests.fuzz.failing") as one:
        yield one


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("how", "outcome", "words"),
    [
        ("stages", "opened", ""),
        ("refuse", "refused", "expected a file"),
        ("error", "error", "ZeroDivisionError: by zero"),
        ("warn", "error", "RuntimeWarning"),
        ("garble", "error", "no sentence"),
        ("crash", "crash", "Segmentation fault"),
        ("bomb", "memory", "bytes"),
        ("burst", "error", "MemoryError"),
        ("caught", "memory", "not enough memory"),
        ("oracle", "opened", ""),
        ("hang", "hang", "no answer"),
        ("open", "opened", ""),
    ],
)
def test_every_way_to_fail_is_noticed(watcher: Watcher, how: str, outcome: str, words: str) -> None:
    # The first case of a worker may take long; after it the time is the one that is asked for.
    assert watcher.judge("any", b"open").outcome == "opened"
    verdict = watcher.judge("any", how.encode(), seconds=2.0 if how == "hang" else 60.0)
    assert (verdict.outcome, verdict.is_bad) == (outcome, outcome not in ("opened", "refused"))
    assert words in verdict.told


def test_what_a_file_did_does_not_stick_to_the_next(watcher: Watcher) -> None:
    assert watcher.judge("any", b"bomb").outcome == "memory"
    assert watcher.judge("any", b"open").outcome == "opened"


def test_causes_are_told_apart_by_where_they_are() -> None:
    told = 'Traceback\n  File "/a/b.py", line 3, in x\n  File "/a/c.py", line 9, in y\nValueError: no\n'
    assert Verdict("error", told).signature == "error ValueError c.py:9"
    assert Verdict("hang", "no answer").signature != Verdict("error", told).signature


@pytest.mark.nightly
def test_the_same_seed_makes_the_same_files(monkeypatch: pytest.MonkeyPatch) -> None:
    class Recorder:
        def __init__(self) -> None:
            self.files: list[bytes] = []

        def judge(self, kind: str, data: bytes) -> Verdict:
            self.files.append(data)
            return Verdict("opened")

    runs = [Recorder() for _ in range(3)]
    for run, start in zip(runs, (1, 1, 2), strict=True):
        fuzzing.fuzz("camera_json", run, count=30, start=start)  # type: ignore[arg-type]
    assert runs[0].files == runs[1].files != runs[2].files
    assert len(set(runs[0].files)) > 15


@pytest.mark.sampled(*(f"data{number}" for number in (0, 1, 3, 5, 6, 8, 10, 12, 13, 15, 17, 18, 20, 22)))
@pytest.mark.parametrize("data", read_seeds("exr"))
def test_exr_files_are_put_together_as_they_were(data: bytes) -> None:
    assert exr_files.unpack(data).pack() == data
