"""WindowFilter on scenes whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from lobewise import WindowFilter, denoise
from lobewise.denoising.recipe import denoise_checked
from lobewise.errors import InputError
from lobewise.guides.usable import CheckedGuides
from lobewise.metrics import rel_mse
from lobewise.recipes.windows.averaging import Windowed, average_denoised
from lobewise.recipes.windows.joining import list_neighbours
from lobewise.records.frame import Frame, GBuffer, Radiance, Result
from lobewise.records.radiance import RadianceLayer
from tests.mistakes import refuses
from tests.temporal.scenes import SIZE, make_camera, make_frame

NOISE = 0.3
"""Relative variance of every sample's light."""
STILL = make_camera()


def make_still(count: int = 5, **options: object) -> list[Frame]:
    """Return frames of one camera that differ in their noise alone."""
    return [make_frame(STILL, STILL if k else None, noise=NOISE, seed=k, **options) for k in range(count)]


def make_moving(count: int = 5, **options: object) -> list[Frame]:
    """Return frames of a camera that moves and turns."""
    cameras = [make_camera(0.01 * k, 0.03 * k) for k in range(count)]
    return [
        make_frame(camera, cameras[max(k - 1, 0)], noise=NOISE, seed=k, **options) for k, camera in enumerate(cameras)
    ]


def make_truth(frame: Frame, **options: object) -> np.ndarray:
    return make_frame(frame.camera, **options).radiance.color


def split(frame: Frame) -> Frame:
    """Return a frame whose light is in two named layers, with light of two lamps beside it."""
    diffuse, specular = frame.radiance.parts or ()
    layers = (
        RadianceLayer("first", "diffuse", diffuse, frame.gbuffer.diffuse_albedo, parts={"lamp": 0.25 * diffuse}),
        RadianceLayer("second", "glossy", specular, frame.gbuffer.specular_albedo),
    )
    color = frame.radiance.color
    return frame.with_changes(layers=layers, also={"one": 0.3 * color, "two": 0.7 * color})


def join(frames: list[Frame], index: int = 2, reach: int = 2):
    return WindowFilter(reach).join(frames, index)


