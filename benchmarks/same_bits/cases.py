"""The cases by name: each returns the arrays of a result."""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import lobewise
from benchmarks.same_bits.frames import crop, damage, enrich, forget, load_bundled, move, name_layers, roughen
from lobewise import Camera, Frame, Radiance, peers
from lobewise.denoising import combining
from lobewise.mitsuba.linear import LinearFilter

Arrays = dict[str, np.ndarray]


def take(result: Any) -> Arrays:
    """Return the images of a result by name."""
    names = ("image", "diffuse", "specular", "weight_sum", "effective_samples", "variance", "bad_pixels")
    found = {name: getattr(result, name) for name in names}
    for kind in ("layers", "also"):
        found |= {f"{kind} {name}": image for name, image in (getattr(result, kind, None) or {}).items()}
    return {name: np.asarray(value) for name, value in found.items() if value is not None}


def list_cases() -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield every case by its name."""
    bundled = load_bundled()
    part = crop(bundled, slice(150, 299), slice(120, 331))
    rich = enrich(part)
    yield from _list_filters(bundled, part, rich)
    yield from _list_upsampling(rich)
    yield from _list_sequences(part, rich)
    yield from _list_inputs(part, rich)
    for quality in ("fast", "balanced", "high"):
        yield f"bands {quality}", lambda quality=quality: _denoise_bands(rich, quality)  # type: ignore[misc]


def _denoise(frame: Frame, **changes: Any) -> Callable[[], Arrays]:
    return lambda: take(lobewise.denoise(frame, device="cpu", **changes))


def _list_filters(bundled: Frame, part: Frame, rich: Frame) -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield the similarities, forms and qualities."""
    for form in ("full", "separable", "atrous"):
        for similarity in ("normal", "sg", "sg_mixture", "ggx"):
            options: dict[str, Any] = {"quality": "fast", "form": form, "similarity": similarity}
            yield f"fast {form} {similarity}", _denoise(part, **options)
            yield f"fast {form} {similarity}, all guides", _denoise(rich, **options)
    yield "fast normal, band limit", _denoise(part, quality="fast", similarity="normal", band_limit=1.0)
    yield "fast separable ggx, whole", _denoise(bundled, quality="fast", form="separable")
    total = part.with_changes(radiance=Radiance(part.radiance.color))
    for similarity in ("sg_mixture", "ggx"):
        yield f"fast {similarity}, not apart", _denoise(total, quality="fast", similarity=similarity)
    for quality in ("balanced", "high"):
        yield quality, _denoise(part, quality=quality)
        yield f"{quality}, all guides", _denoise(rich, quality=quality)
        yield f"{quality}, not apart", _denoise(total, quality=quality)
    for similarity in ("normal", "sg", "sg_mixture", "ggx"):
        yield f"balanced {similarity}", _denoise(rich, quality="balanced", similarity=similarity)
    yield "balanced, whole", _denoise(bundled, quality="balanced")
    yield "high, whole", _denoise(bundled, quality="high")
    yield "fast, linear", lambda: _apply_linear(total)
    named = {"radius": 5, "beta": 3.0, "diffuse_beta": 5.0, "screen_sigma": 2.0, "position_sigma": 0.5, "tau": 0.1}
    for quality in ("fast", "balanced"):
        yield f"{quality}, named settings", _denoise(part, quality=quality, **named)
    yield "fast normal, named settings", _denoise(part, quality="fast", similarity="normal", normal_exponent=4.0)


def _list_upsampling(rich: Frame) -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield the recipes of sparse frames."""

    def upsample(frame: Frame, place: tuple[int, int], **changes: Any) -> Callable[[], Arrays]:
        return lambda: take(lobewise.upsample(lobewise.make_sparse(frame, 4, place), device="cpu", **changes))

    for similarity in ("normal", "sg", "sg_mixture", "ggx"):
        yield f"upsampling {similarity}", upsample(rich, (1, 2), similarity=similarity)
    yield "upsampling bilinear", upsample(rich, (0, 0), bilinear=True)
    shining = name_layers(rich)
    emitting = forget(
        shining, "coverage", gbuffer=replace(shining.gbuffer, mean_emission=shining.unscattered["emission"])
    )
    yield "upsampling, emission known", upsample(emitting.with_changes(layers=(), also={}, unscattered={}), (2, 1))
    total = rich.with_changes(radiance=Radiance(rich.radiance.color), half_a=None, half_b=None)
    yield "upsampling, not apart", upsample(total, (3, 0))
    yield "upsampling, few guides", upsample(forget(rich, "coverage"), (1, 1))
    yield "recomputed", lambda: _recompute(rich)


def _list_sequences(part: Frame, rich: Frame) -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield the recipes of several frames."""

    def run_history(frame: Frame, sparse: bool, **changes: Any) -> Callable[[], Arrays]:
        return lambda: _run_history(frame, sparse, changes)

    yield "history, sparse", run_history(rich, True)
    yield "history, sparse, few guides", run_history(part, True)
    yield "history, sparse sg", run_history(rich, True, similarity="sg")
    yield "history, full", run_history(rich, False, radius=4)
    yield "history, full, few guides", run_history(part, False, radius=4)
    yield "history, separable", run_history(rich, False, form="separable")
    yield "history, atrous normal", run_history(rich, False, form="atrous", similarity="normal")
    for sparse in (True, False):
        yield f"history, things move{', sparse' * sparse}", lambda sparse=sparse: _run_moving(rich, sparse)  # type: ignore[misc]
    for quality in ("fast", "balanced", "high"):
        yield f"window {quality}", lambda quality=quality: _run_window(rich, quality)  # type: ignore[misc]
    yield "window balanced, layers", lambda: _run_window(name_layers(rich), "balanced")


