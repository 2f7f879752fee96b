"""Running a filter over numbered files: every frame, in order, and the same files however often it was stopped."""

import os
import pickle
import tracemalloc
import zipfile

import numpy as np
import pytest

import lobewise
from lobewise.errors import FileError, InputError
from lobewise.io.sequence import FramePattern
from lobewise.recipes.sequence import filter_sequence, name_checkpoint
from tests.mistakes import refuses

NUMBERS = (1, 2, 3, 4, 7, 8, 9)
PATTERN, OUTPUT, KEPT = "in.####.npy", "out.####.npy", "out.lobewise-history.npz"


class Running:
    """A fake filter: the mean of the frames since the last cut, with an odd rounding that only its state can repeat."""

    def __init__(self):
        self.total, self.count = np.zeros((2, 3)), 0
        self.seen = []

    def add(self, frame, *, cut=False):
        if cut:
            self.total, self.count = np.zeros_like(frame), 0
        self.total, self.count = self.total * 0.9 + frame, self.count + 1
        self.seen.append((float(frame[0, 0]), cut))
        return self.total / self.count

    def get_state(self):
        return {"total": self.total, "count": np.int64(self.count), "file": np.array("a name that savez knows")}

    def set_state(self, state):
        self.total, self.count = state["total"], int(state["count"])


def save(path, result, _frame, _source):
    np.save(path, result)


@pytest.fixture
def folder(rng, tmp_path, monkeypatch):
    """Return a folder with seven frames, two numbers missing among them, and make it the current one."""
    monkeypatch.chdir(tmp_path)
    for number in NUMBERS:
        frame = rng.random((2, 3))
        frame[0, 0] = number
        np.save(f"in.{number:04d}.npy", frame)
    return tmp_path


def run(make=Running, *, fail_at=None, fingerprint="beta 1", seconds=0.0, **options):
    """Run over the folder; reading fails at the number ``fail_at``."""

    def read(path):
        if fail_at is not None and path.name == f"in.{fail_at:04d}.npy":
            raise FileError("the disk is full")
        return np.load(path)

    options = {"read": read, "write": save, **options}
    return filter_sequence(PATTERN, OUTPUT, make, fingerprint=fingerprint, checkpoint_seconds=seconds, **options)


def list_outputs(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("out.*.npy"))}


@pytest.fixture
def whole(folder):
    """Return the outputs of a run that is not stopped."""
    run()
    outputs = list_outputs(folder)
    for name in outputs:
        os.remove(name)
    return outputs


def stop(at, **options):
    with refuses(FileError):
        run(fail_at=at, **options)


class TestEveryFrame:
    def test_in_order_neither_first_nor_last_is_dropped(self, folder):
        running, told = Running(), []
        done = run(lambda: running, progress=told.append)
        assert (done.frames, done.written, done.resumed_after, done.note) == (7, 7, None, "")
        assert [number for number, _ in running.seen] == list(NUMBERS)
        assert [number for number, cut in running.seen if cut] == [1, 7]
        assert list(list_outputs(folder)) == [f"out.{number:04d}.npy" for number in NUMBERS]
        np.testing.assert_array_equal(np.load("out.0009.npy"), done.last)
        frames = {number: np.load(f"in.{number:04d}.npy") for number in NUMBERS}
        np.testing.assert_array_equal(np.load("out.0001.npy"), frames[1])
        np.testing.assert_allclose(np.load("out.0008.npy"), (0.9 * frames[7] + frames[8]) / 2.0, rtol=1e-15)
        begun = [each for each in told if (each.stage, each.detail) == ("filtering", "reading")]
        assert [(each.frame, each.done, each.frames) for each in begun] == [
            (f"in.{number:04d}.npy", count, 7) for count, number in enumerate(NUMBERS)
        ]
        np.testing.assert_allclose([each.share for each in begun], np.arange(7) / 7)
        assert (told[-1].stage, told[-1].share, told[-1].done) == ("done", 1.0, 7)
        assert not (folder / KEPT).exists()

    def test_writing_is_told_everything(self, folder):
        written = []
        run(write=lambda *words: written.append(words))
        for number, (path, result, frame, source) in zip(NUMBERS, written, strict=True):
            assert (path.name, source.name) == (f"out.{number:04d}.npy", f"in.{number:04d}.npy")
            assert frame[0, 0] == number
            assert result.shape == frame.shape

    def test_patterns_may_be_parsed_already(self, folder):
        patterns = FramePattern.parse(PATTERN), FramePattern.parse("b%d.npy")
        done = filter_sequence(*patterns, Running, read=np.load, write=save, fingerprint="")
        assert done.frames == 7
        assert (folder / "b9.npy").exists()

    def test_memory_does_not_grow_with_the_length(self, folder, rng):
        sizes = []

        def make_wide(_path):
            return rng.random((100, 100))

        def measure(*_words):
            sizes.append(tracemalloc.get_traced_memory()[0])

        tracemalloc.start()
        try:
            run(read=make_wide, write=lambda *_words: None, progress=measure)
        finally:
            tracemalloc.stop()
        assert sizes[-1] - sizes[2] < 80_000 / 2