class TestJoining:
    def test_still_frames_become_their_mean(self):
        frames = make_still()
        joined = join(frames)
        assert tuple(joined.shown) == (-2, -1, 1, 2)
        assert joined.frames.mean() > 4.0
        ratio = rel_mse(joined.frame.radiance.color, make_truth(frames[2]))
        ratio /= rel_mse(frames[2].radiance.color, make_truth(frames[2]))
        assert ratio < 0.26
        assert joined.frame.spp == round(4 * float(np.median(joined.frames)))

    def test_a_moving_camera_is_followed(self):
        frames = make_moving()
        joined = join(frames)
        truth = make_truth(frames[2])
        assert rel_mse(joined.frame.radiance.color, truth) < 0.35 * rel_mse(frames[2].radiance.color, truth)
        # Samples keep to whole pixels, so the noise of neighbours stays independent.
        for part, share in ((joined.frame.radiance.diffuse, 0.4), (joined.frame.radiance.specular, 0.6)):
            noise = (part / (share * truth) - 1.0)[..., 0]
            assert abs(np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]) < 0.15

    def test_a_moving_card_is_followed_and_leaves_no_ghost(self):
        at = [-0.3 + 0.05 * k for k in range(5)]
        frames = [
            make_frame(STILL, STILL, card=at[k], card_before=at[max(k - 1, 0)], noise=NOISE, seed=k) for k in range(5)
        ]
        truth = make_frame(STILL, card=at[2]).radiance.color
        joined = join(frames).frame.radiance.color
        clean = join([f.with_changes(radiance=make_frame(STILL, card=at[k]).radiance) for k, f in enumerate(frames)])
        # Without noise every frame shows the same light at each point: what differs are ghosts.
        assert rel_mse(clean.frame.radiance.color, truth) < 2e-4
        assert rel_mse(joined, truth) < 0.4 * rel_mse(frames[2].radiance.color, truth)

    def test_light_that_changes_does_not_lag(self):
        frames = [make_frame(STILL, STILL, noise=NOISE, seed=k, light=1.0 if k < 3 else 4.0) for k in range(6)]
        for index in (2, 3):
            truth = make_frame(STILL, light=1.0 if index < 3 else 4.0).radiance.color
            joined = join(frames, index).frame.radiance.color
            assert abs(joined.mean() / truth.mean() - 1.0) < 0.06
            assert rel_mse(joined, truth) < 0.6 * rel_mse(frames[index].radiance.color, truth)

    def test_a_cut_ends_the_window(self):
        far = make_camera(0.0, 40.0)
        frames = [*make_still(3), *(make_frame(far, far, noise=NOISE, seed=9 + k) for k in range(2))]
        assert tuple(join(frames).shown) == (-2, -1)
        assert tuple(join(frames, 3).shown) == (1,)

    def test_frames_of_another_size_end_the_window(self):
        frames = make_still(3)
        small = Frame(Radiance(np.ones((8, 8, 3))), GBuffer(normal=np.broadcast_to((0.0, 0.0, 1.0), (8, 8, 3))))
        assert tuple(join([small, *frames], 1).shown) == (1, 2)

    def test_a_bad_pixel_is_taken_from_the_neighbours(self):
        frames = make_still()
        broken = frames[2].radiance
        images = {name: getattr(broken, name).copy() for name in ("color", "diffuse", "specular")}
        for image in images.values():
            image[20, 30] = np.nan
        frames[2] = frames[2].with_changes(radiance=Radiance(**images))
        joined = join(frames).frame.radiance
        truth = make_truth(frames[2])
        assert np.isfinite(joined.specular[20, 30]).all()
        assert abs(joined.diffuse[20, 30].mean() / (0.4 * truth[20, 30].mean()) - 1.0) < 1.0
        bad = WindowFilter(2, quality="fast").denoise(frames, 2).bad_pixels
        assert bad[20, 30]
        assert np.count_nonzero(bad) == 1

    def test_halves_keep_their_mean_and_stay_independent(self):
        pairs = [(make_still(5), [make_frame(STILL, STILL, noise=NOISE, seed=50 + k) for k in range(5)])][0]
        frames = []
        for a, b in zip(*pairs, strict=True):
            mean = Radiance(
                **{name: 0.5 * (getattr(a.radiance, name) + getattr(b.radiance, name)) for name in a.radiance.names}
            )
            frames.append(a.with_changes(radiance=mean, half_a=a.radiance, half_b=b.radiance, variance=None))
        joined = join(frames).frame
        mean = 0.5 * (joined.half_a.color + joined.half_b.color)
        np.testing.assert_allclose(mean, joined.radiance.color, rtol=1e-3, atol=1e-4)
        truth = make_truth(frames[2])
        correlation = np.corrcoef((joined.half_a.color - truth).ravel(), (joined.half_b.color - truth).ravel())[0, 1]
        assert abs(correlation) < 0.1

    def test_layers_parts_and_passes_keep_their_sums(self):
        shone = np.zeros((*SIZE, 3), np.float32)
        shone[4:8, 10:14] = 3.0
        frames = make_moving()
        lit = [replace(frame.radiance, color=frame.radiance.color + shone) for frame in frames]
        joined = join([split(frame.with_changes(radiance=each)) for frame, each in zip(frames, lit, strict=True)]).frame
        total = sum(layer.radiance for layer in joined.layers) + shone
        np.testing.assert_allclose(total, joined.radiance.color, rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(joined.layers[0].radiance, joined.radiance.diffuse, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(sum(joined.also.values()), joined.radiance.color, rtol=1e-3, atol=1e-4)
        lamp = joined.layers[0].parts["lamp"]
        np.testing.assert_allclose(lamp, 0.25 * joined.layers[0].radiance, rtol=1e-3, atol=1e-4)

    def test_color_alone_is_joined_too(self):
        frames = make_still(apart=False)
        truth = make_truth(frames[2])
        joined = join(frames).frame.radiance.color
        assert rel_mse(joined, truth) < 0.3 * rel_mse(frames[2].radiance.color, truth)

    def test_the_variance_falls_with_the_frames(self):
        frames = make_still()
        joined = join(frames)
        ratio = joined.frame.variance.diffuse.mean() / frames[2].variance.diffuse.mean()
        assert ratio == pytest.approx(0.2, abs=0.05)

    @pytest.mark.nightly
    def test_motion_vectors_alone_are_enough(self):
        frames = make_moving()
        bare = [
            frame.with_changes(camera=None, gbuffer=replace(frame.gbuffer, position=None, depth=None))
            for frame in frames
        ]
        truth = make_truth(frames[2])
        joined = join(bare)
        assert tuple(joined.shown) == (-2, -1, 1, 2)
        assert rel_mse(joined.frame.radiance.color, truth) < 0.5 * rel_mse(frames[2].radiance.color, truth)


class TestAveraging:
    """The mean of a frame and its neighbours, each denoised by itself."""

    @staticmethod
    def average(frames: list[Frame], index: int) -> tuple[Result, Result]:
        """Return the mean, and the frame denoised by itself."""
        window = WindowFilter(2, quality="balanced")
        shots = window._prepare(frames, range(len(frames)))
        alone = [
            Windowed(denoise_checked(CheckedGuides(shot.frame), window._settings), shot.whole_albedo)
            for shot in shots.values()
        ]
        others = [(near.shown, alone[number]) for number, near in list_neighbours(shots, index).items()]
        assert len(others) == len(frames) - 1
        return average_denoised(alone[index], others), alone[index].result

    @pytest.mark.parametrize(("make", "most"), [(make_still, 0.7), (make_moving, 0.9)])
    def test_it_has_less_error_than_the_frame(self, make, most):
        frames = make()
        truth = make_truth(frames[2])
        mean, alone = self.average(frames, 2)
        assert rel_mse(mean.image, truth) < most * rel_mse(alone.image, truth)

    def test_light_that_changes_counts_for_little(self):
        frames = make_still(3)
        bright = [replace(frame.radiance, color=4.0 * frame.radiance.color) for frame in frames]
        bright = [
            replace(each, diffuse=4.0 * frame.radiance.diffuse, specular=4.0 * frame.radiance.specular)
            for each, frame in zip(bright, frames, strict=True)
        ]
        changed = [frames[0].with_changes(radiance=bright[0], variance=None), frames[1].with_changes(variance=None)]
        mean, alone = self.average(changed, 1)
        assert mean.image.mean() == pytest.approx(alone.image.mean(), rel=0.03)

    def test_textures_are_not_blurred(self):
        """Light is carried from frame to frame; the texture is that of the frame."""
        frames = make_moving(3)
        shots = WindowFilter(1)._prepare(frames, range(3))
        results = {}
        for number, frame in enumerate(frames):
            squares = np.floor(9.0 * frame.gbuffer.position[..., ::2]).sum(axis=-1) % 2.0
            albedo = np.repeat(0.1 + 0.8 * squares[..., None], 3, axis=-1).astype(np.float32)
            image = (albedo * make_truth(frame)).astype(np.float32)
            results[number] = Windowed(replace(denoise(frame, radius=0), image=image, alpha=None), albedo)
        near = list_neighbours(shots, 1)
        pictures = {number: each._replace(albedo=None) for number, each in results.items()}
        errors = {
            name: rel_mse(
                average_denoised(each[1], [(near[number].shown, each[number]) for number in near]).image,
                results[1].result.image,
            )
            for name, each in (("light", results), ("pictures", pictures))
        }
        assert errors["light"] < 0.2 * errors["pictures"]

    def test_a_lamp_that_brightens_does_not_lag(self):
        """By less than the noise from frame to frame."""
        frames = [make_frame(STILL, STILL, light=1.06**k, noise=NOISE, seed=k) for k in range(3)]
        mean, alone = self.average(frames, 2)
        assert mean.image.mean() == pytest.approx(alone.image.mean(), rel=0.005)

    def test_images_keep_their_sums(self):
        frames = [split(frame) for frame in make_moving(3)]
        averaged, _ = self.average(frames, 1)
        np.testing.assert_allclose(sum(averaged.layers.values()), averaged.image, rtol=1e-3, atol=1e-4)
        assert set(averaged.also) == {"one", "two", "first/lamp"}


class TestFilter:
    def test_the_result_has_less_error_than_the_frame_alone(self):
        frames = make_moving()
        truth = make_truth(frames[2])
        window = WindowFilter(2, quality="balanced")
        result = window.denoise(frames, 2)
        windowed = window._prepared[id(frames[2])].windowed
        alone = window.denoise([frames[2]], 0)
        assert rel_mse(result.image, truth) < 0.9 * rel_mse(alone.image, truth)
        # The mean over time has less error than the denoised joined frame.
        assert rel_mse(result.image, truth) < 0.95 * rel_mse(windowed.result.image, truth)
        assert result.settings["window"] == 2
        assert result.settings["joined"] == (-2, -1, 1, 2)
        assert "motion" not in result.unused

    def test_named_layers_and_passes_are_filtered(self):
        result = WindowFilter(1, quality="balanced").denoise([split(frame) for frame in make_still(3)], 1)
        assert set(result.layers) == {"first", "second"}
        assert set(result.also) == {"one", "two", "first/lamp"}

    def test_the_opacity_is_averaged(self):
        rng = np.random.default_rng(0)
        frames = [frame.with_changes(alpha=rng.binomial(16, 0.5, SIZE) / 16.0) for frame in make_still(3)]
        result = WindowFilter(1, quality="balanced").denoise(frames, 1)
        alone = denoise(frames[1], quality="balanced").alpha
        assert result.settings["joined"] == (-1, 1)
        assert np.square(result.alpha - 0.5).mean() < 0.6 * np.square(alone - 0.5).mean()

    @pytest.mark.nightly
    def test_frames_are_prepared_once_and_let_go(self):
        frames = make_still(8)
        window = WindowFilter(1)
        first = [window.join(frames, index).frame.radiance.color for index in range(8)]
        again = [WindowFilter(1).join(frames[max(k - 2, 0) : k + 3], min(k, 2)).frame.radiance.color for k in range(8)]
        assert len(window._prepared) <= 3
        for one, other in zip(first, again, strict=True):
            assert np.array_equal(one, other)

    @pytest.mark.sampled("True")
    @pytest.mark.parametrize("past_only", [False, True])
    def test_a_part_of_the_sequence_gives_the_bits_of_the_whole(self, past_only):
        # The first frame has the motion of a camera that jumped, which no other frame tells.
        first = make_camera(0.0, 0.0)
        frames = [make_frame(first, make_camera(0.0, 0.1), noise=NOISE, seed=9), *make_moving(7)[1:]]
        whole = WindowFilter(1, quality="fast", past_only=past_only)
        # Frames that come one by one are not there before.
        streamed = [whole.denoise(frames[: k + 1] if past_only else frames, k).image for k in range(7)]
        assert len(whole._prepared) <= 5
        for k in range(7):
            after = 0 if past_only else 3
            part = frames[max(k - 3, 0) : k + after + 1]
            again = WindowFilter(1, quality="fast", past_only=past_only).denoise(part, min(k, 3))
            assert np.array_equal(again.image, streamed[k])
            assert again.settings["joined"] == tuple(n for n in (-1, 1) if 0 <= k + n < 7 and (n < 0 or not past_only))

    def test_a_single_frame_is_denoised_alone(self):
        frames = make_still(1)
        result = WindowFilter(2, quality="fast").denoise(frames, 0)
        assert result.settings["joined"] == ()
        assert not any("other frame" in note for note in result.notes)

    def test_frames_without_motion_and_camera_are_named(self):
        frames = [
            frame.with_changes(camera=None, gbuffer=replace(frame.gbuffer, position=None, depth=None, motion=None))
            for frame in make_still(3)
        ]
        result = WindowFilter(1, quality="fast").denoise(frames, 1)
        assert any("neither motion vectors nor a camera" in note for note in result.notes)

    def test_frames_of_one_seed_are_named_and_not_used(self):
        frames = [make_frame(STILL, STILL, noise=NOISE, seed=3) for _ in range(3)]
        window = WindowFilter(1, quality="fast")
        assert window.join(frames, 1).repeated == (-1, 1)
        result = window.denoise(frames, 1)
        assert result.settings["joined"] == ()
        assert any("same seed" in note for note in result.notes)
        mixed = [frames[0], make_frame(STILL, STILL, noise=NOISE, seed=4), *frames[1:]]
        result = window.denoise(mixed, 2)
        assert result.settings["joined"] == (-1,)
        assert any("same seed" in note for note in result.notes)

    def test_a_cut_on_both_sides_is_named(self):
        away = make_camera(0.0, 40.0)
        frames = [make_frame(away, away, noise=NOISE), *make_still(1), make_frame(away, away, noise=NOISE)]
        result = WindowFilter(1, quality="fast").denoise(frames, 1)
        assert any("none of them shows the surfaces" in note for note in result.notes)

    @pytest.mark.parametrize("reach", [0, -1, 9, 1.5, "2"])
    def test_a_reach_out_of_range_is_refused(self, reach):
        with refuses(InputError, "window"):
            WindowFilter(reach)

    def test_wrong_arguments_are_refused(self):
        with refuses(InputError, "index"):
            WindowFilter().join(make_still(2), 2)
        with refuses(InputError, "frame"):
            WindowFilter().join(["frame.exr"], 0)
        with refuses(InputError, "setting"):
            WindowFilter(2, colour=3)

    def test_frames_of_color_alone_are_denoised_by_themselves(self):
        frames = [Frame(Radiance(np.random.default_rng(k).random((*SIZE, 3)))) for k in range(3)]
        result = WindowFilter(1, quality="fast").denoise(frames, 1)
        assert any("neither motion vectors nor a camera" in note for note in result.notes)
        assert result.notes[-1].endswith("or positions and the camera.")
        np.testing.assert_array_equal(result.image, denoise(frames[1], quality="fast").image)


class TestReflections:
    @pytest.mark.parametrize(("alpha", "is_followed"), [(0.02, True), (0.3, False)])
    def test_only_sharp_reflections_leave_their_surface(self, alpha, is_followed):
        frames = []
        for frame in make_moving(3):
            guides = replace(frame.gbuffer, alpha_u=np.full(SIZE, alpha), hit_distance=np.full(SIZE, 2.0))
            frames.append(frame.with_changes(gbuffer=guides))
        window = WindowFilter(1)
        window.join(frames, 1)
        near = list_neighbours(window._prepare(frames, range(3)), 1)
        places = near[0].reflections
        assert np.isfinite(places).any() == is_followed
        if is_followed:
            # The virtual image lies as far below the floor as the hit lies above it, and moves less.
            apart = np.linalg.norm(places - near[0]._places, axis=-1)
            assert np.nanmedian(apart) > 0.1


class TestNotes:
    def test_still_frames_without_motion_vectors_are_named(self):
        frames = [f.with_changes(gbuffer=replace(f.gbuffer, motion=None)) for f in make_still(3)]
        result = WindowFilter(1, quality="fast").denoise(frames, 1)
        assert result.settings["joined"] == (-1, 1)
        assert any("no motion vectors" in note for note in result.notes)
        assert not any("no motion vectors" in note for note in WindowFilter(1).denoise(make_still(3), 1).notes)

    def test_the_first_frame_alone_may_lack_its_motion(self):
        first, *others = make_still(3)
        frames = [first.with_changes(gbuffer=replace(first.gbuffer, motion=None)), *others]
        result = WindowFilter(1, quality="fast").denoise(frames, 0)
        assert result.settings["joined"] == (1,)
        assert not any("no motion vectors" in note for note in result.notes)

    def test_unusable_guides_are_named_as_without_a_window(self):
        frames = []
        for frame in make_still(3):
            alpha = frame.gbuffer.alpha_u.copy()
            alpha[3, 3] = 7.0
            frames.append(frame.with_changes(gbuffer=replace(frame.gbuffer, alpha_u=alpha)))
        alone = denoise(frames[1], quality="fast").notes
        assert alone
        assert set(alone) <= set(WindowFilter(1, quality="fast").denoise(frames, 1).notes)

    def test_frames_of_another_size_are_named(self):
        small = Frame(Radiance(np.ones((8, 8, 3))), GBuffer(normal=np.broadcast_to((0.0, 0.0, 1.0), (8, 8, 3))))
        result = WindowFilter(1, quality="fast").denoise([small, *make_still(2)], 1)
        assert any("another size" in note for note in result.notes)

    def test_frames_with_other_guides_are_not_used(self):
        frames = make_still(3)
        frames[0] = frames[0].with_changes(radiance=Radiance(frames[0].radiance.color), variance=None)
        frames[2] = frames[2].with_changes(gbuffer=replace(frames[2].gbuffer, position=None, depth=None))
        result = WindowFilter(1, quality="fast").denoise(frames, 1)
        assert result.settings["joined"] == ()
        assert any("same guides" in note for note in result.notes)


class TestRobustness:
    def test_a_frame_beside_black_ones_is_joined_without_warnings(self):
        """A fade-in begins with black: pilots of other frames are then infinitely far from its noise."""
        frames = make_still(3)
        black = np.zeros_like(frames[0].radiance.color)
        frames[0] = frames[0].with_changes(radiance=Radiance(black, diffuse=black, specular=black))
        joined = join(frames, 0)
        assert joined.frame.radiance.color.max() < 1e-30

    def test_light_without_albedo_at_the_centre_is_not_blown_up(self):
        """At an edge of a texture the albedo of the centre may be 0 beside light of the pixel's other part."""
        frames = make_still()
        changed = []
        for k, frame in enumerate(frames):
            albedo = frame.gbuffer.specular_albedo.copy()
            if k == 2:
                albedo[20, 30] = 0.0
            changed.append(frame.with_changes(gbuffer=replace(frame.gbuffer, specular_albedo=albedo)))
        joined = join(changed).frame.radiance.color[20, 30]
        brightest = max(float(frame.radiance.color[20, 30].max()) for frame in frames)
        assert joined.max() < 1.5 * brightest

    def test_a_firefly_of_another_frame_is_bounded(self):
        frames = make_still()
        spoilt = frames[1].radiance
        images = {name: getattr(spoilt, name).copy() for name in ("color", "diffuse", "specular")}
        for name in ("color", "diffuse"):
            images[name][20, 30] += 1000.0
        frames[1] = frames[1].with_changes(radiance=Radiance(**images))
        joined = join(frames).frame.radiance.color[20, 30]
        assert joined.max() < 5.0


MEANINGS = {
    "negated: --map motion=PASS:negate": (-1.0, -1.0),
    "with y upwards: --map motion=PASS:y_up": (1.0, -1.0),
    "shares of the image's size: multiply x by {width} and y by {height}": (1.0 / SIZE[1], 1.0 / SIZE[0]),
    "shares of half the image's size: multiply x by -{half} and": (-2.0 / SIZE[1], 2.0 / SIZE[0]),
}


@pytest.mark.sampled(*list(MEANINGS)[:2])
@pytest.mark.parametrize("meaning", MEANINGS)
def test_motion_vectors_that_contradict_the_cameras_are_named(meaning: str) -> None:
    still, step = make_camera(), np.array([0.06, 0.06, 0.0])
    cameras = [replace(still, position=still.position + k * step) for k in range(3)]
    frames = [make_frame(camera, cameras[max(k - 1, 0)], noise=NOISE, seed=k) for k, camera in enumerate(cameras)]
    assert not any("contradict" in note for note in WindowFilter(1, quality="fast").denoise(frames, 1).notes)
    scale = np.array(MEANINGS[meaning], np.float32)
    wrong = [f.with_changes(gbuffer=replace(f.gbuffer, motion=f.gbuffer.motion * scale)) for f in frames]
    told = [note for note in WindowFilter(1, quality="fast").denoise(wrong, 1).notes if "contradict" in note]
    words = meaning.format(width=SIZE[1], height=SIZE[0], half=SIZE[1] // 2)
    assert len(told) == 1
    assert words in told[0]


def test_motion_of_things_themselves_contradicts_no_camera() -> None:
    """Nor does the motion of a camera that stands still, which says nothing."""
    cameras = [make_camera(0.01 * k, 0.03 * k) for k in range(3)]
    at = [-0.3 + 0.3 * k for k in range(3)]
    moving = [
        make_frame(c, cameras[max(k - 1, 0)], card=at[k], card_before=at[max(k - 1, 0)], noise=NOISE, seed=k)
        for k, c in enumerate(cameras)
    ]
    for frames in (moving, make_still(3)):
        assert not any("contradict" in note for note in WindowFilter(1, quality="fast").denoise(frames, 1).notes)
