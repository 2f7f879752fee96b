"""Which space normals are in and which way they point, by the surfaces that positions show."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.frame import FloatArray
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.flips import FLIPS, LIES
from lobewise.interchange.checks.geometry import FEWEST_SAMPLES, Patches

Matrix = NDArray[np.float32]

ALIKE = 0.8
"""Cosine from which on a normal may be that of its surface: bumps and curvature make them differ."""
CLOSE = 0.97
"""Cosine from which on it is told to be."""
SHARPNESS = 50.0
"""Of the score, the mean of ``exp(SHARPNESS (cosine - 1))``: 1 for the normals of the surfaces, 0.5 at 10 degrees."""
SURE = 0.9
"""Share of the pixels that must be alike, of what is taken for right."""
FAIR = 0.5
"""That where it is twice as many as of what the file was taken for: leaves and hair have normals of their own."""
LEAST_GAIN = 0.03
"""By how much its score must be higher than that of what the file was taken for."""
FLIP_GAIN = 0.1
"""By how much the score of normals that are turned over must be higher."""
MOST_JUDGED = 2500
"""Pixels by which normals are judged."""
DOUBTFUL = 0.4
"""Share of the pixels below which normals are said to fit nothing."""
NEGATED_COST, TURNED_COST, EITHER_COST = 0.01, 0.02, 0.015
"""By how much more the score of a guess must be higher than that of a simpler one: that all normals are negated, that
they are in another space or have other axes, and that some look away from the camera."""
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
        Rows of 0, 1 and -1: which component in that space the file's x, y and z are.
    either : bool
        Whether normals look to the camera or away from it, surface by surface.
    """

    space: str
    axes: Matrix
    either: bool = False

    def tell(self) -> str:
        """Return it in words."""
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
    """Return the 48 ways to name and turn three axes, those that keep their order first."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.zeros((3, 3), np.float32)
            axes[np.arange(3), order] = signs
            found.append(axes)
    return found


def make_bases(camera: Camera, header: Camera | None, rays: FloatArray) -> dict[str, Matrix]:
    """Return the axes of every space at some pixels, in the world's: (3, 3) or (n, 3, 3), a row for each component.

    Parameters
    ----------
    camera : Camera
        That of the positions.
    header : Camera, optional
        That of the header, where it is another.
    rays : (n, 3)
        Unit directions of the pixels' rays.
    """
    bases = {WORLD: np.eye(3, dtype=np.float32), CAMERA: _stack_axes(camera)}
    if header is not None and np.abs(_stack_axes(header) - bases[CAMERA]).max() > 0.02:
        bases[HEADER] = _stack_axes(header)
    # As V-Ray has it: x stands on the camera's up and on the ray, y on its right and on the ray.
    right, up = (np.cross(*pair) for pair in ((rays, camera.up), (camera.right, rays)))
    unit = [side / np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-9) for side in (right, up)]
    bases[RAY] = np.stack([*unit, rays], axis=-2).astype(np.float32)
    return bases


def _stack_axes(camera: Camera) -> Matrix:
    return np.stack([camera.right, camera.up, camera.forward]).astype(np.float32)


def take_assumed(convert: Iterable[str]) -> Guess:
    """Return in which space the conversions of a role take normals to be."""
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
        Shares of the pixels whose normals are within `ALIKE` and `CLOSE`.
    """

    guess: Guess
    score: float
    alike: float
    close: float


def judge_normals(
    raw: FloatArray, bases: Mapping[str, Matrix], surface: FloatArray, assumed: Guess
) -> tuple[Judged, Judged]:
    """Return what was assumed and what is best, which is the same where nothing is better.

    Parameters
    ----------
    raw : (n, 3)
        Unit normals as in the file.
    bases : mapping of str to array
        As `make_bases` returns.
    surface : (n, 3)
        Unit normals of the surfaces, on the camera's side.
    assumed : Guess
        What the file was taken for.
    """
    first = Judged(assumed, *_score(_find_cosines(raw, bases[assumed.space], surface, assumed.axes[None]))[0])
    if first.score > 1.0 - LEAST_GAIN:
        return first, first
    every = list_axes()
    judged: list[tuple[float, Judged]] = []
    for space, basis in bases.items():
        cosines = _find_cosines(raw, basis, surface, np.stack(every))
        scores = [_score(part) for part in (cosines, np.abs(cosines))]
        for k, axes in enumerate(every):
            one, either = (Judged(Guess(space, axes, both), *scores[both][k]) for both in (False, True))
            known = space == assumed.space and np.array_equal(axes, assumed.axes)
            negated = space == assumed.space and np.array_equal(axes, -assumed.axes)
            cost = 0.0 if known else NEGATED_COST if negated else TURNED_COST
            judged += [(one.score - cost, one), (either.score - cost - EITHER_COST, either)]
    best = max(judged, key=lambda pair: pair[0])[1]
    return first, best if best.score >= first.score + LEAST_GAIN else first


def _find_cosines(raw: FloatArray, basis: Matrix, surface: FloatArray, axes: Matrix) -> FloatArray:
    """Return the cosines (n, k) between normals and those of the surfaces, named and turned in k ways (k, 3, 3)."""
    local = (basis * surface[:, None, :]).sum(axis=-1)
    return np.asarray((raw[:, :, None] * local[:, None, :]).reshape(len(raw), 9) @ axes.reshape(len(axes), 9).T)


