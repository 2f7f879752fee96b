"""The recipe of windows in time: the samples of frames are joined, each frame is denoised, the images are averaged."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING
from weakref import ref

from lobewise.denoising.automatic import change_settings, choose_similarity
from lobewise.denoising.bad_pixels import mark_bad_pixels
from lobewise.denoising.plan import count_bytes
from lobewise.denoising.recipe import check_frame, denoise_checked, filter_below
from lobewise.errors import MAX_GOT_LETTERS, InputError, name_value, require_kind
from lobewise.guides.negative import split_negative
from lobewise.guides.usable import CheckedGuides
from lobewise.recipes.windows.averaging import Windowed, average_denoised
from lobewise.recipes.windows.gathering import Shown
from lobewise.recipes.windows.joining import JoinedFrame, join_frames
from lobewise.recipes.windows.shots import Shot, extrapolate_camera
from lobewise.records.frame import Frame, Result
from lobewise.records.images import pack_planes, unpack_planes
from lobewise.settings import MAX_WINDOW, DenoiseChanges, DenoiseSettings
from lobewise.settings.choices import GUIDED_SIMILARITY
from lobewise.work.limits import set_aside

if TYPE_CHECKING:
    from typing_extensions import Unpack

HELD_SHARE = 1.6
"""Memory that a window takes beside the joined frame, as a multiple of that of its frames."""
NO_MOTION = (
    "No other frame is used: the frames have neither motion vectors nor a camera with surface points, so nobody knows "
    "where a pixel was. Render the pass for motion"
)
NO_MOTION_ADVICE = {True: ", or give the camera (--camera).", False: ", or positions and the camera."}
"""The end of `NO_MOTION`, by whether the frame has positions or depths."""
USED_BETWEEN_FRAMES = ("motion", "hit_distance", "position", "depth", "normal")
"""Guides that frames are compared by, whatever the denoiser reads."""
REPEATED = (
    "Other frames have exactly the noise of this frame, as they were rendered with the same seed, and are not used: "
    "give every frame a seed of its own (in Blender: Sampling > Advanced > Seed, the clock beside it)."
)
OTHER_SIZE = "Frames of another size are not used."
STILL = "The frames have no motion vectors: where things move by themselves, other frames are not used."
NOTHING_FOUND = "No other frame is used: none of them shows the surfaces of this frame with the same guides."


def _require_frames(frames: Sequence[Frame], index: int) -> None:
    require_kind("frames", frames, Sequence)
    for frame in frames:
        require_kind("frame", frame, Frame)
    if not isinstance(index, int) or not 0 <= index < len(frames):
        got = name_value(index, MAX_GOT_LETTERS)
        raise InputError("index", expected=f"0 to {len(frames) - 1}", got=got, action="count from 0")


class WindowFilter:
    """Denoises the frames of a sequence with the samples of the frames before and after each of them.

    The samples of the other frames are brought to the pixels of a frame by the motion of surfaces and reflections,
    where the surface and its lobe are recognised. They are weighed by the error that they would bring in. The joined
    frame has less noise; it is denoised like any frame. At last the light of the denoised frames is averaged, over the
    albedo, so that textures stay sharp.

    Frames are prepared and denoised once, and kept as long as windows need them. One thread at a time uses a filter;
    several filters may run at once.

    Parameters
    ----------
    reach : int
        Frames before and after whose samples are joined and whose images are averaged, 1 to 8. So a result depends on
        twice as many. More frames have less noise, and cost in proportion.
    settings : DenoiseSettings, optional
        As for `lobewise.denoise`.
    past_only : bool
        Whether only frames before a frame are used, so that frames can be denoised as they come.
    **changes
        Single parameters, by name, that replace those of ``settings``.

    Raises
    ------
    InputError
        If the reach or a parameter is out of range, or a parameter is unknown.

    Examples
    --------
    >>> import lobewise
    >>> window = lobewise.WindowFilter(2)
    >>> frames = [lobewise.read_frame(path) for path in paths]  # doctest: +SKIP
    >>> images = [window.denoise(frames, index).image for index in range(len(frames))]  # doctest: +SKIP
    """

    def __init__(
        self,
        reach: int = 2,
        settings: DenoiseSettings | None = None,
        *,
        past_only: bool = False,
        **changes: Unpack[DenoiseChanges],
    ) -> None:
        if not isinstance(reach, int) or isinstance(reach, bool) or not 1 <= reach <= MAX_WINDOW:
            got = name_value(reach, MAX_GOT_LETTERS)
            raise InputError("window", expected=f"1 to {MAX_WINDOW} frames to each side", got=got, action="2 is usual")
        self.reach = reach
        self.past_only = past_only
        self._settings = change_settings(settings or DenoiseSettings(), changes)
        self._prepared: dict[int, _Prepared] = {}

    def join(self, frames: Sequence[Frame], index: int) -> JoinedFrame:
        """Return a frame with the samples of its neighbours, not denoised.

        Parameters
        ----------
        frames : sequence of Frame
            Consecutive frames: the whole sequence, or twice ``reach`` frames and one more to each side of the frame.
            Pass the same objects again, and what was prepared for them is used again.
        index : int
            The frame, counted from 0.

        Raises
        ------
        InputError
            If there is no such frame, or something in the sequence is no Frame.
        MissingChannelError
            If the frames lack what the similarity compares.
        """
        _require_frames(frames, index)
        self._forget(frames, range(index, index + 1))
        return self._join(frames, index)

    def denoise(self, frames: Sequence[Frame], index: int) -> Result:
        """Return the denoised frame; see `join` for the parameters and errors."""
        _require_frames(frames, index)
        with set_aside(HELD_SHARE * sum(map(count_bytes, frames))):
            return self._denoise(frames, index).convert(frames[index].radiance.maker)

    def _denoise(self, frames: Sequence[Frame], index: int) -> Result:
        start = time.perf_counter()
        near = self._list_near(frames, index)
        self._forget(frames, near)
        windowed = {number: self._denoise_joined(frames, number) for number in near}
        prepared = self._prepared[id(frames[index])]
        others = [(shown, windowed[index + step]) for step, shown in prepared.shown.items()]
        result, below = average_denoised(windowed[index], others), prepared.below
        if below is not None:
            # Light below 0 is dim in most frames: other frames would lower its noise by little.
            result = result.subtract(filter_below(below, prepared.checked, self._settings, ()))
        return replace(
            result,
            also=unpack_planes(result.also),
            notes=prepared.window_notes + result.notes,
            settings={**result.settings, "window": self.reach, "joined": tuple(prepared.shown)},
            seconds=time.perf_counter() - start,
            find_noisy=ref(frames[index].radiance.color),
        )

    def _join(self, frames: Sequence[Frame], index: int) -> JoinedFrame:
        return join_frames(self._prepare(frames, self._list_near(frames, index)), index)

    def _denoise_joined(self, frames: Sequence[Frame], index: int) -> Windowed:
        """Return the denoised joined frame."""
        window = tuple(id(frames[number]) for number in self._list_near(frames, index))
        prepared = self._prepared.get(id(frames[index]))
        if prepared is not None and prepared.window == window:
            assert prepared.windowed is not None
            return prepared.windowed
        joined = self._join(frames, index)
        result = denoise_checked(CheckedGuides(joined.frame), self._settings)
        prepared = self._prepared[id(frames[index])]
        if joined.shown:
            unused = tuple(name for name in result.unused if name not in USED_BETWEEN_FRAMES)
            also, bad = {**joined.frame.unscattered, **result.also}, mark_bad_pixels(prepared.checked)
            result = replace(result, unused=unused, also=also, bad_pixels=bad)
        prepared.window, prepared.windowed = window, Windowed(result, joined.albedo)
        prepared.shown, prepared.window_notes = joined.shown, self._explain(frames, index, joined)
        return prepared.windowed

    def _list_near(self, frames: Sequence[Frame], index: int) -> range:
        """Return the numbers of the frames that a frame is compared with, and its own."""
        last = index if self.past_only else min(index + self.reach, len(frames) - 1)
        return range(max(index - self.reach, 0), last + 1)

    def _forget(self, frames: Sequence[Frame], near: range) -> None:
        """Let go of all frames but those that the windows of ``near`` need."""
        needed = {id(frames[number]) for each in near for number in self._list_near(frames, each)}
        self._prepared = {key: prepared for key, prepared in self._prepared.items() if key in needed}

    def _prepare(self, frames: Sequence[Frame], numbers: range) -> dict[int, Shot]:
        """Return the shots of a window by number."""
        shots: dict[int, Shot] = {}
        for number in numbers:
            frame = frames[number]
            prepared = self._prepared.get(id(frame)) or _Prepared(frame, self._settings)
            self._prepared[id(frame)] = prepared
            if prepared.shot is None:
                camera = frames[number - 1].camera if number else None
                following = frames[number + 1].camera if number + 1 < len(frames) else None
                if camera is None and frame.camera is not None and following is not None:
                    camera = extrapolate_camera(prepared.checked.require_camera("a window"), following)
                similarity = choose_similarity(prepared.checked, self._settings, GUIDED_SIMILARITY)
                similarity = "normal" if frame.wraps else similarity
                prepared.shot = Shot(prepared.checked, camera, similarity, self._settings, self.reach)
            shots[number] = prepared.shot
        return shots

    def _explain(self, frames: Sequence[Frame], index: int, joined: JoinedFrame) -> tuple[str, ...]:
        """Return what a user should know of the window of a frame, one sentence each."""
        frame, near = frames[index], [frames[number] for number in self._list_near(frames, index)]
        notes = self._prepared[id(frame)].notes
        if joined.repeated:
            notes += (REPEATED,)
        if any(other.shape != frame.shape for other in near):
            notes += (OTHER_SIZE,)
        shot = self._prepared[id(frame)].shot
        notes += () if shot is None else shot.notes
        # The first frame of a render has no frame before it, and no motion.
        has_motion = any(each.gbuffer.motion is not None for each in near)
        if not has_motion and joined.shown:
            notes += (STILL,)
        if not joined.shown and not joined.repeated and len(near) > 1:
            knows_motion = has_motion or frame.is_placed
            notes += (NOTHING_FOUND if knows_motion else NO_MOTION + NO_MOTION_ADVICE[frame.gbuffer.is_placed],)
        return notes


class _Prepared:
    """A frame that is kept for the next windows; holding it keeps its `id` its own."""

    def __init__(self, frame: Frame, settings: DenoiseSettings) -> None:
        self.frame = frame
        checked = check_frame(frame, settings)
        packed = checked.frame.with_changes(also=pack_planes(checked.frame.also))
        self.checked, self.below = split_negative(packed)
        self.notes = checked.notes
        self.shot: Shot | None = None
        self.windowed: Windowed | None = None
        """The frame denoised with the samples of its neighbours."""
        self.window: tuple[int, ...] = ()
        """The `id` of each frame of its window."""
        self.shown: dict[int, Shown] = {}
        """See `JoinedFrame`."""
        self.window_notes: tuple[str, ...] = ()