class TestGoingOn:
    @pytest.mark.parametrize("at", NUMBERS[1:])
    def test_the_files_are_those_of_an_unbroken_run(self, at, whole, folder):
        stop(at)
        assert (folder / KEPT).exists()
        assert len(list_outputs(folder)) == NUMBERS.index(at)
        told = []
        done = run(remark=told.append)
        before = NUMBERS[NUMBERS.index(at) - 1]
        assert (done.resumed_after, done.written) == (before, 7 - NUMBERS.index(at))
        assert told == [f"Going on after frame {before}, as the checkpoint '{KEPT}' says."]
        assert list_outputs(folder) == whole
        assert not (folder / KEPT).exists()

    @pytest.mark.parametrize("step", ["read", "add", "write"])
    def test_an_interrupt_loses_nothing_that_was_done(self, step, whole, folder):
        def interrupt(own, number):
            if step == own and number == NUMBERS[3]:
                raise KeyboardInterrupt

        class Interrupted(Running):
            def add(self, frame, *, cut=False):
                result = super().add(frame, cut=cut)
                interrupt("add", frame[0, 0])
                return result

        def read(path):
            interrupt("read", int(path.name[3:7]))
            return np.load(path)

        def write(target, result, frame, source):
            interrupt("write", frame[0, 0])
            save(target, result, frame, source)

        with pytest.raises(KeyboardInterrupt):
            run(Interrupted, seconds=1e9, read=read, write=write)
        done = run(seconds=1e9)
        assert (done.resumed_after, done.written) == (NUMBERS[2], 4)
        assert list_outputs(folder) == whole

    def test_stopped_again_and_again(self, whole, folder):
        for at in NUMBERS[1:]:
            stop(at)
        assert run().written == 1
        assert list_outputs(folder) == whole

    def test_what_the_checkpoint_does_not_know_is_written_again(self, whole, folder, monkeypatch):
        # The clock advances with every call, so that a checkpoint is due after the fourth frame.
        clock = iter(range(1000))
        monkeypatch.setattr("lobewise.recipes.sequence.time.monotonic", lambda: float(next(clock)))
        stop(8, seconds=4.0)
        assert list(list_outputs(folder)) == [f"out.{number:04d}.npy" for number in NUMBERS[:5]]
        (folder / "out.0007.npy").write_bytes(b"half of it")
        done = run()
        assert done.resumed_after == 4
        assert list_outputs(folder) == whole

    def test_no_checkpoint_before_its_time(self, folder):
        stop(9, seconds=3600.0)
        assert not (folder / KEPT).exists()
        assert run().resumed_after is None

    def test_the_first_frame_fails(self, whole, folder):
        stop(1)
        assert run().written == 7
        assert list_outputs(folder) == whole

    def test_a_folder_that_was_moved(self, whole, folder, monkeypatch):
        stop(7)
        moved = folder.with_name("moved")
        folder.rename(moved)
        done = filter_sequence(moved / PATTERN, moved / OUTPUT, Running, read=np.load, write=save, fingerprint="beta 1")
        assert done.resumed_after == 4
        assert list_outputs(moved) == whole

    def test_frames_that_were_added_at_the_end(self, folder):
        stop(9)
        np.save("in.0010.npy", np.ones((2, 3)))
        assert (run().resumed_after, len(list_outputs(folder))) == (8, 8)


