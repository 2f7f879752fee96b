"""TemporalFilter against what must hold over time, on scenes whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from lobewise import TemporalFilter
from lobewise.denoising import denoise
from lobewise.errors import InputError
from lobewise.features import ScreenFeature
from lobewise.filters.history.sums import split_sums
from lobewise.metrics import find_disoccluded, rel_mse
from lobewise.recipes.adaptive import find_unsupported, recompute
from lobewise.recipes.upsampling import upsample
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import SparseFrame, list_places, make_sparse
from tests.denoising.test_upsampling import make_lit_frame
from tests.mistakes import refuses
from tests.temporal.scenes import make_camera, make_frame

NOISE = 0.5
"""Relative variance of a sample: that of some ten paths."""
STILL = make_camera()


def make_still(count: int, scale: int = 1, **options) -> list:
    """Return frames of one camera that differ in their noise alone, sparse ones at the places of their turn."""
    frames = [make_frame(STILL, STILL if k else None, noise=NOISE, seed=k, **options) for k in range(count)]
    if scale == 1:
        return frames
    places = list_places(scale)
    return [make_sparse(frame, scale, places[k % len(places)]) for k, frame in enumerate(frames)]


def compute_truth(**options) -> np.ndarray:
    return make_frame(STILL, **options).radiance.color


def run(frames, **settings):
    active = TemporalFilter(**settings)
    return [active.add(frame) for frame in frames]


def start(frames, **settings):
    """Return a filter that has seen some frames."""
    active = TemporalFilter(**settings)
    for frame in frames:
        active.add(frame)
    return active


def assert_same(a, b) -> None:
    """Two results have the same bits."""
    for name in ("image", "diffuse", "specular", "weight_sum", "effective_samples", "variance", "bad_pixels"):
        first, second = getattr(a, name), getattr(b, name)
        assert (first is None) == (second is None)
        assert first is None or np.array_equal(first, second), name


class TestStill:
    @pytest.mark.nightly
    @pytest.mark.parametrize("scale", [2, 3, 4])
    def test_without_noise_it_becomes_what_full_resolution_would_be(self, scale):
        rng = np.random.default_rng(7)
        frame = make_frame(STILL)
        # Detail at every pixel, which no neighbour tells anything of.
        texture = rng.uniform(0.1, 1.0, (*frame.shape, 3)).astype(np.float32)
        lit = Radiance(2.0 * texture + 0.1, diffuse=texture, specular=texture)  # 0.1 is emission
        still = np.zeros_like(texture)
        frame = replace(frame, radiance=lit, variance=Radiance(still, diffuse=still, specular=still))
        active = TemporalFilter()
        for place in list_places(scale):
            result = active.add(make_sparse(frame, scale, place))
        assert np.abs(result.image / lit.color - 1.0).max() < 1e-3
        assert np.abs(upsample(make_sparse(frame, scale)).image / lit.color - 1.0).max() > 0.1

    @pytest.mark.sampled("turning")
    @pytest.mark.parametrize("moving", [False, True], ids=["still", "turning"])
    def test_a_background_is_known_again(self, moving):
        rng = np.random.default_rng(3)
        above = np.arange(48) < 20  # rows of sky over the floor, as detailed as it can be
        texture = rng.uniform(0.1, 1.0, (48, 200, 3)).astype(np.float32)
        active = TemporalFilter()
        angle = make_camera().get_pixel_angle(48)
        for k in range(16):
            # The sky is infinitely far and moves by whole pixels, as the middle row does when the camera turns.
            camera = make_camera(turn=4 * angle * k if moving else 0.0)
            frame = make_frame(camera)
            motion = np.zeros((*frame.shape, 2), np.float32)
            motion[..., 0] = 4.0 if moving else 0.0
            sky = np.where(above[:, None, None], texture[:, 4 * k : 4 * k + 64] if moving else texture[:, :64], 0.0)
            diffuse, specular = (
                np.where(above[:, None, None], 0.0, p) for p in (frame.radiance.diffuse, frame.radiance.specular)
            )
            guides = replace(
                frame.gbuffer,
                depth=np.where(above[:, None], 0.0, frame.gbuffer.depth),
                normal=np.where(above[:, None, None], 0.0, frame.gbuffer.normal),
                motion=motion if k else None,
            )
            dark = np.zeros_like(sky)
            frame = replace(
                frame,
                radiance=Radiance(sky + diffuse + specular, diffuse=diffuse, specular=specular),
                gbuffer=guides,
                variance=Radiance(dark, diffuse=dark, specular=dark),
            )
            result = active.add(make_sparse(frame, 4, list_places(4)[k]))
        # What came into view since is not known yet.
        known = np.s_[:20, : 64 - 4 * 15] if moving else np.s_[:20]
        error = np.abs(result.image[known] - sky[known])
        assert error.max() < 1e-3

    @pytest.mark.parametrize("scale", [1, 4])
    @pytest.mark.nightly
    def test_noise_falls_as_frames_are_added(self, scale):
        errors = [rel_mse(result.image, compute_truth()) for result in run(make_still(16, scale))]
        assert errors[15] < 0.4 * errors[0]
        assert errors[15] < errors[3] < errors[0]

    def test_the_first_frame_is_that_of_the_recipe_without_time(self):
        for frame, alone in ((make_still(1)[0], denoise), (make_still(1, 4)[0], upsample)):
            own = TemporalFilter().add(frame)
            expected = alone(frame, quality="fast").image
            # A pixel's own sample counts a little more over time.
            assert np.abs(own.image - expected).max() < 0.02 * expected.max()

    def test_no_memory_is_the_first_frame_again_and_again(self):
        frames = make_still(3, 4)
        active = TemporalFilter(memory=0.0, strictness=0.0)
        for frame in frames:
            assert np.abs(active.add(frame).image - TemporalFilter().add(frame).image).max() < 1e-5

    def test_a_constant_stays_that_constant(self):
        frame = make_frame(STILL)
        flat = np.full_like(frame.radiance.color, 0.5)
        frame = replace(frame, radiance=Radiance(2.0 * flat, diffuse=flat, specular=flat))
        for result in run([make_sparse(frame, 4, place) for place in list_places(4)[:6]]):
            assert np.abs(result.image - 1.0).max() < 1e-5

    def test_light_on_pixels_that_reflect_none_is_left_out_and_changes_no_other_pixel(self):
        frames = make_still(4, 4)
        black = np.zeros((48, 64), bool)
        black[10:30, 20:50] = True

        def blacken(frame):
            albedo = np.where(black[..., None], np.float32(0.0), frame.gbuffer.specular_albedo)
            specular = np.where(black[frame.shaded][..., None], np.float32(0.0), frame.radiance.specular)
            light = Radiance(frame.radiance.diffuse + specular, diffuse=frame.radiance.diffuse, specular=specular)
            return replace(frame, radiance=light, gbuffer=replace(frame.gbuffer, specular_albedo=albedo))

        active = TemporalFilter()
        results = [active.add(blacken(frame)) for frame in frames]
        assert (results[3].specular[black] == 0.0).all()
        # Nothing is gathered there.
        sums = active.get_state()["sums/specular"]
        assert (sums[black] == 0.0).all()
        assert (sums[~black] > 0.0).any()
        assert (results[3].diffuse[black] > 0.0).any()
        assert np.isfinite(results[3].image).all()
        assert results[3].settings["history_share"] == 1.0

    def test_a_changed_history_is_what_the_next_frame_joins(self):
        frames = make_still(3, 4)
        changed, other = TemporalFilter(), TemporalFilter()
        for active in (changed, other):
            active.change_sums({"diffuse": lambda sums: 2.0 * sums})  # There is no history yet.
            active.add(frames[0])
        changed.change_sums({"diffuse": np.zeros_like, "specular": np.zeros_like, "mist": np.zeros_like})
        assert_same(changed.add(frames[1]), TemporalFilter().add(frames[1]))
        with refuses(InputError, "history of diffuse"):
            other.change_sums({"specular": np.zeros_like, "diffuse": lambda sums: sums[1:]})
        assert (other.history_length > 0.0).any()

    def test_results_stay_as_they_are_while_memory_is_used_again(self):
        active, kept = TemporalFilter(), []
        for frame in make_still(6, 4):
            result = active.add(frame)
            kept.append((result, result.image.copy(), result.weight_sum.copy(), result.variance.copy()))
        for result, *copies in kept:
            for found, copied in zip((result.image, result.weight_sum, result.variance), copies, strict=True):
                assert found.tobytes() == copied.tobytes()

    def test_samples_of_shared_pixels_are_those_of_their_area(self):
        frame = make_still(1, 4)[0]
        guides = frame.gbuffer
        mean = 0.5 * guides.diffuse_albedo
        shared = {"mean_diffuse_albedo": mean, "mean_specular_albedo": guides.specular_albedo}
        cover = np.zeros((*frame.shape, 9), np.float32)
        cover[..., 4] = 1.0
        active, plain = TemporalFilter(), TemporalFilter()
        active.add(replace(frame, gbuffer=replace(guides, coverage=cover, **shared)))
        plain.add(frame)
        light = Radiance(np.full((1, 1, 3), 0.8), diffuse=np.full((1, 1, 3), 0.5), specular=np.full((1, 1, 3), 0.3))
        gained = []
        for each in (active, plain):
            before = each.get_state()["sums/diffuse"]
            each.add_samples(np.array([3]), np.array([3]), light, np.ones(1, np.float32))
            gained.append((each.get_state()["sums/diffuse"] - before)[3, 3, 0])
        # Half of the albedo makes twice the light of the same radiance.
        assert gained[0] == pytest.approx(2.0 * gained[1], rel=1e-4)

    @pytest.mark.parametrize(
        ("settings", "radius", "share"),
        [
            ({}, 2, 0.4),
            ({"history_radius": 3}, 3, 0.6),
            ({"radius": 1}, 1, 1.0),
            ({"radius": 0}, 0, 1.0),
            ({"screen_sigma": 6.0}, 2, 1.0),
        ],
    )
    def test_the_automatic_screen_distance_shrinks_with_the_radius(self, settings, radius, share):
        active, frame = TemporalFilter(**settings), make_still(1, 4)[0]
        chosen = active._resolve(frame)
        known = active._plan(frame, chosen).known
        assert known.radius == radius
        assert known.sigma == pytest.approx(share * chosen.screen_sigma)

    def test_variance_tells_the_error(self):
        truth = compute_truth()
        results = run(make_still(12))
        luminance = np.array([0.2126, 0.7152, 0.0722])
        squared = [float(np.mean(((result.image - truth) @ luminance) ** 2)) for result in results]
        told = [float(result.variance.mean()) for result in results]
        # The samples of a window differ in more than noise, and the kernel's bias is in the error: an estimate.
        for k in (0, 3, 11):
            assert 0.2 < told[k] / squared[k] < 5.0
        assert told[11] < told[0]

    def test_support_grows(self):
        # A narrower kernel would gather less in later frames.
        results = run(make_still(5, 4), history_radius=5)
        assert (results[4].effective_samples.mean() > 2.0 * results[0].effective_samples.mean()).all()
        assert results[0].settings["history_share"] == 0.0
        assert results[4].settings["history_share"] == 1.0


class TestMotion:
    @pytest.mark.sampled("camera-4", "vectors-1")
    @pytest.mark.parametrize("scale", [1, 4])
    @pytest.mark.parametrize("motion", [True, False], ids=["vectors", "camera"])
    def test_a_moving_camera_keeps_its_history(self, scale, motion):
        cameras = [make_camera(turn=0.004 * k, shift=0.01 * k) for k in range(12)]
        active = TemporalFilter()
        for k, camera in enumerate(cameras):
            before = cameras[k - 1] if k else None
            frame = make_frame(camera, before, noise=NOISE, seed=k, motion=motion)
            frame = frame if scale == 1 else make_sparse(frame, scale, list_places(scale)[k % 16])
            result = active.add(frame)
        truth = make_frame(cameras[-1]).radiance.color
        alone = TemporalFilter().add(frame)
        assert result.settings["history_share"] > 0.9
        assert rel_mse(result.image, truth) < 0.5 * rel_mse(alone.image, truth)

    @pytest.mark.nightly
    def test_nothing_tells_where_things_were(self):
        frames = [replace(frame, camera=None, gbuffer=replace(frame.gbuffer, motion=None)) for frame in make_still(3)]
        results = run(frames, similarity="normal")
        assert [result.settings["history_share"] for result in results] == [0.0, 0.0, 0.0]
        assert_same(results[2], TemporalFilter(similarity="normal").add(frames[2]))

    def test_motion_vectors_do_without_a_camera(self):
        cameras = [make_camera(shift=0.1 * k) for k in range(6)]
        frames = [make_frame(camera, cameras[max(k - 1, 0)], noise=NOISE, seed=k) for k, camera in enumerate(cameras)]
        results = run([replace(frame, camera=None) for frame in frames], similarity="normal")
        truth = make_frame(cameras[5]).radiance.color
        alone = TemporalFilter(similarity="normal").add(replace(frames[5], camera=None))
        assert results[5].settings["history_share"] > 0.9
        assert rel_mse(results[5].image, truth) < 0.8 * rel_mse(alone.image, truth)

    @pytest.mark.parametrize("nothing", [np.inf, np.nan, -1.0])
    def test_guides_without_a_surface_may_hold_anything(self, nothing):
        cameras = [STILL, make_camera(shift=0.02)]
        active = TemporalFilter()
        for k, camera in enumerate(cameras):
            frame = make_frame(camera, noise=NOISE, seed=k)
            holes = {}
            for name in ("depth", "position", "normal", "alpha_u"):
                image = np.array(getattr(frame.gbuffer, name))
                image[:10] = nothing
                holes[name] = image
            distance = np.full(frame.shape, 2.0, np.float32)
            distance[20:24] = np.array([np.nan, -1.0, np.inf, 0.0])[:, None]
            guides = replace(frame.gbuffer, **holes, hit_distance=distance)
            result = active.add(make_sparse(replace(frame, gbuffer=guides), 4))
        assert np.isfinite(result.image).all()
        assert np.isfinite(result.variance).all()
        assert result.settings["history_share"] > 0.7

    def test_places_that_are_no_numbers_have_no_history(self):
        frames = make_still(2)
        broken = np.zeros((*frames[0].shape, 2), np.float32)
        broken[:24] = np.nan
        broken[0, 0] = np.inf
        frames[1] = replace(frames[1], gbuffer=replace(frames[1].gbuffer, motion=broken))
        result = run(frames)[1]
        assert np.isfinite(result.image).all()
        assert result.settings["history_share"] == pytest.approx(0.5, abs=0.01)


class TestGhosts:
    STEP = 0.06
    """World units a frame: about two pixels."""

    @pytest.mark.sampled("4")
    @pytest.mark.parametrize("scale", [1, 4])
    def test_what_a_card_uncovers_has_no_trail(self, scale):
        ratios = []
        for seed in range(4):
            active = TemporalFilter()
            frames = []
            for k in range(10):
                place = self.STEP * (k - 4)
                frame = make_frame(
                    STILL,
                    STILL if k else None,
                    card=place,
                    card_before=place - self.STEP,
                    noise=NOISE,
                    seed=100 * seed + k,
                )
                frames.append(frame if scale == 1 else make_sparse(frame, scale, list_places(scale)[k]))
                result = active.add(frames[-1])
            old, older = frames[-3], frames[-4]
            uncovered = find_disoccluded(old.gbuffer, STILL, older.gbuffer, STILL)
            uncovered &= old.gbuffer.alpha_u == frames[-1].gbuffer.alpha_u
            assert 10 < np.count_nonzero(uncovered) < 400
            truth = make_frame(STILL, card=self.STEP * 5).radiance.color
            alone = TemporalFilter().add(frames[-1])
            ratios.append(rel_mse(result.image, truth, uncovered) / rel_mse(alone.image, truth, uncovered))
        assert np.mean(ratios) < 1.3

    @pytest.mark.parametrize("scale", [1, 4])
    def test_a_light_that_goes_out_leaves_no_trail(self, scale):
        frames = [
            make_frame(STILL, STILL if k else None, light=1.0 if k < 8 else 0.1, noise=NOISE, seed=k) for k in range(11)
        ]
        if scale > 1:
            frames = [make_sparse(frame, scale, list_places(scale)[k]) for k, frame in enumerate(frames)]
        truth = compute_truth(light=0.1)
        last = run(frames)[-1]
        assert rel_mse(last.image, truth) < 1.3 * rel_mse(TemporalFilter().add(frames[-1]).image, truth)

    def test_noise_alone_is_not_taken_for_a_change(self):
        results = run(make_still(16))
        # Twenty frames are what 0.95 can hold; what sixteen hold of them if all is kept is 11.2.
        gained = results[-1].effective_samples.mean() / results[0].effective_samples.mean()
        assert gained > 4.0


class TestCuts:
    def test_a_cut_is_a_fresh_start(self):
        *frames, last = make_still(4, 4)
        assert_same(start(frames).add(last, cut=True), TemporalFilter().add(last))

    @pytest.mark.parametrize("vectors", [True, False], ids=["vectors", "camera"])
    def test_an_unannounced_cut_is_one_too(self, vectors):
        far = make_camera(turn=2.8, shift=30.0)
        after = make_frame(far, STILL if vectors else None, noise=NOISE, seed=9)
        after = make_sparse(after, 4, (1, 2))
        assert_same(start(make_still(3, 4)).add(after), TemporalFilter().add(after))

    def test_the_same_floor_in_another_shot_is_one_too(self):
        # Nearly all of the floor is in both pictures, but nothing where it was; the second frame must not remember.
        after = [make_camera(turn=2.2 + 0.01 * k, shift=3.5) for k in range(2)]
        frames = [make_frame(after[0], STILL, noise=NOISE, seed=8), make_frame(after[1], after[0], noise=NOISE, seed=9)]
        active, fresh = start(make_still(3)), TemporalFilter()
        for frame in frames:
            assert_same(active.add(frame), fresh.add(frame))

    @pytest.mark.parametrize(("share", "is_cut"), [(0.3, True), (0.6, False)])
    def test_little_that_goes_on_is_not_remembered_over_a_cut(self, share, is_cut):
        before, after = make_still(2)
        position = after.gbuffer.position.copy()
        position[:, round(share * position.shape[1]) :] += np.float32(50.0)
        after = after.with_changes(gbuffer=replace(after.gbuffer, position=position))
        result, fresh = start([before]).add(after), TemporalFilter().add(after)
        assert result.settings["history_share"] == pytest.approx(0.0 if is_cut else share, abs=0.1)
        assert np.array_equal(result.image, fresh.image) is is_cut

    def test_another_size_is_one_too(self):
        active = start(make_still(1))
        small = make_sparse(make_still(1)[0], 2)
        crop = GBuffer(
            **{
                name: getattr(small.gbuffer, name)[::2, ::2]
                for name in ("depth", "position", "normal", "alpha_u", "diffuse_albedo", "specular_albedo")
            }
        )
        frame = Frame(small.radiance, crop, STILL, variance=small.variance, spp=4)
        assert_same(active.add(frame), TemporalFilter().add(frame))

    def test_another_scale_is_none(self):
        finer = make_sparse(make_frame(STILL, STILL, noise=NOISE, seed=77), 2)
        assert start(make_still(4, 4)).add(finer).settings["history_share"] == 1.0

    def test_reset_forgets(self):
        first, second = make_still(2)
        active = start([first])
        active.reset()
        assert_same(active.add(second), TemporalFilter().add(second))


class TestState:
    @pytest.mark.parametrize("scale", [1, 4])
    def test_a_sequence_goes_on_from_its_state(self, scale):
        cameras = [make_camera(shift=0.02 * k) for k in range(5)]
        frames = []
        for k, camera in enumerate(cameras):
            card = {"card": 0.1 * k, "card_before": 0.1 * (k - 1)}  # moves by itself, which the history allows for
            frames.append(make_frame(camera, cameras[k - 1] if k else None, noise=NOISE, seed=k, **card))
        if scale > 1:
            frames = [make_sparse(frame, scale, list_places(scale)[k]) for k, frame in enumerate(frames)]
        whole = run(frames)
        state = {name: np.array(value) for name, value in start(frames[:3]).get_state().items()}
        third = TemporalFilter()
        third.set_state(state)
        for k in (3, 4):
            assert_same(third.add(frames[k]), whole[k])

    def test_the_state_of_a_new_filter_is_that_of_a_new_filter(self):
        assert TemporalFilter().get_state() == {}
        active = start(make_still(1))
        active.set_state({})
        assert active.get_state() == {}

    def test_it_does_not_grow(self):
        active = TemporalFilter()
        sizes = []
        for frame in make_still(5):
            active.add(frame)
            sizes.append(sum(value.nbytes for value in active.get_state().values()))
        assert sizes[1] == sizes[4]

    def test_a_state_of_something_else_is_refused(self):
        with refuses(InputError, "state"):
            TemporalFilter().set_state({"similarity": np.array("ggx")})

    def test_a_failed_frame_leaves_the_history_as_it_was(self):
        frames = make_still(3)
        active, other = start(frames[:2]), start(frames[:2])
        bad = np.full_like(frames[2].radiance.color, np.nan)
        with pytest.raises(InputError):
            active.add(replace(frames[2], radiance=Radiance(bad)))
        assert_same(active.add(frames[2]), other.add(frames[2]))


class TestSettings:
    @pytest.mark.nightly  # every kernel is compiled
    @pytest.mark.parametrize("similarity", ["normal", "sg", "sg_mixture", "ggx"])
    def test_every_similarity_works(self, similarity):
        frames = make_still(6, 4)
        results = run(frames, similarity=similarity)
        assert results[-1].settings["history_share"] == 1.0
        assert rel_mse(results[-1].image, compute_truth()) < rel_mse(results[0].image, compute_truth())

    @pytest.mark.nightly
    @pytest.mark.parametrize("form", ["full", "separable", "atrous"])
    def test_every_form_works(self, form):
        results = run(make_still(6), form=form)
        assert rel_mse(results[-1].image, compute_truth()) < rel_mse(results[0].image, compute_truth())

    def test_radiance_that_is_not_apart(self):
        results = run(make_still(6, apart=False))
        assert results[-1].diffuse is None
        assert rel_mse(results[-1].image, compute_truth()) < 0.6 * rel_mse(results[0].image, compute_truth())

    @pytest.mark.nightly
    def test_features_of_ones_own(self):
        active = TemporalFilter()
        narrow = [active.add(frame, features=[ScreenFeature(0.3)]) for frame in make_still(2)]
        assert narrow[0].effective_samples.mean() < run(make_still(1))[0].effective_samples.mean()

    def test_bad_pixels_are_filled_and_leave_no_trace(self):
        frames = make_still(4)
        broken = np.array(frames[2].radiance.color)
        broken[10, 10:13] = [[np.nan], [np.inf], [-100.0]]
        frames[2] = replace(frames[2], radiance=replace(frames[2].radiance, color=broken, diffuse=broken))
        results = run(frames)
        assert results[2].bad_pixel_count == 3
        for result in results:
            assert np.isfinite(result.image).all()
            assert (result.image >= 0.0).all()

    @pytest.mark.parametrize(
        ("name", "value"), [("memory", 1.5), ("memory", -0.1), ("plane_sigma", 0.0), ("strictness", np.nan)]
    )
    def test_numbers_out_of_range(self, name, value):
        with refuses(InputError, name):
            TemporalFilter(**{name: value})

    def test_unknown_setting(self):
        with refuses(InputError, "setting"):
            TemporalFilter(memry=0.9)

    def test_upsampling_has_one_form(self):
        with refuses(InputError, "form"):
            TemporalFilter(form="atrous").add(make_still(1, 4)[0])

    def test_sparse_and_whole_frames_may_follow_each_other(self):
        active = TemporalFilter()
        for k, frame in enumerate(make_still(4)):
            result = active.add(frame if k % 2 else make_sparse(frame, 4))
        assert isinstance(make_sparse(frame, 4), SparseFrame)
        assert result.settings["history_share"] == 1.0


class TestAddedSamples:
    def test_a_pixel_that_was_shaded_again_keeps_its_light(self, rng):
        frame, _ = make_lit_frame(rng)
        sparse = make_sparse(frame, 4, (1, 2))
        rows, columns = np.array([15, 16, 30]), np.array([20, 21, 40])
        parts = {name: np.full((3, 1, 3), 9.0, np.float32) for name in ("diffuse", "specular")}
        light = Radiance(parts["diffuse"] + parts["specular"], **parts)
        images = []
        for weight in (0.0, 1e6):
            temporal = start([sparse])
            state = temporal.get_state()
            before = {name: np.array(image) for name, image in state.items()}
            temporal.add_samples(rows, columns, light, np.full(3, weight, np.float32))
            assert all(state[name].tobytes() == image.tobytes() for name, image in before.items())
            sums = split_sums(temporal._past.sums["specular"])
            albedo = frame.gbuffer.specular_albedo
            divisor = 1.0 if albedo is None else albedo[rows, columns, 0]
            mean = sums.red[rows, columns] / sums.weight[rows, columns]
            assert np.allclose(mean, 9.0 / divisor, rtol=1e-3) == (weight > 0.0)
            images.append(temporal.add(sparse).image)
        elsewhere = np.ones(images[0].shape[:2], bool)
        elsewhere[13:19, 18:24] = elsewhere[28:33, 38:43] = False
        np.testing.assert_allclose(images[0][elsewhere], images[1][elsewhere], rtol=1e-4)

    def test_what_shades_again_tells_the_history(self, rng):
        frame, _ = make_lit_frame(rng)
        sparse = make_sparse(frame, 4, (1, 2))
        temporal = TemporalFilter()
        result = temporal.add(sparse)
        before = split_sums(np.array(temporal._past.sums["specular"])).weight

        def shade(y, x):
            return Radiance(
                *(getattr(frame.radiance, each)[y, x][:, None] for each in ("color", "diffuse", "specular"))
            )

        recompute(result, shade, samples=2.0, frame=sparse, history=temporal)
        chosen = find_unsupported(result, frame=sparse)
        grown = split_sums(temporal._past.sums["specular"]).weight > before
        assert grown[chosen].all()
        assert not grown[~chosen].any()

    def test_pixels_lie_in_the_frame(self, rng):
        frame, _ = make_lit_frame(rng)
        temporal = start([make_sparse(frame, 4)])
        ones = np.ones((1, 1, 3), np.float32)
        for row, column in ((-1, 0), (0, frame.width)):
            with refuses(InputError, "pixels"):
                temporal.add_samples(
                    np.array([row]), np.array([column]), Radiance(2 * ones, ones, ones), np.ones(1, np.float32)
                )

    def test_there_must_be_a_frame_and_all_parts(self):
        light, where = Radiance(np.full((1, 1, 3), 0.8)), (np.array([3]), np.array([4]))
        with refuses(InputError, "history"):
            TemporalFilter().add_samples(*where, light, np.ones(1, np.float32))
        temporal = start(make_still(1, 4))
        before = {name: np.copy(value) for name, value in temporal.get_state().items()}
        lacking_one = replace(light, diffuse=light.color)
        for got, lacking in (("Radiance(1x1: color)", light), ("Radiance(1x1: color, diffuse)", lacking_one)):
            with refuses(InputError, "radiance", got):
                temporal.add_samples(*where, lacking, np.ones(1, np.float32))
        for name, value in temporal.get_state().items():
            assert value.tobytes() == before[name].tobytes(), name


class TestLightWithoutNoise:
    def test_emission_of_samples_is_averaged_with_that_of_the_guides(self, rng):
        frame, emission = make_lit_frame(rng)
        noisy = replace(frame.radiance, color=frame.radiance.color + emission)
        frame = frame.with_changes(radiance=noisy, spp=4)
        image = TemporalFilter(similarity="normal").add(frame).image
        lamp = np.s_[21:24, 31:36]
        # Sixteen rays of the guides count beside four samples, which hit the lamp twice as often as they should.
        assert (np.abs(image - 1.2 * emission)[lamp] < 1.5).all()

    def test_a_frame_of_sky_alone_is_no_cut(self, rng):
        frame, _ = make_lit_frame(rng)
        nothing = {name: np.zeros_like(getattr(frame.gbuffer, name)) for name in ("depth", "normal", "position")}
        dark = np.zeros_like(frame.radiance.color)
        light = Radiance(dark + 0.5, dark, dark)
        guides = replace(frame.gbuffer, **nothing, mean_emission=dark + np.float32(0.5))
        sky = make_sparse(frame.with_changes(gbuffer=guides, radiance=light), 4)
        temporal = TemporalFilter()
        for _ in range(2):
            result = temporal.add(sky)
        assert result.settings["history_share"] == 1.0
        np.testing.assert_array_equal(result.image, 0.5)
