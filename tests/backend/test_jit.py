"""Compiled kernels on disk: which are kept, what their names depend on, damaged files; and checks of calls."""

import ast
import os
import sys
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import halide as hl
import numpy as np
import platformdirs
import pytest

import lobewise
from lobewise import errors, settings
from lobewise.backend import disk, expressions, jit, pointwise, sources, trust
from lobewise.backend.buffers import Buffer
from lobewise.backend.disk import fetch_object, locate_cache_folder
from lobewise.backend.jit import Kernel, describe_kernel, describe_key, list_definitions
from lobewise.backend.runtime import Runtime, get_runtime
from lobewise.backend.signature import Parameter, Signature, check_call
from lobewise.backend.sources import describe_definitions, digest_definitions, take_apart
from lobewise.errors import DeviceError
from lobewise.features import GgxFeature, NormalFeature, ScreenFeature, SgMixtureFeature
from lobewise.filters import cross_filter, fireflies, scheduling
from lobewise.filters.cross_pass import PassKey, Reads, Writes, make_pass
from lobewise.filters.fireflies import compute_energy_lost
from lobewise.filters.forms import Taps
from lobewise.filters.history import sums
from lobewise.filters.history.accumulation_pass import make_accumulation
from lobewise.filters.history.reprojection_pass import make_reprojection
from lobewise.guides import lobe_fields
from lobewise.guides.surfaces import mark_surface_pixels
from lobewise.records import frame
from tests.mistakes import refuses
from tests.pythons import run_python
from tests.streaming.frames import make_scene

pytestmark = pytest.mark.processor

PROGRAM = """
import numpy as np
from lobewise.features import NormalFeature, ScreenFeature
from lobewise.filters.cross_filter import run_filter
import lobewise.backend.jit as jit
import lobewise.backend.objects as objects
import lobewise.backend.runtime as runtime
made = []
compile_object = objects.compile_object
runtime.compile_object = jit.compile_object = lambda write: (made.append(1), compile_object(write))[1]
Own = type("Own", (ScreenFeature,), {{}})
FEATURE = {feature}
image = run_filter(np.ones((4, 5, 3), np.float32), np.ones((4, 5), bool), [FEATURE], form="full", radius=1).image
print(len(made), np.abs(image - 1.0).max() < 1e-5)
"""


def run_program(folder: Path | str, feature: str = "ScreenFeature(1.0)", before: str = "") -> str:
    """Return how much a process that filters compiled, and whether its result is right; ``before`` runs before it."""
    return run_python("-c", before + PROGRAM.format(feature=feature), LOBEWISE_CACHE=str(folder))


def make_elf() -> bytes:
    """Return an object file with two empty sections."""
    head = bytearray(64)
    head[:6] = b"\x7fELF\x02\x01"
    head[16:18] = (1).to_bytes(2, "little")
    head[40:48] = (64).to_bytes(8, "little")
    head[58:64] = b"".join(number.to_bytes(2, "little") for number in (64, 2, 1))
    return bytes(head) + bytes(128)


