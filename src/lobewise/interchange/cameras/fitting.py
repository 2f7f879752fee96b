"""Pinhole and orthographic cameras fitted to the positions of pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.cameras.places import Place
from lobewise.records.camera import PINHOLE_DISTANCE_OVER_VIEW, Camera, project_points
from lobewise.records.frame import FloatArray

Matrix = NDArray[np.float64]
State = tuple[Matrix, Matrix, float]
"""Rotation (rows right, up, forward), eye and focal length of a camera."""

MAX_PIXELS = 20000
"""Largest number of pixels to which a camera is fitted."""
MIN_POINTS = 100
"""Smallest number of pixels to which a camera is fitted."""
MAX_FIT_ERROR = 1.5
"""Largest median distance, pixels, between a pixel and the projection of its position, of a camera that fits.
The position of a sample lies anywhere within the pixel filter."""
MAX_BLURRED_FIT_ERROR = 0.05
"""The same of an image that a lens blurs, over the height of the image. Beyond it the camera is bent."""
MAX_GAUSS_NEWTON_STEPS = 12
FEW_POINTS, DRAWS = 7, 100
"""Points in a draw, and draws. Where three in five points are seen where they lie, three draws have no other."""
SEEN_SHARE = 0.3
"""Share of the points that a good start sees where they lie."""
MAX_JUDGED = 2000
"""Largest number of points that a start is judged by."""
MAX_AXIS_ERROR = 0.02
"""Largest relative difference of the axes of an orthographic image in length, and from a right angle."""


def mirror(camera: Camera) -> Camera:
    """Return the camera for a world whose x is negated. It sees the same image, with left and right kept."""
    turn = np.array([-1.0, 1.0, 1.0])
    return replace(camera, position=turn * camera.position, forward=turn * camera.forward, up=turn * camera.up)


@dataclass(frozen=True)
class CameraFit:
    """A fitted camera, and its error: the median distance, pixels, between pixels and their projected positions.

    ``mirrored`` says that the world is left-handed and the camera has x negated. ``orthographic`` says that the camera
    stands very far away and replaces an orthographic one. ``drawn`` says that the fit started at a few points.
    """

    camera: Camera
    error: float
    mirrored: bool = False
    orthographic: bool = False
    drawn: bool = False


def measure_fit(camera: Camera, position: FloatArray, mask: NDArray[np.bool_]) -> float:
    """Return the median distance, pixels, between some pixels and the projections of their positions."""
    height, width = mask.shape
    rows, columns = choose_pixels(mask)
    if not len(rows):
        return float("inf")
    seen = project_points(camera, position[rows, columns].astype(np.float64), width, height)
    apart = np.hypot(seen[:, 0] - columns - 0.5, seen[:, 1] - rows - 0.5)
    return float(np.median(np.where(np.isfinite(apart), apart, np.inf)))


def fit_camera(
    position: FloatArray,
    mask: NDArray[np.bool_],
    pixel_aspect: float = 1.0,
    place: Place | None = None,
    *,
    blurred: bool = False,
) -> CameraFit | None:
    """Return the pinhole camera that sees given points at given pixels, None if no camera does.

    A projective camera comes first, from equations that are linear in its matrix (the direct linear transform, Hartley
    and Zisserman 2003, section 7.1). Gauss-Newton steps then find a camera with pixels of a known shape. Points with a
    large error count less (Huber's weights), because the position of a sample differs from the position at the pixel's
    centre, and at silhouettes it may lie on another surface.

    Parameters
    ----------
    position : array, shape (height, width, 3)
        World positions.
    mask : array, shape (height, width)
        Pixels that have a position.
    pixel_aspect : float
        Width of a pixel over its height.
    place : Place, optional
        Where the pixels lie in the image of the camera; by default they are the whole of it.
    blurred : bool
        Whether a lens may blur the image, so that the positions of most pixels may lie off these pixels.
    """
    max_error = MAX_BLURRED_FIT_ERROR * mask.shape[0] if blurred else MAX_FIT_ERROR
    place = place or Place(*mask.shape)
    points = _gather(position, mask, pixel_aspect, place)
    if points is None:
        return None
    world, x, y = points
    center, spread = world.mean(axis=0), world.std()
    for mirrored in (False, True):
        turn = np.array([-1.0, 1.0, 1.0]) if mirrored else np.ones(3)
        scaled = turn * (world - center) / spread
        tolerance = 2.0 * MAX_FIT_ERROR / place.height
        start = of_all = _solve_projective(scaled, x, y)
        if start is None:
            return None
        if blurred:
            start = _draw_start(scaled, x, y, start, tolerance)
        # Right, up and forward of a camera in a right-handed world are a left-handed triple.
        if np.linalg.det(start[0]) > 0.0:
            continue
        state = _refine(scaled, x, y, *start)
        if state is None:
            return None
        rotation, eye, focal = state
        camera = Camera(turn * center + spread * eye, rotation[2], rotation[1], float(2.0 * np.arctan(1.0 / focal)))
        camera = place.crop(camera.with_pixel_aspect(place.width, place.height, pixel_aspect), *mask.shape)
        error = measure_fit(camera, position * turn.astype(np.float32) if mirrored else position, mask)
        return CameraFit(camera, error, mirrored, drawn=start is not of_all) if error < max_error else None
    return None


def fit_orthographic(
    position: FloatArray,
    mask: NDArray[np.bool_],
    depth: FloatArray | None = None,
    pixel_aspect: float = 1.0,
    place: Place | None = None,
) -> CameraFit | None:
    """Return a far pinhole camera that sees given points at given pixels as an orthographic one, None if none does.

    Image coordinates are linear in world coordinates (an affine camera, Hartley and Zisserman 2003, section 6.3). They
    tell along which line the camera looks, but not in which direction. The depth tells the direction. Without a depth,
    the world is taken to be right-handed.

    Parameters
    ----------
    position, mask, pixel_aspect, place
        As in `fit_camera`.
    depth : array, shape (height, width), optional
        Distances along the camera's axis, growing away from it.
    """
    place = place or Place(*mask.shape)
    points = _gather(position, mask, pixel_aspect, place)
    if points is None:
        return None
    world, x, y = points
    center = world.mean(axis=0)
    is_near = np.ones(len(world), np.bool_)
    whole = np.hstack([world - center, np.ones((len(world), 1))])
    for _ in range(2):
        lines, _, rank, _ = np.linalg.lstsq(whole[is_near], np.stack([x, y], axis=1)[is_near], rcond=1e-6)
        if rank < 4:
            return None  # All points lie on one plane, which many cameras see at these pixels.
        error = np.hypot(*(np.stack([x, y], axis=1) - whole @ lines).T)
        is_near = error <= 3.0 * np.median(error) + 1e-12
    across, upwards = lines[:3].T
    lengths = np.linalg.norm(across), np.linalg.norm(upwards)
    right, up = across / lengths[0], upwards / lengths[1]
    if abs(lengths[0] / lengths[1] - 1.0) > MAX_AXIS_ERROR or abs(right @ up) > MAX_AXIS_ERROR:
        return None
    half_height = float(2.0 / (lengths[0] + lengths[1]))
    forward = np.cross(up, right)
    mirrored = False
    if depth is not None:
        rows, columns = choose_pixels(mask)
        away = depth[rows, columns].astype(np.float64)
        along = (world - center) @ forward
        mirrored = bool(np.sum((away - away.mean()) * along) < 0.0)
    turn = np.array([-1.0, 1.0, 1.0]) if mirrored else np.ones(3)
    forward = -forward if mirrored else forward
    size = float(np.maximum(half_height, np.ptp((world - center) @ forward)))
    # The point at the centre of the image and at the mean depth of the points.
    middle = center - lines[3, 0] * half_height * right - lines[3, 1] * half_height * up
    distance = PINHOLE_DISTANCE_OVER_VIEW * size
    eye = middle - distance * forward
    camera = Camera(turn * eye, turn * forward, turn * up, float(2.0 * np.arctan(half_height / distance)))
    camera = place.crop(camera.with_pixel_aspect(place.width, place.height, pixel_aspect), *mask.shape)
    shown = measure_fit(camera, (turn * position).astype(np.float32), mask)
    return CameraFit(camera, shown, mirrored, orthographic=True) if shown < MAX_FIT_ERROR else None


def fit_any_camera(
    position: FloatArray,
    mask: NDArray[np.bool_],
    depth: FloatArray | None,
    pixel_aspect: float = 1.0,
    place: Place | None = None,
    pinhole: CameraFit | None = None,
) -> CameraFit | None:
    """Return the camera that sees given points at given pixels: a pinhole, unless an orthographic camera fits better.

    ``pinhole`` is the result of `fit_camera` if it is known. The other parameters are those of `fit_orthographic`.
    """
    pinhole = pinhole or fit_camera(position, mask, pixel_aspect, place)
    parallel = fit_orthographic(position, mask, depth, pixel_aspect, place)
    if pinhole is None or parallel is None:
        return pinhole or parallel
    # A far pinhole sees nearly what an orthographic camera sees, so the errors must differ clearly.
    return parallel if parallel.error < 0.5 * pinhole.error else pinhole


def _gather(
    position: FloatArray, mask: NDArray[np.bool_], pixel_aspect: float, place: Place
) -> tuple[Matrix, Matrix, Matrix] | None:
    """Return some points and their image coordinates, to the right and upwards, in units of half the image's height.

    Return None if the points are too few or not finite.
    """
    rows, columns = choose_pixels(mask)
    points = position[rows, columns].astype(np.float64)
    if len(rows) < MIN_POINTS or not np.isfinite(points).all() or not points.std() > 0.0:
        return None
    half = 0.5 * place.height
    x = (columns + place.left + 0.5 - 0.5 * place.width) / half * pixel_aspect
    y = (half - rows - place.top - 0.5) / half
    return points, np.asarray(x, np.float64), np.asarray(y, np.float64)


def choose_pixels(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of at most about `MAX_PIXELS` pixels of a mask, spread evenly."""
    places = np.flatnonzero(mask)
    rows, columns = np.divmod(places[:: max(1, len(places) // MAX_PIXELS)], mask.shape[1])
    return rows, columns


def _draw_start(points: Matrix, x: Matrix, y: Matrix, of_all: State, tolerance: float) -> State:
    """Return the first estimate of all points, or where it sees too few of them the best of many draws of few points.

    Points out of focus lie off their pixels, and a least-squares fit to all sees none where it lies.
    """
    step = max(1, len(points) // MAX_JUDGED)
    judged = points[::step], x[::step], y[::step]
    best, least = of_all, _judge(*judged, *of_all)
    if least <= tolerance:
        return best
    random = np.random.default_rng(0)
    for _ in range(DRAWS):
        few = random.choice(len(points), FEW_POINTS, replace=False)
        start = _solve_projective(points[few], x[few], y[few])
        if start is not None and (error := _judge(*judged, *start)) < least:
            best, least = start, error
    return best


def _judge(points: Matrix, x: Matrix, y: Matrix, rotation: Matrix, eye: Matrix, focal: float) -> float:
    """Return the error below which a start sees `SEEN_SHARE` of the points."""
    right, up, ahead = ((points - eye) @ rotation.T).T
    depth = np.where(ahead > 0.0, ahead, np.nan)
    error = np.hypot(x - focal * right / depth, y - focal * up / depth)
    return float(np.sort(np.where(np.isfinite(error), error, np.inf))[int(SEEN_SHARE * len(error))])


def _solve_projective(points: Matrix, x: Matrix, y: Matrix) -> State | None:
    """Return rotation (rows right, up, forward), eye and focal length of the projective camera that fits best."""
    one = np.ones((len(points), 1))
    whole = np.hstack([points, one])
    zero = np.zeros((4, 4))
    for _ in range(2):
        # Each point gives the equations (p, 0, -x p) and (0, p, -y p). This is the sum of their products.
        plain, across, upwards, both = ((whole.T * factor) @ whole for factor in (1.0, -x, -y, x * x + y * y))
        products = np.block([[plain, zero, across], [zero, plain, upwards], [across, upwards, both]])
        _, values, axes = np.linalg.svd(products)
        if values[-2] < 1e-9 * values[0]:
            return None  # All points lie on one plane or line, which many cameras see at these pixels.
        matrix = axes[-1].reshape(3, 4)
        depth = whole @ matrix[2]
        matrix = matrix if np.median(depth) > 0.0 else -matrix
        depth = whole @ matrix[2]
        with np.errstate(divide="ignore", invalid="ignore"):  # what lies beside the camera is seen nowhere
            error = np.hypot(x - whole @ matrix[0] / depth, y - whole @ matrix[1] / depth)
        is_near = error <= 3.0 * np.median(error) + 1e-12
        whole, x, y = whole[is_near], x[is_near], y[is_near]
    scale = np.linalg.norm(matrix[2, :3])
    forward = matrix[2, :3] / scale
    right = matrix[0, :3] / scale
    right = right - (right @ forward) * forward
    up = matrix[1, :3] / scale
    up = up - (up @ forward) * forward
    focal = math.sqrt(max(float(np.linalg.norm(right)) * float(np.linalg.norm(up)), 1e-12))
    right = right / np.linalg.norm(right)
    up = up - (up @ right) * right
    up = up / np.linalg.norm(up)
    eye = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    return np.stack([right, up, forward]), eye, focal


def _refine(points: Matrix, x: Matrix, y: Matrix, rotation: Matrix, eye: Matrix, focal: float) -> State | None:
    """Return rotation, eye and focal length of the pinhole camera that fits best, from a first estimate of them."""
    for _ in range(MAX_GAUSS_NEWTON_STEPS):
        local = (points - eye) @ rotation.T
        ahead = local[:, 2] > 1e-6
        if ahead.mean() < 0.9:
            return None
        a, b, depth = local[ahead].T
        u, v = a / depth, b / depth
        left = np.stack([x[ahead] - focal * u, y[ahead] - focal * v])
        far = np.abs(left)
        scale = 1.5 * np.median(far) + 1e-12
        weight = np.minimum(1.0, scale / np.maximum(far, 1e-300))
        zero, inverse = np.zeros_like(u), focal / depth
        # Derivatives by rotations about right, up and forward, by translations along them, and by the focal length.
        across = np.stack([-focal * u * v, focal * (1 + u * u), -focal * v, -inverse, zero, inverse * u, u])
        upwards = np.stack([-focal * (1 + v * v), focal * u * v, focal * u, zero, -inverse, inverse * v, v])
        weighted = across * weight[0], upwards * weight[1]
        products = weighted[0] @ across.T + weighted[1] @ upwards.T
        step, *_ = np.linalg.lstsq(products, weighted[0] @ left[0] + weighted[1] @ left[1], rcond=None)
        if not np.isfinite(step).all():
            return None
        rotation = _turn(step[:3]) @ rotation
        eye = eye + rotation.T @ step[3:6]
        focal = float(focal + step[6])
        if focal <= 0.0:
            return None
        if np.abs(step).max() < 1e-9:
            break
    return rotation, eye, focal


def _turn(angles: Matrix) -> Matrix:
    """Return the rotation about a vector by an angle in radians, its length (Rodrigues' formula)."""
    angle = float(np.linalg.norm(angles))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = angles / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Matrix = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return turned
