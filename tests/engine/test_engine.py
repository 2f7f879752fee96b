"""The verbs of recipes: the same calls, run at once and recorded."""

from functools import partial
from itertools import pairwise

import halide as hl
import numpy as np
import pytest

from lobewise import engine
from lobewise.backend.devices import list_devices
from lobewise.backend.pointwise import Grid, Vector
from lobewise.engine.graph import Graph, GraphImage, write_length
from lobewise.engine.here import HERE, Here
from lobewise.engine.numbers import Condition, Number, choose_larger, make_single, square_single
from lobewise.engine.recorder import Recorder
from lobewise.filters.mixing import Perceptron, compute_shares, make_shares
from lobewise.filters.noise.pooling import BLUR_WEIGHTS, blur_image


def define_sum(grid: Grid) -> list[Vector]:
    """Return the sum of two images, and where it is above a number."""
    total = grid.read_one("a") + grid.read_one("b")
    return [[total], [hl.u8(total > grid.get("bound")[0])]]


def define_same(grid: Grid) -> list[Vector]:
    """Return an image."""
    return [grid.read("image")]


def make_network(inputs: int, outputs: int) -> Perceptron:
    """Return a random network with hidden layers of four units."""
    rng, sizes = np.random.default_rng(5), (inputs, 4, 4, outputs)
    weights = [rng.normal(size=pair).astype(np.float32) for pair in pairwise(sizes)]
    biases = [rng.normal(size=size).astype(np.float32) for size in sizes[1:]]
    return Perceptron(np.zeros(inputs, np.float32), np.ones(inputs, np.float32), tuple(weights), tuple(biases))


@pytest.fixture
def recorder() -> Recorder:
    return Recorder(Graph(), hl.get_host_target(), "test")


def give(recorder: Recorder, name: str) -> GraphImage:
    return recorder.graph.give(name, "height", "width", text=name)


