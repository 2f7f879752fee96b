"""Every seed opens, and every file that ever failed is read or refused."""

from collections.abc import Iterator

import pytest

from tests.fuzz.corpus import CORPUS
from tests.fuzz.readers import READERS, can_read
from tests.fuzz.watch import REGRESSIONS, Watcher


@pytest.fixture(scope="module")
def watcher() -> Iterator[Watcher]:
    with Watcher() as one:
        yield one


@pytest.mark.parametrize("kind", READERS)
def test_every_seed_opens_and_nothing_that_failed_does_again(watcher: Watcher, kind: str) -> None:
    if not can_read(kind):
        pytest.skip(f"what {kind} needs is not installed")
    seeds = sorted((CORPUS / kind).iterdir())
    assert seeds
    for path in seeds:
        verdict = watcher.judge(kind, path.read_bytes())
        expected = "refused" if path.stem.startswith("short") else "opened"
        assert verdict.outcome == expected, f"{path}: {verdict.told}"
    folder = REGRESSIONS / kind
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        verdict = watcher.judge(kind, path.read_bytes())
        assert not verdict.is_bad, f"{path}: {verdict.outcome}\n{verdict.told}"


def test_the_corpus_is_small() -> None:
    sizes = [path.stat().st_size for path in CORPUS.rglob("*") if path.is_file()]
    assert sum(sizes) < 200_000
    assert {folder.name for folder in CORPUS.iterdir()} == set(READERS)
