"""How resolution follows the time of frames."""

import pytest

from lobewise.viewer.browser import STEPS, TARGET, Pace, fit_size


def simulate(full_seconds: float, frames: int = 40) -> list[float]:
    """Return the factors of frames whose time goes with their pixels."""
    pace, factors = Pace(), []
    for _ in range(frames):
        factors.append(pace.factor)
        pace.add(full_seconds * pace.factor**2, pace.factor)
    return factors


class TestPace:
    def test_fast_frames_keep_all_pixels(self):
        assert set(simulate(0.9 * TARGET)) == {1.0}

    @pytest.mark.parametrize("times", [1.2, 1.5, 2.5, 3.9])
    def test_slow_frames_end_within_the_target(self, times):
        factors = simulate(times * TARGET)
        assert times * factors[-1] ** 2 <= 1.0
        # It comes to rest, and no lower than needed by more than a step.
        assert len(set(factors[-20:])) == 1
        assert factors[-1] == 1.0 or times * STEPS[STEPS.index(factors[-1]) - 1] ** 2 > 0.6

    def test_never_below_half(self):
        assert min(simulate(1000.0 * TARGET)) == STEPS[-1] == 0.5

    @pytest.mark.parametrize("times", [[10.0] * 6 + [0.01] * 10, [0.1, 0.1, 1.5]])
    def test_it_goes_up_again_and_forgives_one_slow_frame(self, times):
        pace = Pace()
        for time in times:
            pace.add(time * TARGET, pace.factor)
        assert pace.factor == 1.0

    def test_a_fixed_size_stays(self):
        pace = Pace(fixed=True)
        pace.add(100.0, 1.0)
        pace.add(100.0, 1.0)
        assert pace.factor == 1.0

    def test_frames_of_another_size_tell_nothing(self):
        pace = Pace()
        pace.add(100.0, 0.5)
        assert pace.factor == 1.0


@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.7778, 3.0])
@pytest.mark.parametrize("factor", STEPS)
def test_sizes_are_multiples_of_eight_with_aspect_and_count(aspect, factor):
    width, height = fit_size(512 * 512, aspect, factor)
    assert width % 8 == height % 8 == 0
    assert width / height == pytest.approx(aspect, rel=0.08)
    assert width * height == pytest.approx((512 * factor) ** 2, rel=0.08)
