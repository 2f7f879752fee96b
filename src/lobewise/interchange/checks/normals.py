"""Check of the space and the side of normals, by comparison with the surfaces that positions show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.flips import FLIPS, LIES
from lobewise.interchange.checks.geometry import MIN_PIXELS, Patches
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

Matrix = NDArray[np.float32]

MIN_ALIKE_COSINE = 0.8
"""Cosine between a normal and its surface's, from which on they may be equal but for bumps and curvature."""
MIN_CLOSE_COSINE = 0.97
"""Cosine between a normal and its surface's, from which on messages say that they agree."""
SHARPNESS = 50.0
"""Exponent of the score, the mean of ``exp(SHARPNESS (cosine - 1))``: 1 at 0 degrees, 0.5 at 10 degrees."""
MIN_ALIKE_SHARE = 0.9
"""Share of alike pixels from which on a guess is right."""
MIN_ALIKE_SHARE_IF_TWICE = 0.5
"""Share of alike pixels from which on a guess is right, if it has twice the share of the assumed space. Leaves and hair
have normals that differ from their surfaces."""
MIN_SCORE_GAIN = 0.03
"""Smallest gain in score of a guess over the assumed space."""
MIN_FLIP_SCORE_GAIN = 0.1
"""Smallest gain in score of normals that are turned over."""
MAX_JUDGED_PIXELS = 2500
"""Largest number of pixels by which normals are judged."""
MIN_ALIKE_SHARE_OF_KNOWN = 0.4
"""Share of alike pixels below which a warning says that the normals fit no space."""
NEGATED_COST, TURNED_COST, EITHER_COST = 0.01, 0.02, 0.015
"""Deductions from the score of a guess, so that simpler guesses win: if all normals are negated, if they are in another
space or have other axes, and if some look away from the camera."""
WORLD, CAMERA, HEADER, RAY = "world", "camera", "header", "ray"
SPACES = {
    WORLD: "world space",
    CAMERA: "camera space",
    HEADER: "the space of the header's camera",
    RAY: "a space of each pixel's own, z along its ray",
}
WORLD_AXES = (("x", "-x"), ("y", "-y"), ("z", "-z"))
CAMERA_AXES = (("right", "left"), ("up", "down"), ("away from the camera", "towards the camera"))


@dataclass(frozen=True)
class Guess:
    """A space that normals may be in.

    Parameters
    ----------
    space : str
        A key of `SPACES`.
    axes : (3, 3)
        Rows of 0, 1 and -1: the component in ``space`` that the file's x, y and z are.
    either : bool
        Whether some normals look to the camera and others away from it.
    """

    space: str
    axes: Matrix
    either: bool = False

    def tell(self) -> str:
        """Return the guess in words."""
        if self.space == WORLD and np.array_equal(self.axes, np.eye(3)):
            return SPACES[WORLD]
        if self.space == WORLD and np.array_equal(self.axes, -np.eye(3)):
            return "world space, negated"
        names = CAMERA_AXES if self.space in (CAMERA, RAY) else WORLD_AXES
        chosen = [(int(np.argmax(np.abs(row))), int(row.sum() < 0.0)) for row in self.axes]
        words = ", ".join(
            f"{letter} is {names[axis][turned]}" for letter, (axis, turned) in zip("xyz", chosen, strict=True)
        )
        return f"{SPACES[self.space]} ({words})"


def list_axes() -> list[Matrix]:
    """Return the 48 permutations and signs of three axes. The ones in the original order come first."""
    choices = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.zeros((3, 3), np.float32)
            axes[np.arange(3), order] = signs
            choices.append(axes)
    return choices


def make_bases(camera: Camera, header: Camera | None, rays: FloatArray) -> dict[str, Matrix]:
    """Return the axes of every space in world coordinates, (3, 3), or (n, 3, 3) if they differ from pixel to pixel.

    Parameters
    ----------
    camera : Camera
        The camera of the positions.
    header : Camera, optional
        The camera of the header.
    rays : (n, 3)
        Unit directions of the pixels' rays.
    """
    bases = {WORLD: np.eye(3, dtype=np.float32), CAMERA: _stack_axes(camera)}
    if header is not None and np.abs(_stack_axes(header) - bases[CAMERA]).max() > 0.02:
        bases[HEADER] = _stack_axes(header)
    # As in V-Ray: x is perpendicular to the camera's up and the ray, y to the camera's right and the ray.
    right, up = (np.cross(*pair) for pair in ((rays, camera.up), (camera.right, rays)))
    unit = [side / np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-9) for side in (right, up)]
    bases[RAY] = np.stack([*unit, rays], axis=-2).astype(np.float32)
    return bases


def _stack_axes(camera: Camera) -> Matrix:
    return np.stack([camera.right, camera.up, camera.forward]).astype(np.float32)