class TestFolder:
    @pytest.mark.nightly
    def test_second_process_compiles_nothing(self, tmp_path):
        # The runtime and the kernel.
        assert run_program(tmp_path / "new") == "2 True\n"
        assert len(list((tmp_path / "new").glob("*.kernel"))) == 2
        assert run_program(tmp_path / "new") == "0 True\n"

    @pytest.mark.nightly
    def test_features_of_others_are_compiled_in_every_process(self, tmp_path):
        assert run_program(tmp_path, "Own(1.0)") == "2 True\n"
        assert run_program(tmp_path, "Own(1.0)") == "1 True\n"

    def test_off(self, tmp_path):
        assert run_program("off") == "2 True\n"
        assert not Path("off").exists()

    @pytest.mark.parametrize("damage", [b"", b"nonsense", b"{}\n", b'{"sha256": "0"}\nabc'])
    def test_what_is_not_whole_is_made_again(self, tmp_path, monkeypatch, damage):
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path))
        made: list[int] = []

        def make() -> tuple[bytes, dict[str, Any]]:
            made.append(1)
            return make_elf() + b"\nwith a line", {"kinds": ["buffer"]}

        content, head = fetch_object("something", make)
        (path,) = tmp_path.glob("*.kernel")
        path.write_bytes(damage)
        for _ in range(2):
            assert fetch_object("something", make)[0] == content == make_elf() + b"\nwith a line"
        assert head["kinds"] == ["buffer"]
        assert len(made) == 2
        assert list(tmp_path.iterdir()) == [path]

    def test_files_not_used_for_longest_go(self, tmp_path, monkeypatch):
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path))
        monkeypatch.setattr(disk, "MAX_KERNEL_FILES", 4)
        for number in range(4):
            path = tmp_path / f"{number}.kernel"
            path.write_text("")
            os.utime(path, (number, number))
        fetch_object("something", lambda: (b"code", {}))
        left = sorted(path.name for path in tmp_path.iterdir())
        assert len(left) == 2
        assert "3.kernel" in left

    def test_named_by_the_environment(self, monkeypatch, tmp_path):
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path / "here"))
        assert locate_cache_folder() == tmp_path / "here"
        monkeypatch.delenv("LOBEWISE_CACHE")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        assert locate_cache_folder() == platformdirs.user_cache_path("lobewise", appauthor=False)


def edit(monkeypatch: pytest.MonkeyPatch, module: ModuleType, old: str, new: str) -> None:
    """Let a module's file hold another text for whoever reads it."""
    path = Path(str(module.__file__))
    whole = path.read_bytes()
    assert old.encode() in whole

    def read(self: Path) -> bytes:
        with self.open("rb") as file:
            content = file.read()
        return content.replace(old.encode(), new.encode()) if self == path else content

    monkeypatch.setattr(Path, "read_bytes", read)
    # A process reads each file once.
    monkeypatch.setattr(sources, "_open_kept", sources._Kept)


