"""Running a filter over numbered files: every frame, in order, and the same files however often it was stopped."""

import os
import pickle
import threading
import time
import tracemalloc
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest

from lobewise.errors import (
    CancelledError,
    DeviceError,
    FileError,
    InputError,
    LobewiseError,
    MissingDependencyError,
    TimeLimitError,
)
from lobewise.io.sequence import FramePattern
from lobewise.recipes.ledger import name_ledger, open_ledger
from lobewise.recipes.sequence import FilterAlone, Need, filter_sequence
from lobewise.work.limits import GIB, check_limits, get_limits, limit_call
from lobewise.work.overlap import tell_in_turn
from lobewise.work.progress import enter_stage
from tests.mistakes import refuses

NUMBERS = (1, 2, 3, 4, 7, 8, 9)
PATTERN, OUTPUT, KEPT = "in.####.npy", "out.####.npy", "out.lobewise-done"
STATE = "shot-7.npz"
"""The record of what the filter remembers in the shot that begins with frame 7."""


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


def run(make=Running, *, stop_at=None, settings="beta 1", seconds=0.0, source=PATTERN, output=OUTPUT, **options):
    """Run over the folder; an interrupt comes while the number ``stop_at`` is read."""

    def read(path):
        if stop_at is not None and path.name == f"in.{stop_at:04d}.npy":
            raise KeyboardInterrupt
        return np.load(path)

    options = {"read": read, "write": save, "checkpoint_seconds": seconds, **options}
    ledger = open_ledger(FramePattern.parse(source), FramePattern.parse(output), options.get("numbers"), settings)
    with ledger.hold():
        report = filter_sequence(source, output, make, ledger=ledger, **options)
        if not report.failures:
            ledger.remove()
    return report


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
    with pytest.raises(KeyboardInterrupt):
        run(stop_at=at, **options)


class TestEveryFrame:
    def test_in_order_neither_first_nor_last_is_dropped(self, folder):
        running, told = Running(), []
        done = run(lambda: running, progress=told.append)
        assert (done.frames, done.written, done.failures) == (7, 7, ())
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
        ledger = open_ledger(*patterns, None, "")
        with ledger.hold():
            done = filter_sequence(*patterns, Running, read=np.load, write=save, ledger=ledger)
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
        count = NUMBERS.index(at)
        assert len(list_outputs(folder)) == count
        told = []
        done = run(remark=told.append)
        assert (done.frames, done.written) == (7, 7 - count)
        assert told == [f"Going on: {count} of 7 frames are done, as '{KEPT}' says."]
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
        assert run(seconds=1e9).written == 4
        assert list_outputs(folder) == whole

    def test_stopped_again_and_again(self, whole, folder):
        for at in NUMBERS[1:]:
            stop(at)
        assert run().written == 1
        assert list_outputs(folder) == whole

    def test_frames_behind_the_last_state_are_made_again(self, whole, folder, monkeypatch):
        # The clock advances with every call, so that a state is due after the third frame alone.
        clock = iter([0.0, 1.0, 1.0, 4.0, 4.0, *[4.0] * 20])
        monkeypatch.setattr("lobewise.recipes.sequence.time", SimpleNamespace(monotonic=lambda: next(clock)))

        def write(target, *words):
            if target.name == "out.0007.npy":
                raise FileError("the disk is full")
            save(target, *words)

        with pytest.raises(FileError, match="the disk is full"):
            run(seconds=4.0, write=write)
        os.remove("out.0004.npy")
        (folder / KEPT / "2.json").unlink()
        # Frame 2 is not done, and the history of frame 3 needs it.
        assert run().written == 7
        assert list_outputs(folder) == whole

    def test_the_first_frame_is_stopped(self, whole, folder):
        stop(1)
        assert not (folder / KEPT).exists()
        assert run().written == 7
        assert list_outputs(folder) == whole

    def test_a_folder_that_was_moved(self, whole, folder, monkeypatch):
        stop(9)
        moved = folder.with_name("moved")
        folder.rename(moved)
        assert run(source=moved / PATTERN, output=moved / OUTPUT).written == 1
        assert list_outputs(moved) == whole

    def test_frames_that_were_added_at_the_end(self, folder):
        stop(9)
        np.save("in.0010.npy", np.ones((2, 3)))
        assert (run().written, len(list_outputs(folder))) == (2, 8)

    def test_a_filter_without_memory_makes_only_what_is_missing(self, folder):
        def run_alone(**options):
            return run(lambda: FilterAlone(np.sqrt), remembers=False, **options)

        stop(9, make=lambda: FilterAlone(np.sqrt), remembers=False)
        os.remove("out.0003.npy")
        assert run_alone().written == 2
        assert len(list_outputs(folder)) == 7