def take_assumed(convert: Iterable[str]) -> Guess:
    """Return the space of normals that the conversions of a role assume."""
    words = list(convert)
    if "camera_space" in words:
        return Guess(CAMERA, np.eye(3, dtype=np.float32))
    if "camera_space_back" in words:
        return Guess(CAMERA, np.diag([1.0, 1.0, -1.0]).astype(np.float32))
    return Guess(WORLD, np.eye(3, dtype=np.float32))


@dataclass(frozen=True)
class Judged:
    """A guess, and how well it agrees with the surfaces.

    Parameters
    ----------
    guess : Guess
        The guess.
    score : float
        See `SHARPNESS`.
    alike, close : float
        Shares of the pixels whose normals are within `MIN_ALIKE_COSINE` and `MIN_CLOSE_COSINE`.
    """

    guess: Guess
    score: float
    alike: float
    close: float


def judge_normals(
    raw: FloatArray, bases: Mapping[str, Matrix], surface: FloatArray, assumed: Guess
) -> tuple[Judged, Judged]:
    """Return the assumed guess and the best guess. They are the same object if no other guess is clearly better.

    Parameters
    ----------
    raw : (n, 3)
        Unit normals as the file stores them.
    bases : mapping of str to array
        Axes of the spaces, from `make_bases`.
    surface : (n, 3)
        Unit normals of the surfaces, on the camera's side.
    assumed : Guess
        The space that the preset or the user gives.
    """
    first = Judged(assumed, *_score(_compute_cosines(raw, bases[assumed.space], surface, assumed.axes[None]))[0])
    if first.score > 1.0 - MIN_SCORE_GAIN:
        return first, first
    every = list_axes()
    judged: list[tuple[float, Judged]] = []
    for space, basis in bases.items():
        cosines = _compute_cosines(raw, basis, surface, np.stack(every))
        scores = [_score(part) for part in (cosines, np.abs(cosines))]
        for k, axes in enumerate(every):
            one, either = (Judged(Guess(space, axes, both), *scores[both][k]) for both in (False, True))
            known = space == assumed.space and np.array_equal(axes, assumed.axes)
            negated = space == assumed.space and np.array_equal(axes, -assumed.axes)
            cost = 0.0 if known else NEGATED_COST if negated else TURNED_COST
            judged += [(one.score - cost, one), (either.score - cost - EITHER_COST, either)]
    best = max(judged, key=lambda pair: pair[0])[1]
    return first, best if best.score >= first.score + MIN_SCORE_GAIN else first


def _compute_cosines(raw: FloatArray, basis: Matrix, surface: FloatArray, axes: Matrix) -> FloatArray:
    """Return the cosines (n, k) between raw normals and surface normals, for k choices of axes (k, 3, 3)."""
    local = (basis * surface[:, None, :]).sum(axis=-1)
    return np.asarray((raw[:, :, None] * local[:, None, :]).reshape(len(raw), 9) @ axes.reshape(len(axes), 9).T)


def _score(cosines: FloatArray) -> FloatArray:
    """Return score, alike and close of `Judged` for each column of cosines (n, k): (k, 3)."""
    return np.stack(
        [
            np.exp(np.float32(SHARPNESS) * (np.minimum(cosines, 1.0) - np.float32(1.0))).mean(axis=0),
            (cosines > MIN_ALIKE_COSINE).mean(axis=0),
            (cosines > MIN_CLOSE_COSINE).mean(axis=0),
        ],
        axis=1,
    )


def turn_normals(raw: FloatArray, guess: Guess, basis: Matrix) -> FloatArray:
    """Return raw normals (n, 3) turned to world space. Their length is 1, or 0 where the raw normal is 0."""
    local = raw @ guess.axes
    if guess.space == RAY:
        right, up, away = (basis[..., axis, :] for axis in range(3))
        # The axes are left-handed and not quite perpendicular. Solve by Cramer's rule; the length is set below.
        sides = np.cross(away, up), np.cross(right, away), np.cross(up, right)
        turned = sum(local[..., axis, None] * side for axis, side in enumerate(sides))
    else:
        turned = local @ basis
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.asarray(turned / np.where(length > 1e-6, length, 1.0), dtype=np.float32)


def undo_turn(normal: FloatArray, assumed: Guess, camera: Camera) -> FloatArray:
    """Return normals as the file stores them, except for their length, from normals in world space."""
    if assumed.space == WORLD:
        return normal
    return np.asarray(normal @ _stack_axes(camera).T @ assumed.axes.T, dtype=np.float32)