class TestHere:
    def test_the_engine_of_a_thread_is_the_processor_until_another_is_chosen(self) -> None:
        assert engine.get_engine() is HERE
        with engine.on("vulkan"):
            assert engine.get_engine().device == "vulkan"
            with engine.on("cpu"):
                assert engine.get_engine().device == "cpu"
            assert engine.get_engine().device == "vulkan"
        assert engine.get_engine() is HERE

    def test_an_error_puts_the_engine_back(self) -> None:
        with pytest.raises(ValueError, match="told"), engine.use(Here("cuda")):
            raise ValueError("told")
        assert engine.get_engine() is HERE

    def test_pixels_write_into_memory_that_is_given(self) -> None:
        a = np.arange(80, dtype=np.float32).reshape(4, 20)
        memory = np.zeros((8, 40), np.float32)
        total, above = engine.pixels(define_sum, {"a": a, "b": a}, {"bound": np.float32(10.0)}, into=[memory[::2, ::2]])
        np.testing.assert_array_equal(total, 2.0 * a)
        np.testing.assert_array_equal(memory[::2, ::2], total)
        assert memory.sum() == total.sum()
        assert above.dtype == np.bool_
        assert above.sum() == (2.0 * a > 10.0).sum()

    def test_a_box_holds_the_mask_and_what_is_near(self) -> None:
        mask, image, seen = np.zeros((9, 12), bool), np.zeros((9, 12)), []
        mask[3, 4] = mask[5, 11] = True

        def run(part: np.ndarray) -> None:
            seen.append(part.shape)
            part += 1.0

        engine.in_box(mask, 2, run, image)
        assert seen == [(7, 10)]
        assert image[1:8, 2:12].all()
        assert image.sum() == 70.0
        engine.in_box(np.zeros((9, 12), bool), 2, run, image)
        assert len(seen) == 1

    @pytest.mark.parametrize("rows", [1, 7, 64])
    def test_rows_one_after_others_are_those_of_the_whole(self, rows: int, rng: np.random.Generator) -> None:
        image = rng.random((23, 17, 3)).astype(np.float32)
        heights: list[int] = []

        def gather(images: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
            heights.append(len(images["image"]))
            return {"blurred": blur_image(images["image"], 2)}

        given = {"image": image, "absent": None}
        found = engine.in_bands(gather, lambda gathered: gathered["blurred"], given, rows, 4)
        np.testing.assert_array_equal(found, blur_image(image, 2))
        assert max(heights) <= rows + 8

    @pytest.mark.parametrize("channels", [1, 3, 18])
    def test_a_blur_is_that_of_each_channel(self, channels: int, rng: np.random.Generator) -> None:
        image = rng.random((23, 37, channels)).astype(np.float32)[..., 0 if channels == 1 else slice(None)]
        down, right = (np.clip(np.arange(size)[:, None] + 3 * np.arange(-2, 3), 0, size - 1) for size in (23, 37))
        along = np.einsum("yxk...,k->yx...", image[:, right], BLUR_WEIGHTS)
        np.testing.assert_allclose(
            blur_image(image, 3), np.einsum("ykx...,k->yx...", along[down], BLUR_WEIGHTS), rtol=1e-6
        )

    def test_a_chain_is_its_two_kernels(self, rng: np.random.Generator) -> None:
        seen, network = rng.random((23, 17, 5)).astype(np.float32), make_network(5, 2)
        key, make, rows = ("shares", (5, 4, 4, 2)), partial(make_shares, (5, 4, 4, 2)), {"rows": 6, "channels": 5}
        images = {"image": seen}
        found = engine.chain(define_same, images, {}, key, make, network.name_arrays(), name="seen", **rows)
        np.testing.assert_array_equal(found, compute_shares(seen, network, 2))

    def test_conditions_are_judged_at_once(self) -> None:
        assert engine.when(engine.compare(2.0, ">=", 2.0), lambda: "yes", lambda: "no") == "yes"
        assert engine.when(engine.compare(2.0, ">", 2.0), lambda: "yes") is None
        assert engine.both(True, engine.compare(1.0, ">", 0.0))
        assert engine.only(False, np.ones(3)) is None

    def test_samples_are_the_shaded_pixels(self) -> None:
        image = np.arange(2 * 5 * 7 * 3, dtype=np.float32).reshape(2, 5, 7, 3)
        np.testing.assert_array_equal(engine.pick(image[0], 2, (1, 0)), image[0, 1::2, ::2])
        stack = np.moveaxis(image[0], -1, 0)
        np.testing.assert_array_equal(engine.pick(stack, 3, (0, 2), stacked=True), stack[:, ::3, 2::3])

    def test_an_image_of_one_value_has_the_memory_of_a_row(self) -> None:
        image = engine.fill("one", 1.0, (7, 30, 20))
        assert image.shape == (7, 30, 20)
        assert (image == 1.0).all()
        assert image.strides[-2] == 0

    def test_every_device_is_a_name_of_the_list(self) -> None:
        assert {"cpu", "vulkan", "cuda"} <= {each.name for each in list_devices()}


class TestRecorder:
    def test_what_was_computed_is_not_computed_again(self, recorder: Recorder) -> None:
        with engine.use(recorder):
            images = {"a": give(recorder, "a"), "b": give(recorder, "b")}
            first = engine.pixels(define_sum, images, {"bound": np.float32(1.0)})
            again = engine.pixels(define_sum, images, {"bound": np.float32(1.0)})
            other = engine.pixels(define_sum, images, {"bound": np.float32(2.0)})
        assert first == again
        assert other[0] is not first[0]
        assert len(recorder.graph.operations) == 2

    def test_a_part_that_may_not_run_leaves_nothing_for_others(self, recorder: Recorder) -> None:
        with engine.use(recorder):
            images = {"a": give(recorder, "a"), "b": give(recorder, "b")}
            share = engine.total(np.mean, [images["a"]], name="share")

            def run() -> None:
                engine.pixels(define_sum, images, {"bound": np.float32(1.0)})

            engine.when(engine.compare(share, ">", 0.5), run, run)
            run()
        conditions = [each.when for each in recorder.graph.operations if each.is_kernel]
        assert conditions == ["(p->share > 0.5)", "!(p->share > 0.5)", ""]

    def test_a_number_keeps_its_expression(self, recorder: Recorder) -> None:
        with engine.use(recorder):
            images = {"a": give(recorder, "a"), "b": give(recorder, "b")}
            bound = choose_larger(Number(4.0, "p->settings.bound"), 1.0)
            engine.pixels(define_sum, images, {"bound": make_single(bound)})
        (operation,) = recorder.graph.operations
        assert dict(operation.arguments)["bound_0"] == "(float)(double)(float)fmax(p->settings.bound, 1.0)"

    def test_what_is_kept_is_written_where_the_next_frame_reads(self, recorder: Recorder) -> None:
        with engine.use(recorder):
            a = give(recorder, "a")
            before = recorder.declare("seen", "height", "width")
            engine.keep("seen", lambda: a)
            engine.keep("seen", lambda: recorder.state["seen"])
        (operation,) = recorder.graph.operations
        assert operation.function == "copy_image"
        assert operation.writes == (recorder.state["seen"],)
        assert recorder.graph.state_pairs == [(recorder.state["seen"], before)]

    def test_without_a_condition_an_image_is_cleared(self, recorder: Recorder) -> None:
        with engine.use(recorder):
            a = recorder.graph.make("a", "height", "width")
            assert engine.only(Condition("p->known"), a) is a
        (operation,) = recorder.graph.operations
        assert (operation.function, operation.when) == ("clear_image", "!p->known")

    def test_values_as_pixels_lie_in_the_memory_of_the_image(self, recorder: Recorder) -> None:
        image = recorder.graph.make("image", "height", "width", 5)
        with engine.use(recorder):
            blurred = blur_image(image, 2)
        along_rows, down = recorder.graph.operations
        assert blurred.shape == image.shape
        assert blurred.memory is down.writes[0]
        assert down.reads[0].memory is along_rows.writes[0]
        assert [write_length(length) for length in down.writes[0].shape] == ["p->height", "(p->width * 5)"]
        assert blurred.memory.count_bytes(1.0) == image.count_bytes(1.0)

    def test_what_lies_in_a_chain_holds_a_band(self, recorder: Recorder) -> None:
        network, make = make_network(5, 2), partial(make_shares, (5, 4, 4, 2))
        image = recorder.graph.give("image", "height", "width", 5, text="image")
        with engine.use(recorder):
            found = engine.chain(
                define_same,
                {"image": image},
                {},
                "shares",
                make,
                network.name_arrays(),
                rows=6,
                name="seen",
                channels=5,
            )
        assert found.shape == ("height", "width", 2)
        between = {each.name: each.shape for operation in recorder.graph.operations for each in operation.writes}
        assert between["seen"] == ("band", "width", 5)

    def test_planes_of_a_stack(self, recorder: Recorder) -> None:
        stack = recorder.graph.make("stack", 4, "height", "width")
        assert [plane.plane for plane in stack] == [0, 1, 2, 3]
        assert stack[2].shape == ("height", "width")
        assert stack[:2].shape == (2, "height", "width")
        assert stack[:2].memory is stack
        assert [plane.plane for plane in stack[2:]] == [2, 3]


def test_squares_have_single_precision_in_both() -> None:
    tau = 0.1234567891
    assert float(square_single(Number(tau, "tau"))) == float(square_single(tau)) == float(np.float32(tau) ** 2)


def test_numbers_are_the_same_only_if_their_expressions_are() -> None:
    first, second = Number(1.0, "a"), Number(1.0, "b")
    assert first != second
    assert first == Number(1.0, "a")
    assert first == 1.0
    assert len({first: 1, second: 2}) == 2