class TestNotGoingOn:
    """What was made of other files or with other settings, or is damaged, is made again."""

    @pytest.fixture(autouse=True)
    def _stopped(self, whole, folder):
        self.whole, self.folder = whole, folder
        stop(9)

    def check(self, written, **options):
        assert run(**options).written == written
        assert not (self.folder / KEPT).exists()

    def check_files(self):
        assert list_outputs(self.folder) == self.whole

    def test_other_settings(self):
        told = []
        self.check(7, settings="beta 2", remark=told.append)
        assert told == [f"Other settings or files than those of '{KEPT}': every frame is made again."]
        self.check_files()

    @pytest.mark.parametrize(
        ("change", "written"),
        [
            (lambda: os.utime("in.0002.npy", (os.stat("in.0002.npy").st_mtime + 1.0,) * 2), 5),
            (lambda: np.save("in.0005.npy", np.ones((2, 3))), 3),
            (lambda: np.save("in.0006.npy", np.ones((2, 3))), 4),
            (lambda: [os.remove(f"in.{number:04d}.npy") for number in NUMBERS[3:]], 0),
        ],
        ids=["a source that changed", "a source behind a shot", "a source before a shot", "sources that went"],
    )
    def test_other_files(self, change, written):
        change()
        self.check(written)

    def test_an_output_that_went(self):
        os.remove("out.0003.npy")
        # What the filter remembers is of frame 3, so its shot is made again.
        self.check(5)
        self.check_files()

    def damage(self, data):
        """Replace the state by ``data``: frames 7 to 9 are made again."""
        (self.folder / KEPT / STATE).write_bytes(data)
        self.check(3)
        self.check_files()

    @pytest.mark.parametrize("at", [0.1, 0.3, 0.5, 0.9, 0.999])
    def test_truncated(self, at):
        data = (self.folder / KEPT / STATE).read_bytes()
        self.damage(data[: int(at * len(data))])

    def test_a_flipped_bit_of_the_state(self):
        data = bytearray((self.folder / KEPT / STATE).read_bytes())
        total = np.load("in.0007.npy") * 0.9 + np.load("in.0008.npy")
        data[data.index(total.tobytes())] ^= 1
        self.damage(data)

    @pytest.mark.parametrize("data", [b"", b"PK", b"\x93NUMPY", b"nonsense"])
    def test_another_file(self, data):
        self.damage(data)

    def test_objects_are_never_unpickled(self):
        """Frames, settings and sizes are right: only the kind of an array is not."""

        class Attack:
            def __reduce__(self):
                return os.mkdir, ("unpickled",)

        pickled = pickle.dumps(Attack())
        pickled += b"." * (-len(pickled) % 8)
        header = {"descr": "|O", "fortran_order": False, "shape": (len(pickled) // 8,)}
        kept = self.folder / KEPT / STATE
        with zipfile.ZipFile(kept) as file:
            members = {name: file.read(name) for name in file.namelist()}
        with zipfile.ZipFile(kept, "w") as file:
            for name, data in members.items():
                with file.open(name, "w") as stream:
                    if name == "state/total.npy":
                        np.lib.format.write_array_header_1_0(stream, header)
                    stream.write(pickled if name == "state/total.npy" else data)
        self.check(3)
        assert not os.path.exists("unpickled")

    def test_arrays_that_are_packed(self):
        """Megabytes of compressed arrays may unpack to terabytes; states are never compressed."""
        with np.load(self.folder / KEPT / STATE) as file:
            arrays = dict(file)
        np.savez_compressed(self.folder / KEPT / STATE, **arrays)
        self.check(3)
        self.check_files()

    def test_a_state_that_the_filter_refuses(self):
        class Other(Running):
            def set_state(self, state):
                raise InputError("total: expected shape (9, 9), got (2, 3); start anew.")

        self.check(3, make=Other)
        self.check_files()

    @pytest.mark.parametrize("name", ["token", STATE, "9.json"])
    def test_links_that_somebody_put_there_change_no_other_file(self, name):
        victim, link = self.folder / "victim", self.folder / KEPT / name
        victim.write_text("mine")
        link.unlink(missing_ok=True)
        link.symlink_to(victim)
        np.save("in.0010.npy", np.ones((2, 3)))
        stop(10)
        assert victim.read_text() == "mine"

    def test_a_second_run_is_refused(self):
        ledger = open_ledger(FramePattern.parse(PATTERN), FramePattern.parse(OUTPUT), None, "beta 1")
        with ledger.hold(), pytest.raises(FileError, match="expected no other run that writes this sequence"):
            run()


class TestFailures:
    """A frame that fails does not stop the others."""

    def run(self, *broken, **options):
        def read(path):
            if int(path.name[3:7]) in broken:
                raise FileError(f"{path.name}: damaged.")
            return np.load(path)

        return run(read=read, **options)

    def test_the_frame_behind_it_begins_anew(self, whole, folder):
        running = Running()
        report = self.run(3, make=lambda: running)
        assert [(each.number, str(each.problem)) for each in report.failures] == [(3, "in.0003.npy: damaged.")]
        assert report.written == 6
        assert [number for number, cut in running.seen if cut] == [1, 4, 7]
        assert "out.0003.npy" not in list_outputs(folder)
        with pytest.raises(
            LobewiseError, match=r"^1 of 7 frames could not be filtered \(frame 3\): in.0003.npy: damaged"
        ):
            report.require_all()

    def test_the_next_run_tries_it_again(self, whole, folder):
        self.run(3)
        assert self.run(3).written == 0
        assert (folder / KEPT).exists()
        # The frame behind it uses its history, and the last shot does not.
        assert self.run().written == 2
        assert list_outputs(folder) == whole
        assert not (folder / KEPT).exists()

    def test_the_filter_refuses_a_frame(self, folder):
        class Refusing(Running):
            def add(self, frame, *, cut=False):
                if frame[0, 0] == 7:
                    raise InputError("frame: expected a smaller one.")
                return super().add(frame, cut=cut)

        (failure,) = run(Refusing).failures
        assert str(failure.problem) == "input 'in.0007.npy': frame: expected a smaller one."

    @pytest.mark.parametrize("kind", [CancelledError, DeviceError, MissingDependencyError, TimeLimitError])
    def test_what_all_frames_have_in_common_ends_the_run(self, kind, folder):
        def read(_path):
            raise kind("no card")

        with pytest.raises(kind):
            run(read=read)

    def test_the_only_frame_has_its_own_error(self, folder):
        report = self.run(3, numbers=[3])
        with pytest.raises(FileError, match=r"^in.0003.npy: damaged.$"):
            report.require_all()


class TestOverlap:
    """While a frame is filtered, the next one is read and the one before is written."""

    def run(self, *, need=None, add=None, read=None, write=None, **options):
        """Run over frames that are their own numbers; return what happened, in order, as (stage, number)."""
        events, calls = [], {"read": read, "add": add, "write": write}

        def act(stage, number):
            events.append((stage, number))
            if calls[stage] is not None:
                calls[stage](number)
            events.append((f"{stage} done", number))
            return number

        self.events = events
        self.report = run(
            lambda: FilterAlone(lambda number: act("add", number)),
            read=lambda path: act("read", int(path.name[3:7])),
            write=lambda target, number, *_: target.write_text(str(act("write", number))),
            remembers=False,
            foretell=lambda _: need or Need(),
            **options,
        )
        return events

    def test_three_frames_at_a_time(self, folder):
        events = {stage: {number: threading.Event() for number in NUMBERS} for stage in ("read", "write")}

        def add(number):
            # Neither comes where this thread reads and writes by itself.
            place = NUMBERS.index(number)
            for stage, others in (
                ("read", NUMBERS[place + 1 : place + 2]),
                ("write", NUMBERS[max(place - 1, 0) : place]),
            ):
                for other in others:
                    assert events[stage][other].wait(60.0), (stage, other)
            assert not any(events["read"][other].is_set() for other in NUMBERS[place + 2 :])

        self.run(read=lambda n: events["read"][n].set(), add=add, write=lambda n: events["write"][n].set())
        assert self.report.written == 7
        assert list(self.report.stage_seconds) == ["reading", "filtering", "writing"]
        assert min(self.report.stage_seconds.values()) > 0.0

    @pytest.mark.parametrize("need", [Need(1e18, 0.0), Need(0.0, 1e18)])
    def test_one_at_a_time_where_there_is_no_memory_for_three(self, need, folder):
        stages = [f"{stage}{more}" for stage in ("read", "add", "write") for more in ("", " done")]
        assert self.run(need=need) == [(stage, number) for number in NUMBERS for stage in stages]

    def test_one_at_a_time_where_the_memory_is_unknown(self, folder):
        threads = set()

        def foretell(_path):
            raise FileError("no header")

        def read(path):
            threads.add(threading.get_ident())
            return np.load(path)

        assert run(read=read, foretell=foretell).written == 7
        assert threads == {threading.get_ident()}

    def test_limits_count_the_frames_beside(self, folder):
        seen = {"read": [], "add": [], "write": []}

        def look(stage):
            return lambda _: seen[stage].append((get_limits().memory, get_limits().aside))

        with limit_call(max_memory=4.0):
            self.run(need=Need(1e6, 1e6), **{stage: look(stage) for stage in seen})
            assert seen["read"] == seen["write"] == [(4.0, 0.0)] * 7
            assert seen["add"] == [(4.0, 1e6), *[(4.0, 2e6)] * 5, (4.0, 0.0)]
            # 3.1 GiB are left: enough for two frames and the work on one, not for three.
            events = self.run(need=Need(0.8 * GIB, 1.0 * GIB), settings="others")
            assert events.index(("read", 3)) > events.index(("write done", 2))

    def test_the_error_of_a_frame_that_is_read_ahead_comes_in_its_turn(self, folder):
        begun = threading.Event()

        def read(number):
            if number == 3:
                begun.set()
                raise TimeLimitError("the time is over")

        with pytest.raises(TimeLimitError):
            self.run(read=read, add=lambda number: number != 2 or begun.wait(60.0))
        assert begun.is_set()
        assert list(list_outputs(folder)) == ["out.0001.npy", "out.0002.npy"]
        self.run()
        assert self.report.written == 5

    def test_an_error_of_writing_ends_the_run(self, folder):
        def write(number):
            if number == 2:
                raise FileError("the disk is full")

        with pytest.raises(FileError, match="the disk is full"):
            self.run(write=write)
        assert list(list_outputs(folder)) == ["out.0001.npy"]
        self.run()
        assert self.report.written == 6

    @pytest.mark.parametrize("how", ["cancel", "interrupt"])
    def test_a_stop_ends_reading_and_lets_writing_end(self, how, folder):
        begun, filtering, stopped = threading.Event(), threading.Event(), []

        def read(number):
            if number == 3:
                begun.set()
                try:
                    for _ in range(10_000):
                        check_limits()
                        time.sleep(0.001)
                except CancelledError:
                    stopped.append(number)
                    raise

        def add(number):
            if number == 2:
                assert begun.wait(60.0)
                filtering.set()
                if how == "interrupt":
                    raise KeyboardInterrupt
                check_limits()
                enter_stage("writing")

        def write(number):
            assert number == 1
            assert filtering.wait(60.0)

        with pytest.raises(KeyboardInterrupt if how == "interrupt" else CancelledError):
            self.run(read=read, add=add, write=write, progress=lambda _: not filtering.is_set())
        assert stopped == [3]
        assert list(list_outputs(folder)) == ["out.0001.npy"]
        self.run()
        assert self.report.written == 6

    def test_a_stop_while_the_next_frame_is_waited_for(self, folder):
        told, stopped = [], []

        def read(number):
            if number == 2:
                try:
                    for _ in range(10_000):
                        check_limits()
                        time.sleep(0.001)
                except CancelledError:
                    stopped.append(number)
                    raise

        def follow(record):
            told.append((record.frame, record.detail))
            return told.count(("in.0002.npy", "reading")) < 3

        with pytest.raises(CancelledError):
            self.run(read=read, progress=follow)
        assert stopped == [2]

    def test_a_stop_keeps_what_the_filter_remembers(self, whole, folder):
        class Interrupted(Running):
            def add(self, frame, *, cut=False):
                if frame[0, 0] == 4:
                    raise KeyboardInterrupt
                return super().add(frame, cut=cut)

        with pytest.raises(KeyboardInterrupt):
            run(Interrupted, seconds=1e9)
        running = Running()
        assert run(lambda: running).written == 4
        assert running.seen[0] == (4.0, False)
        assert list_outputs(folder) == whole

    def test_progress_and_notes_come_from_one_thread_in_order(self, folder):
        notes, threads = [], set()

        def note(stage):
            return lambda number: tell_in_turn(lambda: (notes.append((number, stage)), threads.add(get_ident())))

        get_ident = threading.get_ident
        self.run(
            **{stage: note(stage) for stage in ("read", "add", "write")},
            progress=lambda _: threads.add(get_ident()) and None,
        )
        assert notes == [(number, stage) for number in NUMBERS for stage in ("read", "add", "write")]
        assert threads == {get_ident()}
        note("read")(0)
        assert notes[-1] == (0, "read")

    def test_without_threads(self, folder, monkeypatch):
        def refuse(*_words):
            raise RuntimeError("can't start new thread")

        monkeypatch.setattr(threading.Thread, "start", refuse)
        self.run()
        assert self.report.written == 7


class TestMistakes:
    def test_outputs_that_would_replace_sources(self, folder):
        np.save("in.12.npy", np.ones((2, 3)))
        for output in ("in.%04d.npy", "../" + folder.name + "/in.####.npy"):
            with refuses(InputError, expected="a file that is not read, as its content would be lost"):
                run(output=output)
        np.save("in.2.npy", np.ones((2, 3)))
        # The file of frame 2 would have the name of source 12.
        with refuses(InputError, "output 'in.12.npy'"):
            run(source="in.#.npy", output="in.1#.npy")

    @pytest.mark.parametrize("seconds", [-1.0, float("nan")])
    def test_times(self, seconds, folder):
        with refuses(InputError, "checkpoint_seconds", expected="a time >= 0"):
            run(seconds=seconds)

    def test_names_of_records(self, folder):
        names = {"d/a.####.exr": "d/a", "a_%d_b.exr": "a__b", "#.exr": "sequence", "a##": "a", "a#_b.c.exr": "a_b.c"}
        for pattern, stem in names.items():
            assert name_ledger(pattern).as_posix() == f"{stem}.lobewise-done"

    def test_before_anything_is_read(self, folder):
        def read(_path):
            pytest.fail("read first")

        with refuses(FileError, "sequence 'zzz.##.npy'"):
            run(source="zzz.##.npy", read=read)
        (folder / KEPT).write_text("no folder")
        with pytest.raises(FileError, match="records"):
            run(read=read)

    def test_a_state_of_objects(self, folder):
        class Odd(Running):
            def get_state(self):
                return {"total": np.array([object()])}

        with refuses(InputError, "state of the filter"):
            run(Odd)
        assert not list(folder.rglob("*.npz"))
        assert not list(folder.rglob(".*"))


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

    def test_runs_of_other_numbers_keep_their_records(self, whole, folder):
        stop(8, numbers=(7, 8, 9))
        assert (folder / "out.7-9.lobewise-done").is_dir()
        assert run(numbers=(1, 2, 3, 4)).written == 4
        assert run(numbers=(7, 8, 9)).written == 2
        assert list_outputs(folder) == whole
        assert not list(folder.glob("*.lobewise-done"))