def check_normals(
    normal: FloatArray,
    label: str,
    assumed: Guess,
    patches: Patches,
    camera: Camera,
    header: Camera | None,
    facing: Callable[[], FloatArray],
    *,
    sure: bool,
) -> tuple[FloatArray, list[Finding]]:
    """Return normals in world space on the camera's side, and findings.

    Parameters
    ----------
    normal : (height, width, 3)
        Unit normals, in world space if ``assumed`` is right. They are 0 where there is no surface.
    label : str
        Channels of the normals.
    assumed : Guess
        The space that the preset or the user gives.
    patches : Patches
        Flat surfaces that the positions show.
    camera, header : Camera
        The camera of the positions, and the camera of the header, if any.
    facing : callable
        Computes the normals of the surfaces on the camera's side, (height, width, 3). They show which normals look
        away.
    sure : bool
        Whether the positions are known to be right, for example because the depth agrees with them.
    """
    if len(patches) < MIN_PIXELS:
        return normal, []
    patches = patches.thin_out(MAX_JUDGED_PIXELS)
    normal, findings = _check_flip(normal, label, patches, sure=sure)
    taken = patches.take(normal)
    there = np.linalg.norm(taken, axis=-1) > 0.5
    if there.sum() < MIN_PIXELS:
        return normal, findings
    raw = undo_turn(taken[there], assumed, camera)
    bases = make_bases(camera, header, -patches.view[there])
    first, best = judge_normals(raw, bases, patches.normal[there], assumed)
    clearly = best.alike > MIN_ALIKE_SHARE_IF_TWICE and best.alike > 2.0 * first.alike and not best.guess.either
    if best is first or not (best.alike > MIN_ALIKE_SHARE or clearly):
        return normal, findings + _doubt(label, first)
    height, width = normal.shape[:2]
    rays = camera.make_ray_directions(width, height)
    guess, whole = best.guess, undo_turn(normal, assumed, camera)
    basis = make_bases(camera, header, rays)[guess.space] if guess.space == RAY else bases[guess.space]
    turned = turn_normals(whole, guess, basis)
    if guess.either:
        turned = np.where((turned * facing()).sum(axis=-1, keepdims=True) < 0.0, -turned, turned)
    return turned, [*findings, _tell(label, first, best)]


def _check_flip(normal: FloatArray, label: str, patches: Patches, *, sure: bool) -> tuple[FloatArray, list[Finding]]:
    """Return normals turned over, if only then they agree with the surfaces, and findings."""
    scores = {}
    for flip, slices in FLIPS.items():
        cosines = (patches.take(normal[slices]) * patches.normal).sum(axis=-1, keepdims=True)
        scores[flip] = _score(cosines)[0]
        if flip == LIES and scores[flip][1] > MIN_ALIKE_SHARE:
            return normal, []
    best = max(scores, key=lambda flip: scores[flip][0])
    if scores[best][1] < MIN_ALIKE_SHARE or scores[best][0] < scores[LIES][0] + MIN_FLIP_SCORE_GAIN:
        return normal, []
    note = f"{label} lies {best} under the surfaces that the positions show"
    if not sure:
        note += ", and nothing tells which of them lies right."
        return normal, [Finding("guides flipped", note, mended=False)]
    note += ", so it was turned over."
    return np.ascontiguousarray(normal[FLIPS[best]]), [Finding("guides flipped", note, mended=True)]


def _doubt(label: str, first: Judged) -> list[Finding]:
    if first.alike >= MIN_ALIKE_SHARE_OF_KNOWN:
        return []
    note = (
        f"{label} agrees with the surfaces that the positions show at only {100.0 * first.alike:.0f} % of the pixels, "
        "taken for any space; edges may be lost (--map normal=...)."
    )
    return [Finding("normals of no known space", note, mended=False)]


def _tell(label: str, first: Judged, best: Judged) -> Finding:
    agree = f"at {100.0 * best.close:.0f} % of the pixels instead of {100.0 * first.close:.0f} %"
    plain = replace(best.guess, either=False)
    same = plain.space == first.guess.space and np.array_equal(plain.axes, first.guess.axes)
    if same:
        note = (
            f"Some normals of {label} look away from the camera, so those were negated: they agree with the surfaces "
            f"that the positions show {agree}."
        )
        return Finding("normals that look away", note, mended=True)
    if plain.space == first.guess.space and np.array_equal(plain.axes, -first.guess.axes):
        note = f"The normals of {label} look away from the camera, so they were negated: they agree {agree}."
        return Finding("normals flipped", note, mended=True)
    end = ", and some look away from the camera" if best.guess.either else ""
    note = (
        f"{label} was taken for {first.guess.tell()} but is in {plain.tell()}{end}: turned to the world, it agrees "
        f"with the surfaces that the positions show {agree}."
    )
    kind = "normals in another space" if plain.space != first.guess.space else "normals with turned axes"
    return Finding(kind, note, mended=True)