@cache
def name_definition(code: CodeType) -> str:
    """Return the name of the function or class at the top of a module that some code lies in."""
    for node in ast.parse(Path(code.co_filename).read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            if first <= code.co_firstlineno <= (node.end_lineno or first):
                return node.name
    return code.co_name


KERNELS = {
    "cross filter": list_definitions((PassKey, GgxFeature, SgMixtureFeature), make_pass),
    "fireflies": list_definitions(("fireflies", True), fireflies.make_fireflies),
    "reprojection": list_definitions(("reprojection", GgxFeature), make_reprojection),
    "accumulation": list_definitions(("accumulation", GgxFeature), make_accumulation),
    "lobes": list_definitions((lobe_fields.define_sg_lobes,), pointwise.make_pointwise),
}
"""What some kernels are made from."""


class TestSources:
    CODE = "from lobewise.records.frame import Frame\nLIMIT = 3\ndef f(x):\n    return Frame(x + LIMIT)\n"

    def test_comments_and_texts_change_nothing(self):
        told = '"""What it is."""\n# Why.\n' + self.CODE.replace("3\n", '3\n"""A limit."""\n').replace(
            "    return", '    """Return a sum."""\n    return'
        )
        assert take_apart(told) == take_apart(self.CODE)

    @pytest.mark.parametrize("change", [("3", "4"), ("x + L", "x - L"), ("def f", "def g"), ("Frame(x", "frame(x")])
    def test_code_does(self, change):
        assert take_apart(self.CODE.replace(*change)).definitions != take_apart(self.CODE).definitions

    def test_what_a_definition_refers_to(self):
        source = take_apart(self.CODE)
        assert source.imports == {"Frame": ["lobewise.records.frame.Frame"]}
        assert [reads for _, reads in source.definitions["f"]] == [["Frame", "LIMIT"]]

    def test_annotations_name_nothing_that_counts(self):
        ((_, reads),) = take_apart(self.CODE + "def g(x: LIMIT, y=f) -> Frame: z: LIMIT = f\n").definitions["g"]
        assert reads == ["f"]

    @pytest.mark.parametrize("more", ["LIMIT += 1", "for LIMIT in (5, 6): pass", "if f: LIMIT = 4", "f.limit = LIMIT"])
    def test_statements_count_for_what_they_change(self, more):
        both = take_apart(self.CODE), take_apart(self.CODE + more)
        assert any(both[0].definitions[name] != both[1].definitions[name] for name in ("LIMIT", "f"))

    def test_names_of_imported_modules(self):
        found = digest_definitions(["lobewise.lobes.vectors.dot", "lobewise.features.GgxFeature"])
        assert "lobewise.features.ggx.GgxFeature" in found
        # By way of `expressions.log2`, and of classes above.
        assert {"lobewise.backend.expressions.LOG2_COEFFICIENTS", "lobewise.features.base.Feature"} < set(found)
        assert "lobewise.features.sg.SgFeature" not in found
        assert len(digest_definitions(["lobewise.filters.forms"])) == 8
        assert not digest_definitions(["numpy", "lobewise.nothing", "lobewise.records.frame.nothing"])

    @pytest.mark.parametrize("kernel", KERNELS)
    @pytest.mark.parametrize(
        ("module", "old", "new"),
        [
            (settings, "Band-limit of the lobes", "Limit of the lobes"),
            (errors, "expected", "wanted"),
            (trust, "belongs to another user", "is foreign"),
            (cross_filter, "MIN_TILE_STRIPS = 16", "MIN_TILE_STRIPS = 8"),
            (frame, "class LobeKind", "# A comment.\nclass LobeKind"),
        ],
        ids=lambda value: getattr(value, "__name__", ""),
    )
    def test_what_is_not_compiled_does_not_count(self, monkeypatch, kernel, module, old, new):
        before = describe_definitions(KERNELS[kernel])
        edit(monkeypatch, module, old, new)
        # Checks of features raise errors; a feature counts as a whole.
        is_part = module is errors and kernel in ("cross filter", "reprojection", "accumulation")
        assert (describe_definitions(KERNELS[kernel]) == before) is not is_part

    @pytest.mark.parametrize(
        ("kernel", "module", "old", "new"),
        [
            # The numbers of `LobeKind` are compiled into kernels.
            ("lobes", frame, "BECKMANN = 2", "BECKMANN = 7"),
            ("cross filter", expressions, "0.013534168", "0.013534169"),
            ("cross filter", settings, "MAX_LOBES = 4", "MAX_LOBES = 5"),
            ("cross filter", scheduling, "STRIP_ROWS = 32", "STRIP_ROWS = 16"),
            ("fireflies", jit, "pipeline.compile_to_object(", "pipeline.compile_to_an_object("),
            ("fireflies", fireflies, "REACH = 6", "REACH = 5"),
            ("accumulation", sums, "faded.squared_weight * share", "faded.squared_weight"),
        ],
    )
    def test_what_is_compiled_counts_however_deep(self, monkeypatch, kernel, module, old, new):
        before = describe_definitions(KERNELS[kernel])
        edit(monkeypatch, module, old, new)
        assert describe_definitions(KERNELS[kernel]) != before

    @pytest.mark.nightly
    def test_everything_that_runs_while_a_kernel_is_made_counts(self, monkeypatch):
        missing: list[str] = []

        def load(device, known, target, make, number):
            ran: set[str] = set()

            def look(frame, event, _):
                module = frame.f_globals.get("__name__", "")
                is_file = not frame.f_code.co_filename.startswith("<")
                if event == "call" and is_file and module.startswith("lobewise."):
                    ran.add(f"{module}.{name_definition(frame.f_code)}")

            sys.setprofile(look)
            try:
                make(target)
            finally:
                sys.setprofile(None)
            assert ran
            missing.extend(ran - set(digest_definitions(list_definitions(keys[-1], make))))
            return load_kernel(device, known, target, make, number)

        def describe(key, make):
            keys.append(key)
            return describe_kernel(key, make)

        keys: list[Any] = []
        load_kernel = jit._load
        monkeypatch.setattr(jit, "_kernels", {})
        monkeypatch.setattr(jit, "_load", load)
        monkeypatch.setattr(jit, "describe_kernel", describe)
        scene = make_scene((24, 40))
        for quality in ("fast", "balanced", "high"):
            for similarity in settings.SIMILARITY_NAMES:
                lobewise.denoise(scene, quality=quality, similarity=similarity, with_oidn=False, device="cpu")
        for form in settings.FORM_NAMES:
            lobewise.denoise(scene, quality="fast", form=form, device="cpu")
        history = lobewise.TemporalFilter(device="cpu")
        for _ in range(2):
            history.add(scene)
        assert missing == []
        assert len(keys) > 50

    def test_works_without_a_folder(self, monkeypatch):
        told = describe_definitions(["lobewise.filters.forms"])
        monkeypatch.setenv("LOBEWISE_CACHE", "off")
        assert describe_definitions(["lobewise.filters.forms"]) == told


class TestKey:
    def test_tells_classes_functions_and_values_apart(self):
        keys = [
            (ScreenFeature, ()),
            (NormalFeature, ()),
            (compute_energy_lost, True),
            (compute_energy_lost, False),
            PassKey(Taps.SQUARE, (), Reads.RADIANCE, Writes.PIXELS),
            PassKey(Taps.SQUARE, (), Reads.RADIANCE, Writes.SUMS),
            PassKey(Taps.ATROUS, (), Reads.RADIANCE, Writes.PIXELS),
            ("1",),
            (1,),
            ((1,), ()),
            ((), (1,)),
        ]
        told = [describe_key(key) for key in keys]
        assert None not in told
        assert len(set(told)) == len(keys)

    def test_names_what_it_is_made_from(self):
        one, two = (describe_kernel(("name", each), mark_surface_pixels) for each in (ScreenFeature, NormalFeature))
        assert one != two
        assert describe_kernel(("name",), lambda: 0) is None

    @pytest.mark.parametrize("part", [lambda: 0, type("Own", (ScreenFeature,), {}), np.zeros(2), object()])
    def test_knows_what_is_not_its_own(self, part):
        assert describe_key((ScreenFeature, part)) is None


class TestCalls:
    def test_a_problem_is_an_error(self):
        runtime = get_runtime("cpu")

        def tell(code: int) -> int:
            runtime._keep_problem(None, b"it burns")
            return code

        with refuses(DeviceError, "device", "it burns"):
            runtime.call(tell, 0)
        with refuses(DeviceError, "device", "code 3"):
            runtime.call(lambda: 3)

    def test_a_missing_function(self):
        with pytest.raises(LookupError, match="nothing_of_this_name"):
            get_runtime("cpu").find("nothing_of_this_name")

    def test_one_runtime_for_a_device(self):
        assert get_runtime("cpu") is get_runtime("cpu")
        assert isinstance(get_runtime("cpu"), Runtime)


@pytest.fixture
def parameters() -> list[Parameter]:
    """Return the parameters of a kernel that reads a colour, a mask and a guide and writes an image."""
    signature = Signature("mean")
    signature.image("colour", "height", "width", 3)
    signature.image("mask", "height", "width", type=hl.UInt(8))
    # Outputs come last, whenever they are declared.
    signature.output("image", "height", "width", 3)
    signature.image("guide", "height", "width", 3)
    signature.count("radius", 1, 8)
    signature.number("scale")
    assert [each.name for each in signature.parameters][-1] == "image"
    return signature.parameters


def make_call(**changes: Any) -> dict[str, Any]:
    """Return a call that fits, changed."""
    given = {
        "colour": np.zeros((4, 5, 3), np.float32),
        "mask": np.zeros((4, 5), np.uint8),
        "guide": np.zeros((4, 5, 3), np.float32),
        "radius": 2,
        "scale": 0.5,
        "image": np.zeros((4, 5, 3), np.float32),
    } | changes
    return {name: Buffer(value) if isinstance(value, np.ndarray) else value for name, value in given.items()}


class TestCheckedCalls:
    """Machine code checks nothing: wrong arguments must be refused before it runs."""

    def test_what_fits(self, parameters):
        check_call("mean", parameters, make_call())
        rows = np.zeros((9, 5, 3), np.float32)[2:6]
        check_call("mean", parameters, make_call(colour=rows))
        check_call("mean", parameters, make_call(image=Buffer(np.zeros((2, 4, 3), np.float32), (2, 1))))

    @pytest.mark.parametrize(
        ("changes", "told"),
        [
            ({"colour": np.zeros((4, 5), np.float32)}, "colour: float32"),
            ({"colour": np.zeros((4, 5, 3))}, "float64"),
            ({"mask": np.zeros((4, 5), np.float32)}, "mask: uint8"),
            ({"guide": np.zeros((4, 6, 3), np.float32)}, "width is 5 in colour"),
            ({"guide": np.zeros((5, 4, 3), np.float32)}, "height is 4 in colour"),
            ({"guide": np.zeros((5, 4, 3), np.float32).swapaxes(0, 1)}, "strides"),
            ({"guide": np.zeros((4, 5, 4), np.float32)[..., :3]}, "strides"),
            ({"image": np.zeros((4, 5, 2), np.float32)}, "image: float32"),
            ({"image": np.zeros((3, 5, 3), np.float32)}, "height is 4 in colour"),
            ({"image": Buffer(np.zeros((3, 5, 3), np.float32), (2, 0))}, "height is 4 in colour"),
            ({"radius": 0}, "radius: int32 number from 1 to 8, got 0"),
            ({"radius": 9}, "radius: int32 number from 1 to 8, got 9"),
            ({"radius": 2.0}, "radius: int32 number from 1 to 8, got 2.0"),
            ({"scale": "wide"}, "scale: float32 number, got wide"),
            ({"radios": 2}, "has no radios"),
            ({"radius": np.zeros((4, 5), np.float32)}, "radius: int32.*an image"),
            ({"mask": 4}, "mask: uint8.*got 4"),
        ],
    )
    def test_what_does_not(self, parameters, changes, told):
        with pytest.raises(TypeError, match=told):
            check_call("mean", parameters, make_call(**changes))

    def test_what_is_missing_or_swapped(self, parameters):
        given = make_call()
        given["mask"], given["guide"] = given["guide"], given["mask"]
        with pytest.raises(TypeError, match="the kernel 'mean' expects mask: uint8"):
            check_call("mean", parameters, given)
        del given["mask"]
        with pytest.raises(TypeError, match="a call of the kernel 'mean' lacks mask"):
            check_call("mean", parameters, given)

    def test_a_kernel_asks_before_it_runs(self, parameters):
        kernel = Kernel(get_runtime("cpu"), 1, "mean", parameters)
        with pytest.raises(TypeError, match="lacks colour"):
            kernel(radius=1)


LOAD_CUDA = """
import halide as hl
from lobewise.backend import runtime
from lobewise.backend.objects import compile_object
target = hl.get_host_target()
for name in ("NoAsserts", "NoBoundsQuery", "CUDA", "CUDACapability80"):
    target = target.with_feature(getattr(hl.TargetFeature, name))
content = compile_object(lambda path: hl.compile_standalone_runtime(path, target))
assert runtime._look_up_function(runtime._load_object(content, side_by_side=False), "halide_cuda_device_interface")
"""


@pytest.mark.processor
def test_the_runtime_of_cuda_loads_without_a_card() -> None:
    """In a process of its own: a memory manager that cannot hold the file ends it."""
    run_python("-c", LOAD_CUDA)