def _list_inputs(part: Frame, rich: Frame) -> Iterator[tuple[str, Callable[[], Arrays]]]:
    """Yield the frames that are not like the bundled one."""
    layered = name_layers(rich)
    frames = {
        "layers": layered,
        "light passes": rich.with_changes(also={"key": 0.6 * rich.radiance.color, "fill": 0.4 * rich.radiance.color}),
        "emission known": forget(
            layered, gbuffer=replace(layered.gbuffer, mean_emission=layered.unscattered["emission"])
        ),
        "noise is shared": part.with_changes(noise_is_shared=True),
        "one sample": part.with_changes(spp=1),
        "damage": damage(part),
        "guides for denoisers": forget(
            part,
            gbuffer=replace(
                part.gbuffer, denoiser_albedo=rich.gbuffer.diffuse_albedo, denoiser_normal=part.gbuffer.normal
            ),
        ),
        "narrow": crop(part, slice(20, 80), slice(30, 35)),
        "few rows": crop(part, slice(20, 23), slice(30, 90)),
        "color alone": Frame(Radiance(part.radiance.color), spp=4),
        "no camera": part.with_changes(camera=None),
        "normals of noise": roughen(part),
    }
    for name, frame in frames.items():
        for quality in ("fast", "balanced", "high"):
            yield f"{quality}, {name}", _denoise(frame, quality=quality)
        if frame.width > 16 and frame.height > 16:
            yield f"mixture, {name}", lambda frame=frame: _mix(frame)  # type: ignore[misc]
    yield "mixture, halves", lambda: _mix(rich)
    yield "mixture with high, layers", lambda: _mix(layered, quality="high")


def _mix(frame: Frame, **changes: Any) -> Arrays:
    """Return the mixture with a blurred image in place of Open Image Denoise's, whose bits are not ours."""

    def blur(given: Frame, **_: Any) -> tuple[np.ndarray, float]:
        image = np.nan_to_num(given.radiance.color, nan=0.0, posinf=0.0)
        padded = np.pad(image, ((2, 2), (2, 2), (0, 0)), mode="edge")
        steps = [padded[y : y + given.height, x : x + given.width] for y in range(5) for x in range(5)]
        return np.asarray(sum(steps) / np.float32(25.0), np.float32), 0.0

    with patch.object(combining, "denoise_oidn", blur), patch.object(peers, "look_up_oidn_fault", lambda: None):
        return take(lobewise.denoise(frame, device="cpu", with_oidn=True, **changes))


def _apply_linear(frame: Frame) -> Arrays:
    """Return a linear filter and its transpose, applied to an image of both signs."""
    linear = LinearFilter(frame, lobewise.DenoiseSettings(quality="fast", similarity="ggx", device="cpu"))
    image = frame.radiance.color - np.float32(0.5)
    return {"applied": linear.apply(image), "transposed": linear.transpose(image)}


def _run_moving(frame: Frame, sparse: bool) -> Arrays:
    """Return the results of a history of three frames in which things and reflections move."""
    history, found = lobewise.TemporalFilter(device="cpu"), {}
    for number in range(3):
        now = move(frame, number)
        given = lobewise.make_sparse(now, 4, (number, 3 - number)) if sparse else now
        found |= {f"{number} {name}": value for name, value in take(history.add(given)).items()}
    return found


def _run_window(frame: Frame, quality: str) -> Arrays:
    frames = [move(frame, number) for number in range(3)]
    return take(lobewise.WindowFilter(1, quality=quality, device="cpu").denoise(frames, 1))


def _run_history(frame: Frame, sparse: bool, changes: dict[str, Any]) -> Arrays:
    """Return the results of four frames of a camera that moves, and what is remembered then."""
    history = lobewise.TemporalFilter(device="cpu", **changes)
    found: Arrays = {}
    camera = frame.camera
    rng = np.random.default_rng(7)
    for number in range(4):
        step = 0.02 * number * camera.right
        moved = Camera(camera.position + step, camera.forward, camera.up, camera.fov_y, camera.fov_x)
        noise = rng.gamma(4.0, 0.25, (*frame.shape, 1)).astype(np.float32)
        light = frame.radiance
        images = {name: getattr(light, name) for name in ("color", "diffuse", "specular")}
        shaded = Radiance(**{name: None if image is None else image * noise for name, image in images.items()})
        now = Frame(shaded, frame.gbuffer, moved, spp=frame.spp)
        given = lobewise.make_sparse(now, 4, (number, 3 - number)) if sparse else now
        found |= {f"{number} {name}": value for name, value in take(history.add(given)).items()}
    state = {name: value for name, value in history.get_state().items() if name.startswith("sums")}
    return found | {name: np.asarray(value) for name, value in state.items()}


def _recompute(frame: Frame) -> Arrays:
    result = lobewise.upsample(lobewise.make_sparse(frame, 4), device="cpu")

    def shade(rows: np.ndarray, columns: np.ndarray) -> Radiance:
        parts = [getattr(frame.radiance, name)[rows, columns][:, None] for name in ("color", "diffuse", "specular")]
        return Radiance(parts[0], diffuse=parts[1], specular=parts[2])

    return take(lobewise.recompute(result, shade, samples=1.0, frame=frame))


def _denoise_bands(frame: Frame, quality: str) -> Arrays:
    with tempfile.TemporaryDirectory() as folder:
        source, output = Path(folder) / "in.exr", Path(folder) / "out.exr"
        lobewise.write_frame(source, frame)
        lobewise.denoise_file(source, output, quality=quality, rows=40, device="cpu")
        return {"image": lobewise.read_frame(output).radiance.color}
