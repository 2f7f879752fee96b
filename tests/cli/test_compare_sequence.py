"""`lobewise compare` of sequences: means, flicker and ghosting against the library, frame by frame."""

import gc
import json
import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.comparing import _compare_sequences
from lobewise.cli.program import run
from lobewise.io import write_frame, write_image, write_sparse_frame
from lobewise.metrics import METRICS, evaluate, flicker, rel_mse
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import make_sparse
from tests.cli.lines import fail

HEIGHT, WIDTH = 12, 20
STEP = 2
NUMBERS = (1, 2, 3, 4)
CAMERA = Camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 0.6)


def mark_card(number):
    """Return the pixels that show a card in front of a wall: it moves right by STEP pixels per frame."""
    card = np.zeros((HEIGHT, WIDTH), dtype=bool)
    card[3:8, STEP * number : STEP * number + 6] = True
    return card


def make_guides(number, steps=1):
    """Return the guides of a frame; the card moved ``steps`` times STEP pixels since the frame before."""
    card = mark_card(number)
    motion = np.zeros((HEIGHT, WIDTH, 2))
    motion[card, 0] = -steps * STEP
    return GBuffer(depth=np.where(card, 2.0, 5.0), motion=motion)


@pytest.fixture
def films(rng, tmp_path, monkeypatch):
    """Write a reference, two results and the guides ``g`` to the working folder; return the images."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    films = {"r": [], "a": [], "b": []}
    for number in NUMBERS:
        reference = np.where(mark_card(number)[..., None], 0.8, 0.2) * rng.uniform(0.9, 1.1, (HEIGHT, WIDTH, 3))
        attempts = (reference + rng.normal(0.0, 0.1, reference.shape), reference * 1.1)
        for name, image in zip("rab", (reference, *attempts), strict=True):
            films[name].append(image.astype(np.float32))
            write_image(f"{name}.{number:04d}.exr", image)
        write_frame(f"g.{number:04d}.exr", Frame(Radiance(reference), make_guides(number), camera=CAMERA))
    return films


def compare(*words):
    """Run the verb and return its figures."""
    assert run(["compare", *words, "--json", "out.json"]) == 0
    with open("out.json") as stream:
        return json.load(stream)


def test_figures_agree_with_the_library(films, capsys):
    found = compare("a.####.exr", "b.%04d.exr", "-r", "r.####.exr", "--guides", "g.####.exr")
    assert (found["reference"], found["guides"], found["frames"]) == ("r.####.exr", "g.####.exr", list(NUMBERS))
    out, err = capsys.readouterr()
    assert err == ""
    assert "against r.####.exr, 4 frames" in out
    assert [row["path"] for row in found["images"]] == ["a.####.exr", "b.%04d.exr"]
    for row, name in zip(found["images"], "ab", strict=True):
        each = [evaluate(image, right) for image, right in zip(films[name], films["r"], strict=True)]
        for metric in METRICS:
            assert [frame[metric] for frame in row["frames"]] == pytest.approx([one[metric] for one in each])
            assert row[metric] == pytest.approx(np.mean([one[metric] for one in each]))
        assert [frame["number"] for frame in row["frames"]] == list(NUMBERS)
        steps = [flicker(films[name][k - 1 : k + 1], films["r"][k - 1 : k + 1]) for k in (1, 2, 3)]
        assert [frame["flicker"] for frame in row["frames"]] == [None, *(pytest.approx(step) for step in steps)]
        assert row["flicker"] == pytest.approx(flicker(films[name], films["r"]))
        # The pixels that the card has uncovered since the frame before.
        bare = [mark_card(number - 1) & ~mark_card(number) for number in NUMBERS[1:]]
        assert all(mask.sum() == 5 * STEP for mask in bare)
        ghosts = [rel_mse(a, r, mask) for a, r, mask in zip(films[name][1:], films["r"][1:], bare, strict=True)]
        assert [frame["ghosting"] for frame in row["frames"]] == [None, *(pytest.approx(one) for one in ghosts)]
        assert row["ghosting"] == pytest.approx(np.mean(ghosts))
        for metric in (*METRICS, "flicker", "ghosting"):
            assert f"{row[metric]:.4g}" in out


def test_ghosting_counts_pixels_not_frames(films):
    # The card rests from 2 to 3, and then comes two steps at once.
    for number, card, steps in ((3, 2, 0), (4, 4, 2)):
        frame = Frame(Radiance(films["r"][0]), make_guides(card, steps), camera=CAMERA)
        write_frame(f"g.{number:04d}.exr", frame)
    row = compare("a.####.exr", "-r", "r.####.exr", "--guides", "g.####.exr")["images"][0]
    each = [frame["ghosting"] for frame in row["frames"]]
    masks = [mark_card(1) & ~mark_card(2), None, mark_card(2) & ~mark_card(4)]
    assert masks[2].sum() == 2 * masks[0].sum()
    assert each[3] == pytest.approx(rel_mse(films["a"][3], films["r"][3], masks[2]), rel=1e-6)
    assert each[2] is None
    assert row["ghosting"] == pytest.approx((each[1] + 2.0 * each[3]) / 3.0)


def test_the_reference_guides_if_it_can(films, capsys):
    with_guides = compare("a.####.exr", "-r", "g.####.exr")
    assert with_guides["guides"] == "g.####.exr"
    assert with_guides["images"][0]["ghosting"] > 0.0
    without = compare("a.####.exr", "-r", "r.####.exr")
    assert without["guides"] is None
    assert without["images"][0]["ghosting"] is None
    assert re.search(r"\bnone\b", capsys.readouterr().out)


def test_guides_may_be_shaded_sparsely(films):
    whole = compare("a.####.exr", "-r", "r.####.exr", "--guides", "g.####.exr")
    for number in NUMBERS:
        frame = Frame(Radiance(films["r"][0]), make_guides(number), camera=CAMERA)
        write_sparse_frame(f"s.{number:04d}.exr", make_sparse(frame, 4, (1, 1)))
    sparse = compare("a.####.exr", "-r", "r.####.exr", "--guides", "s.####.exr")
    assert sparse["images"][0]["ghosting"] == whole["images"][0]["ghosting"]


def test_a_missing_number_is_a_cut(films, tmp_path):
    for name in "arg":
        (tmp_path / f"{name}.0003.exr").unlink()
    found = compare("a.####.exr", "-r", "r.####.exr", "--guides", "g.####.exr")
    assert found["frames"] == [1, 2, 4]
    row = found["images"][0]
    assert [frame["flicker"] is None for frame in row["frames"]] == [True, False, True]
    assert [frame["ghosting"] is None for frame in row["frames"]] == [True, False, True]
    assert row["flicker"] == pytest.approx(flicker(films["a"][:2], films["r"][:2]))


def test_one_frame_cannot_flicker(films, tmp_path, capsys):
    write_image("one.7.exr", films["a"][0])
    write_image("right.7.exr", films["r"][0])
    row = compare("one.#.exr", "-r", "right.#.exr")["images"][0]
    assert (row["flicker"], row["ghosting"]) == (None, None)
    assert row["rel_mse"] == pytest.approx(rel_mse(films["a"][0], films["r"][0]))
    assert "right.#.exr, 1 frame\n" in re.sub(" +\n", "\n", capsys.readouterr().out)


def test_the_best_stands_out_where_there_is_one(films, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    rows = compare("a.####.exr", "b.####.exr", "-r", "r.####.exr")["images"]
    bold = set(re.findall(r"\x1b\[1m *([0-9.]+|none)\x1b\[0m", capsys.readouterr().out))
    best = {name: (max if name == "psnr" else min)(row[name] for row in rows) for name in (*METRICS, "flicker")}
    assert bold == {f"{value:.4g}" for value in best.values()}


@pytest.mark.nightly
def test_memory_does_not_grow_with_the_length(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Large enough that what the garbage collector happens to leave (some ten kilobytes) is far below one image.
    frame = Frame(Radiance(np.ones((240, 320, 3))), GBuffer(depth=np.ones((240, 320))), camera=CAMERA)

    def measure(count):
        for number in range(count):
            write_frame(f"w.{number}.exr", frame)
        gc.collect()
        tracemalloc.start()
        try:
            found = _compare_sequences([Path("w.#.exr")], Path("w.#.exr"), None, ["mse"])
            assert len(found["frames"]) == count
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    measure(3)  # modules are loaded on first use and stay
    growth = -measure(3) + measure(9)
    # The figures of a frame stay in memory, a few kilobytes with its path.
    assert growth < 0.5 * frame.radiance.color.nbytes


class TestMistakes:
    def test_numbers_that_do_not_match(self, films, tmp_path, capsys):
        (tmp_path / "a.0003.exr").rename("a.0009.exr")
        fail(capsys, "compare", "a.####.exr", "-r", "r.####.exr", what="sequence 'a.####.exr'", got="no 'a.0003.exr'")
        (tmp_path / "b.0004.exr").rename("b.0005.exr")
        write_image("b.0004.exr", films["b"][3])
        fail(capsys, "compare", "b.####.exr", "-r", "r.####.exr", got="'b.0005.exr' as well")

    def test_guides_may_have_more_frames_but_not_fewer(self, films, tmp_path, capsys):
        (tmp_path / "g.0005.exr").write_bytes((tmp_path / "g.0004.exr").read_bytes())
        assert compare("a.####.exr", "-r", "r.####.exr", "--guides", "g.####.exr")["frames"] == list(NUMBERS)
        (tmp_path / "g.0002.exr").unlink()
        fail(capsys, "compare", "a.####.exr", "-r", "r.####.exr", "--guides", "g.####.exr", got="no 'g.0002.exr'")

    def test_nothing_there(self, films, capsys):
        fail(capsys, "compare", "a.###.exr", "-r", "r.####.exr", action="did you mean 'a.####.exr'?")

    def test_guides_that_do_not_tell(self, films, capsys):
        line = ["compare", "a.####.exr", "-r", "r.####.exr", "--guides", "b.####.exr"]
        fail(capsys, *line, what="guides 'b.0001.exr'", got="neither position nor depth")
        for number in NUMBERS:
            write_frame(f"b.{number:04d}.exr", Frame(Radiance(films["b"][0]), make_guides(1)))
        fail(capsys, *line, what="guides 'b.0001.exr'", got="no camera")

    def test_sizes(self, films, capsys):
        small = Frame(Radiance(np.ones((4, 5, 3))), GBuffer(depth=np.ones((4, 5))), camera=CAMERA)
        for number in NUMBERS:
            write_frame(f"g.{number:04d}.exr", small)
        line = ["compare", "a.####.exr", "-r", "r.####.exr", "--guides", "g.####.exr"]
        fail(capsys, *line, what="guides", got="5x4", holder="input 'g.0001.exr'")
        fail(capsys, "compare", "a.####.exr", "-r", "g.####.exr", what="image", holder="input 'a.0001.exr'")

    def test_bad_pixels_are_blamed_on_their_file(self, films, capsys):
        films["a"][2][3, 4] = np.nan
        write_image("a.0003.exr", films["a"][2])
        fail(capsys, "compare", "a.####.exr", "-r", "r.####.exr", what="image", holder="input 'a.0003.exr'")
        write_image("r.0002.exr", films["a"][2])
        fail(capsys, "compare", "a.####.exr", "-r", "r.####.exr", what="reference", holder="input 'r.0002.exr'")