class TestNotGoingOn:
    """With any damage to the checkpoint, the run begins with the first frame."""

    @pytest.fixture(autouse=True)
    def _stopped(self, whole, folder):
        self.whole, self.folder = whole, folder
        stop(8)

    def check(self, reason, **options):
        told = []
        done = run(remark=told.append, **options)
        assert (done.resumed_after, done.written) == (None, done.frames)
        assert done.note == f"The checkpoint '{KEPT}' is not used: {reason}."
        assert told == [done.note]
        assert not (self.folder / KEPT).exists()

    def check_files(self):
        assert list_outputs(self.folder) == self.whole

    def test_other_settings(self):
        self.check("it is of other settings or files", fingerprint="beta 2")
        self.check_files()

    @pytest.mark.parametrize(
        "change",
        [
            lambda patch: patch.setattr(lobewise, "__version__", "99"),
            lambda _: os.utime("in.0002.npy", (os.stat("in.0002.npy").st_mtime + 1.0,) * 2),
            lambda _: np.save("in.0005.npy", np.ones((2, 3))),
            lambda _: [os.remove(f"in.{number:04d}.npy") for number in NUMBERS[3:]],
        ],
        ids=["another version", "a source that changed", "a source that came between", "sources that went"],
    )
    def test_other_files(self, change, monkeypatch):
        change(monkeypatch)
        self.check("it is of other settings or files")

    def test_an_output_that_went(self):
        os.remove("out.0003.npy")
        self.check("not all of its outputs are there")
        self.check_files()

    @pytest.mark.parametrize("at", [0.1, 0.3, 0.5, 0.9, 0.999])
    def test_truncated(self, at):
        data = (self.folder / KEPT).read_bytes()
        (self.folder / KEPT).write_bytes(data[: int(at * len(data))])
        self.check("it is damaged")
        self.check_files()

    def test_a_flipped_bit_of_the_state(self):
        data = bytearray((self.folder / KEPT).read_bytes())
        data[data.index(np.load("out.0007.npy").tobytes())] ^= 1
        (self.folder / KEPT).write_bytes(data)
        self.check("it is damaged")
        self.check_files()

    @pytest.mark.parametrize("data", [b"", b"PK", b"\x93NUMPY", b"nonsense"])
    def test_another_file(self, data):
        (self.folder / KEPT).write_bytes(data)
        self.check("it is damaged")

    def test_objects_are_never_unpickled(self):
        """Frames, settings and sizes are right: only the kind of an array is not."""

        class Attack:
            def __reduce__(self):
                return os.mkdir, ("unpickled",)

        pickled = pickle.dumps(Attack())
        pickled += b"." * (-len(pickled) % 8)
        header = {"descr": "|O", "fortran_order": False, "shape": (len(pickled) // 8,)}
        with zipfile.ZipFile(KEPT) as file:
            members = {name: file.read(name) for name in file.namelist()}
        with zipfile.ZipFile(KEPT, "w") as file:
            for name, data in members.items():
                with file.open(name, "w") as stream:
                    if name == "state/total.npy":
                        np.lib.format.write_array_header_1_0(stream, header)
                    stream.write(pickled if name == "state/total.npy" else data)
        self.check("it is damaged")
        assert not os.path.exists("unpickled")

    def test_arrays_that_are_packed(self):
        """Megabytes of compressed arrays may unpack to terabytes; checkpoints are never compressed."""
        with np.load(KEPT) as file:
            arrays = dict(file)
        np.savez_compressed(KEPT, **arrays)
        self.check("it is damaged")
        self.check_files()

    def test_a_state_that_the_filter_refuses(self):
        class Other(Running):
            def set_state(self, state):
                raise InputError("total: expected shape (9, 9), got (2, 3); start anew.")

        self.check("it is damaged", make=Other)


class TestMistakes:
    def test_outputs_that_would_replace_sources(self, folder):
        np.save("in.12.npy", np.ones((2, 3)))
        for source, output in ((PATTERN, "in.%04d.npy"), (PATTERN, "../" + folder.name + "/in.####.npy")):
            with refuses(InputError, expected="a file that is not read, as its content would be lost"):
                filter_sequence(source, output, Running, read=np.load, write=save, fingerprint="")
        np.save("in.2.npy", np.ones((2, 3)))
        # The file of frame 2 would have the name of source 12.
        with refuses(InputError, "output 'in.12.npy'"):
            filter_sequence("in.#.npy", "in.1#.npy", Running, read=np.load, write=save, fingerprint="")

    @pytest.mark.parametrize("seconds", [-1.0, float("nan")])
    def test_times(self, seconds, folder):
        with refuses(InputError, "checkpoint_seconds", expected="a time >= 0"):
            run(seconds=seconds)

    def test_the_filter_refuses_a_frame(self, folder):
        class Refusing(Running):
            def add(self, frame, *, cut=False):
                raise InputError("frame: expected a smaller one.")

        with refuses(InputError):
            run(Refusing)

    def test_names_of_checkpoints(self, folder):
        with refuses(InputError, "checkpoint"):
            run(checkpoint="clean.exr")
        stop(7, checkpoint="elsewhere.npz")
        assert (folder / "elsewhere.npz").exists()
        assert run(checkpoint="elsewhere.npz").resumed_after == 4
        names = {"d/a.####.exr": "d/a", "a_%d_b.exr": "a__b", "#.exr": "sequence", "a##": "a", "a#_b.c.exr": "a_b.c"}
        for pattern, stem in names.items():
            assert name_checkpoint(pattern).as_posix() == f"{stem}.lobewise-history.npz"

    def test_before_anything_is_read(self, folder):
        def read(_path):
            pytest.fail("read first")

        with refuses(FileError, "output 'no/out.1.npy'"):
            filter_sequence(PATTERN, "no/out.#.npy", Running, read=read, write=save, fingerprint="")
        with refuses(FileError, "sequence 'zzz.##.npy'"):
            filter_sequence("zzz.##.npy", OUTPUT, Running, read=read, write=save, fingerprint="")
        (folder / KEPT).mkdir()
        with refuses(FileError, "checkpoint 'out.lobewise-history.npz'"):
            run(read=read)

    def test_a_state_of_objects(self, folder):
        class Odd(Running):
            def get_state(self):
                return {"total": np.array([object()])}

        with refuses(InputError, "state of the filter"):
            run(Odd)
        assert not list(folder.glob("*.npz"))
        assert not list(folder.glob(".*"))


class TestSomeNumbers:
    def test_only_these_are_filtered_and_their_first_is_a_cut(self, folder):
        running = Running()
        done = run(lambda: running, numbers=(3, 4, 8))
        assert (done.frames, done.written) == (3, 3)
        assert running.seen == [(3.0, True), (4.0, False), (8.0, True)]
        assert list(list_outputs(folder)) == ["out.0003.npy", "out.0004.npy", "out.0008.npy"]

    def test_a_number_without_a_file(self, folder):
        def read(_path):
            pytest.fail("read first")

        with refuses(FileError, "sequence 'in.####.npy'", "no file of frames 5 to 6, 10"):
            run(numbers=(4, 5, 6, 10), read=read)

    def test_runs_of_other_numbers_keep_their_checkpoints(self, whole, folder):
        stop(8, numbers=(7, 8, 9))
        assert (folder / "out.7-9.lobewise-history.npz").exists()
        assert run(numbers=(1, 2, 3, 4)).resumed_after is None
        assert run(numbers=(7, 8, 9)).resumed_after == 7
        assert list_outputs(folder) == whole
        assert not list(folder.glob("*.npz"))
