"""The engine: the verbs that recipes are written in.

A recipe calls kernels by the functions of this package. The current engine of the thread runs the calls at once
(`lobewise.engine.here.Here`, the default) or records them (`lobewise.engine.recorder.Recorder`). So a recipe stands
once, and plans, costs and exported pipelines follow from the calls that it makes.

An image is an array where calls run at once, and a `lobewise.engine.graph.GraphImage` where they are recorded. A number
is a float, and a `lobewise.engine.numbers.Number` where calls are recorded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import share_memory
from lobewise.engine.here import HERE, Here, KernelPass

if TYPE_CHECKING:
    from lobewise.engine.recorder import Recorder

Make = Callable[[Any], Any]
"""Defines a kernel for a target of Halide; see `lobewise.backend.jit.Scheduled`."""


class _Current(threading.local):
    engine: Here | Recorder = HERE


_current = _Current()


def get_engine() -> Here | Recorder:
    """Return the current engine of this thread."""
    return _current.engine


@contextmanager
def use(engine: Here | Recorder) -> Iterator[None]:
    """Make an engine the current one of this thread inside the context."""
    before, _current.engine = _current.engine, engine
    try:
        yield
    finally:
        _current.engine = before


@contextmanager
def on(device: str) -> Iterator[None]:
    """Run kernels at once on a device of `lobewise.list_devices` inside the context, in memory that they share."""
    with use(Here(device)), share_memory():
        yield


def pixels(
    define: Callable[..., Any],
    images: Mapping[str, Any],
    numbers: Mapping[str, Any],
    *options: Hashable,
    names: Sequence[str] = (),
    into: Sequence[Any] = (),
    text: str = "",
) -> tuple[NDArray[Any], ...]:
    """Compute images from images, pixel by pixel.

    Parameters
    ----------
    define : Definition
        A function at the top of a module; see `lobewise.backend.pointwise.Definition`.
    images : mapping of str to image or None
        Each float32 or a mask, (height, width) or (height, width, 2 or more); None if it is absent.
    numbers : mapping of str to array_like
        Scalars or vectors, computed as float32 if they are, else as float64. New values do not compile again.
    *options
        Further arguments of the definition. New values compile again.
    names : sequence of str
        Names of the outputs in recorded plans.
    into : sequence of image or None
        Memory for the first outputs.
    text : str
        What the call does, for recorded plans; by default the first line of the definition's docstring.

    Returns
    -------
    tuple of image
        (height, width) or (height, width, channels), float32 or masks.

    Raises
    ------
    InputError
        If the images differ in size.
    """
    outputs: Any = _current.engine.pixels(define, images, numbers, options, names, into, text)
    return tuple(outputs)


def kernel(
    key: Hashable,
    make: Make,
    images: Mapping[str, Any],
    numbers: Mapping[str, Any] | None = None,
    *,
    strict: bool = False,
    sizes: Mapping[str, Any] | None = None,
    into: Any = None,
    names: Mapping[str, str] | None = None,
    text: str = "",
) -> dict[str, Any]:
    """Call a compiled kernel; return its outputs by the names of its signature.

    Parameters
    ----------
    key : hashable
        Everything that changes the code of the kernel.
    make : callable
        Defines the kernel for a target.
    images, numbers : mappings
        Arguments by the names of the signature. Those that it does not have are left out.
    strict : bool
        Whether float operations keep their order.
    sizes : mapping of str to length, optional
        Axes of the outputs that no input has; see `halve` and `pad`.
    into : image, optional
        Memory for the only output. A recorded recipe shares memory out itself.
    names, text
        For recorded plans: names of the outputs, and what the call does.
    """
    engine = _current.engine
    outputs: Any = engine.kernel(
        key, make, images, numbers or {}, names or {}, text, strict=strict, sizes=sizes or {}, into=into
    )
    return dict(outputs)


def planes(
    key: Hashable,
    make: Make,
    images: Mapping[str, Any],
    numbers: Mapping[str, Any],
    *,
    strict: bool = False,
    name: str = "planes",
    keep: str = "",
    text: str = "",
) -> Any:
    """Call a kernel whose outputs are planes, (height, width) each; return the planes: an array or a list of images.

    Parameters
    ----------
    key, make, images, numbers, strict, text
        As of `kernel`.
    name : str
        Beginning of the names of the planes in recorded plans.
    keep : str
        In recorded plans the name of the state whose planes the first outputs become: the next frame reads it.
    """
    return _current.engine.planes(key, make, images, numbers, name, keep, text, strict=strict)


def passes(
    passes: Sequence[KernelPass],
    images: Mapping[str, Any],
    numbers: Mapping[str, Any],
    *,
    tiles: Sequence[tuple[slice, slice]] = (),
    name: str = "filtered",
) -> dict[str, Any]:
    """Call kernels one after the other, each of which reads as ``source`` what the one before has written as ``sums``.

    Parameters
    ----------
    passes : sequence of KernelPass
    images, numbers : mappings
        Arguments of all kernels by name, and the ``source`` of the first.
    tiles : sequence of (rows, columns)
        Of two passes, along rows and then along columns: the parts of the image that run one after the other, so that
        what lies between the passes stays small.
    name : str
        Name of the result in recorded plans.
    """
    return dict(_current.engine.passes(passes, images, numbers, tiles, name))


def hold(name: str, array: NDArray[np.float32]) -> Any:
    """Return an array that is equal for all frames as an image; a recorded recipe has its values compiled in."""
    return _current.engine.hold(name, array)


def halve(length: Any) -> Any:
    """Return half the length of an axis, rounded up."""
    return _current.engine.halve(length)


def pad(length: Any, multiple: int) -> Any:
    """Return the length of an axis, rounded up to a multiple."""
    return _current.engine.pad(length, multiple)


def pick(image: Any, scale: int, place: tuple[Any, Any], *, stacked: bool = False) -> Any:
    """Return an image at one pixel of every block of ``scale`` times ``scale``, (rows, columns, ...).

    ``place`` is the row and the column of the pixel in each block. If ``stacked`` the image is (count, height, width).
    """
    return _current.engine.pick(image, scale, place, stacked=stacked)


def fill(name: str, value: float, shape: tuple[Any, ...]) -> Any:
    """Return an image of one value, whose rows share their memory; ``name`` is that in recorded plans."""
    return _current.engine.fill(name, value, shape)


def total(
    measure: Callable[..., Any], images: Sequence[Any], numbers: Sequence[float] = (), *, name: str = "", count: int = 1
) -> Any:
    """Return a number of whole images: what a function of them and of some numbers returns.

    A pipeline calls the routine in C of the same name. ``name`` is that of the number there; several calls of one name
    write one number. ``count`` numbers in single precision may come instead of one.
    """
    return _current.engine.total(measure, images, numbers, name, count)


def compare(first: float, sign: str, second: float) -> Any:
    """Return the condition that a number is above (">") or at least (">=") another one."""
    return _current.engine.compare(first, sign, second)


def both(first: Any, second: Any) -> Any:
    """Return the condition that two conditions hold. The second is not read where the first does not hold."""
    return _current.engine.both(first, second)


def when(condition: Any, run: Callable[[], Any], otherwise: Callable[[], Any] | None = None) -> Any:
    """Run a part of a recipe where a condition holds, and another one where it does not; return what they return.

    A recorded recipe has both parts, and takes what the first returns.
    """
    return _current.engine.when(condition, run, otherwise)


def keep(name: str, make: Callable[[], Any]) -> None:
    """Let an image be what the next frame finds under a name.

    A recorded recipe copies the image, unless it was written there. Where calls run at once the caller keeps what it
    needs, and nothing is made.
    """
    _current.engine.keep(name, make)


def own(image: Any) -> Any:
    """Return an image that the recipe may change: a copy, or a recorded image itself."""
    return _current.engine.own(image)


def in_box(mask: Any, reach: int, run: Callable[..., None], *images: Any) -> None:
    """Run a part of a recipe on the box around the pixels of a mask, and ``reach`` pixels more; not at all if none is.

    ``run`` gets the parts of the images that lie in the box, and may change them.
    """
    _current.engine.in_box(mask, reach, run, images)


def in_bands(
    gather: Callable[[dict[str, Any]], dict[str, Any]],
    finish: Callable[[dict[str, Any]], Any],
    images: Mapping[str, Any],
    rows: int,
    reach: int,
) -> Any:
    """Run a part of a recipe band by band, so that the images between take little memory; return the joined image.

    ``gather`` takes the images of a band of ``rows`` rows, with ``reach`` more rows above and below, and returns images
    of as many rows. ``finish`` takes these images, cut to the band, and returns an image. A recorded recipe gathers the
    whole image at once.
    """
    present = {name: image for name, image in images.items() if image is not None}
    return _current.engine.in_bands(gather, finish, present, rows, reach)


def by_value(run: Callable[[Any], Any], image: Any) -> Any:
    """Run a part of a recipe on an image whose every value is a pixel of its own; return its result in the old shape.

    ``run`` takes and returns (height, width * channels), in the memory of an image (height, width, channels). Steps
    that treat all channels and columns alike then read whole vectors instead of interleaved channels.
    """
    return _current.engine.by_value(run, image)


def chain(
    define: Callable[..., Any],
    images: Mapping[str, Any],
    numbers: Mapping[str, Any],
    key: Hashable,
    make: Make,
    arrays: Mapping[str, NDArray[np.float32]],
    *,
    rows: int,
    name: str,
    channels: int,
    texts: tuple[str, str] = ("", ""),
) -> Any:
    """Compute an image by a definition, and call a kernel on it, band by band; return the kernel's only output.

    The computed image is never held as a whole: it takes the memory of one band.

    Parameters
    ----------
    define, images, numbers
        As of `pixels`.
    key, make
        As of `kernel`.
    arrays : mapping of str to array
        Further inputs of the kernel by name, equal for all frames.
    rows : int
        Rows of a band; a recorded pipeline chooses its own.
    name, channels : str, int
        Name of the computed image in the signature of the kernel, and its channels.
    texts : pair of str
        What the two calls do, for recorded plans.
    """
    return _current.engine.chain(define, images, numbers, key, make, arrays, rows, name, channels, texts)


def clear(image: Any) -> None:
    """Set all of an image to 0."""
    _current.engine.clear(image)


def only(condition: Any, image: Any) -> Any:
    """Return an image where a condition holds; else None, or an image of 0 in a recorded recipe."""
    return _current.engine.only(condition, image)


def some(image: Any) -> Any:
    """Return an image; None where all of it is 0. A recorded recipe always has the image."""
    return _current.engine.some(image)


def part(name: str) -> AbstractContextManager[None]:
    """Name the part of the recipe that the calls inside the context belong to, for recorded plans."""
    return _current.engine.part(name)


def take(name: str, *shape: Any, text: str, unit: str = "") -> Any:
    """Return memory for a result that the user of a recorded recipe takes; None where calls run at once."""
    return _current.engine.take(name, shape, text, unit)