def _score(cosines: FloatArray) -> FloatArray:
    """Return for each column of cosines (n, k) the fields of `Judged` that tell how good they are: (k, 3)."""
    return np.stack(
        [
            np.exp(np.float32(SHARPNESS) * (np.minimum(cosines, 1.0) - np.float32(1.0))).mean(axis=0),
            (cosines > ALIKE).mean(axis=0),
            (cosines > CLOSE).mean(axis=0),
        ],
        axis=1,
    )


def turn_normals(raw: FloatArray, guess: Guess, basis: Matrix) -> FloatArray:
    """Return normals of a file (n, 3) in the world, unit length, 0 where they are."""
    local = raw @ guess.axes
    if guess.space == RAY:
        right, up, away = (basis[..., axis, :] for axis in range(3))
        # Right, up and away are a left-handed triple, and not quite at right angles: Cramer's rule, up to the length.
        sides = np.cross(away, up), np.cross(right, away), np.cross(up, right)
        turned = sum(local[..., axis, None] * side for axis, side in enumerate(sides))
    else:
        turned = local @ basis
    length = np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.asarray(turned / np.where(length > 1e-6, length, 1.0), dtype=np.float32)


def undo_turn(normal: FloatArray, assumed: Guess, camera: Camera) -> FloatArray:
    """Return normals as they were in the file, up to their length, before they were turned to the world."""
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
    """Return normals in the world on the camera's side, and what was found.

    Parameters
    ----------
    normal : (height, width, 3)
        Unit normals in the world if ``assumed`` is right, 0 where there is no surface.
    label : str
        Their channels.
    assumed : Guess
        What the file was taken for.
    patches : Patches
        Surfaces that the positions show.
    camera, header : Camera
        That of the positions, and the header's, if any.
    facing : callable
        Makes the normals of the surfaces on the camera's side, (height, width, 3), by which those that look away are
        turned.
    sure : bool
        Whether the surfaces are where they are shown: the depth, say, agrees with the positions.
    """
    if len(patches) < FEWEST_SAMPLES:
        return normal, []
    patches = patches.thin_out(MOST_JUDGED)
    normal, findings = _check_flip(normal, label, patches, sure=sure)
    taken = patches.take(normal)
    there = np.linalg.norm(taken, axis=-1) > 0.5
    if there.sum() < FEWEST_SAMPLES:
        return normal, findings
    raw = undo_turn(taken[there], assumed, camera)
    bases = make_bases(camera, header, -patches.view[there])
    first, best = judge_normals(raw, bases, patches.normal[there], assumed)
    clearly = best.alike > FAIR and best.alike > 2.0 * first.alike and not best.guess.either
    if best is first or not (best.alike > SURE or clearly):
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
    """Return normals turned over where they then are those of the surfaces, and were not."""
    scores = {}
    for flip, slices in FLIPS.items():
        cosines = (patches.take(normal[slices]) * patches.normal).sum(axis=-1, keepdims=True)
        scores[flip] = _score(cosines)[0]
        if flip == LIES and scores[flip][1] > SURE:
            return normal, []
    best = max(scores, key=lambda flip: scores[flip][0])
    if scores[best][1] < SURE or scores[best][0] < scores[LIES][0] + FLIP_GAIN:
        return normal, []
    told = f"{label} lies {best} under the surfaces that the positions show"
    if not sure:
        told += ", and nothing tells which of them lies right."
        return normal, [Finding("guides flipped", told, mended=False)]
    told += ", so it was turned over."
    return np.ascontiguousarray(normal[FLIPS[best]]), [Finding("guides flipped", told, mended=True)]


def _doubt(label: str, first: Judged) -> list[Finding]:
    if first.alike >= DOUBTFUL:
        return []
    told = (
        f"{label} agrees with the surfaces that the positions show at only {100.0 * first.alike:.0f} % of the pixels, "
        "taken for any space; edges may be lost (--map normal=...)."
    )
    return [Finding("normals of no known space", told, mended=False)]


def _tell(label: str, first: Judged, best: Judged) -> Finding:
    agree = f"at {100.0 * best.close:.0f} % of the pixels instead of {100.0 * first.close:.0f} %"
    plain = replace(best.guess, either=False)
    same = plain.space == first.guess.space and np.array_equal(plain.axes, first.guess.axes)
    if same:
        told = (
            f"Some normals of {label} look away from the camera, so those were negated: they agree with the surfaces "
            f"that the positions show {agree}."
        )
        return Finding("normals that look away", told, mended=True)
    if plain.space == first.guess.space and np.array_equal(plain.axes, -first.guess.axes):
        told = f"The normals of {label} look away from the camera, so they were negated: they agree {agree}."
        return Finding("normals flipped", told, mended=True)
    more = ", and some look away from the camera" if best.guess.either else ""
    told = (
        f"{label} was taken for {first.guess.tell()} but is in {plain.tell()}{more}: turned to the world, it agrees "
        f"with the surfaces that the positions show {agree}."
    )
    kind = "normals in another space" if plain.space != first.guess.space else "normals with turned axes"
    return Finding(kind, told, mended=True)
