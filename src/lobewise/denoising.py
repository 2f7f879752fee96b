"""The recipe: a noisy frame in, a clean one out."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError, MissingChannelError, describe_problem, require_choice
from lobewise.frame import FloatArray, Frame, Result
from lobewise.kernels.engine import FORMS, FilterOutput, choose_device, run_filter
from lobewise.kernels.features import BandLimitFeature, Feature, NormalFeature, PositionFeature, ScreenFeature
from lobewise.kernels.lobe_features import DiffuseFeature, GgxFeature, SgFeature
from lobewise.lobes.field import LobeField, build_lobe_field, default_tau

SIMILARITIES = ("auto", "normal", "sg", "ggx")
DEFAULT_SIMILARITY = "ggx"
"""What "auto" takes where the frame has lobes: the winner of benchmarks/results/quality.json."""
LARGEST_RADIUS = 64


@dataclass(frozen=True)
class DenoiseSettings:
    """Parameters of `denoise`.

    Parameters
    ----------
    similarity : {"auto", "normal", "sg", "ggx"}
        What is compared on specular pixels: shading normals, one spherical Gaussian per lobe, or the GGX covariance of
        the lobe. "auto" takes "ggx" where the frame has roughness and camera, else "normal".
    form : {"full", "separable", "atrous"}
        All (2r+1)^2 taps; a row and a column pass; five 5x5 levels of doubling step (radius 62).
    radius : int
        Kernel radius, pixels, 0 to 64; "atrous" does not use it.
    beta : float or "auto"
        Exponent of the lobe similarity, > 0: larger keeps more detail and more noise. "auto" follows the noise.
    diffuse_beta : float or "auto"
        The same for the overlap of diffuse lobes.
    device : {"auto", "cpu"}
        Where the kernels run.
    screen_sigma : float or "auto"
        Standard deviation of the screen distance, pixels, > 0; not used by "atrous". "auto" follows radius and noise.
    position_sigma : float
        Standard deviation of the distance in the scene, in pixel footprints, > 0.
    tau : float or "auto"
        Band-limit of the lobes, radians, 1e-5 to 1 (see `lobewise.lobes.field`): what makes a mirror's lobe finite.
        "auto" follows the noise, down to the angle of a pixel.
    normal_exponent : float
        Sharpness with which "normal" compares normals, > 0.
    band_limit : float or None
        With "normal": scale of the screen-space band-limit by BRDF parameter, > 0; None for none.
    """

    similarity: str = "auto"
    form: str = "full"
    radius: int = 8
    beta: float | str = "auto"
    diffuse_beta: float | str = "auto"
    device: str = "auto"
    screen_sigma: float | str = "auto"
    position_sigma: float = 16.0
    tau: float | str = "auto"
    normal_exponent: float = 64.0
    band_limit: float | None = None

    def __post_init__(self) -> None:
        require_choice("similarity", self.similarity, SIMILARITIES)
        require_choice("form", self.form, FORMS)
        if isinstance(self.radius, bool) or not isinstance(self.radius, int) or not 0 <= self.radius <= LARGEST_RADIUS:
            raise InputError(
                describe_problem(
                    "radius",
                    expected=f"an integer from 0 to {LARGEST_RADIUS}",
                    got=repr(self.radius),
                    action="8 is usual; form='atrous' reaches further",
                )
            )
        for name in ("beta", "diffuse_beta", "screen_sigma", "tau"):
            value = getattr(self, name)
            if value != "auto":
                _require_positive(name, value, '"auto" or a finite number above 0')
        for name in ("position_sigma", "normal_exponent"):
            _require_positive(name, getattr(self, name), "a finite number above 0")
        if self.band_limit is not None:
            _require_positive("band_limit", self.band_limit, "a finite number above 0")


def _require_positive(name: str, value: Any, expected: str) -> None:
    if isinstance(value, str) or not (math.isfinite(value) and value > 0.0):
        raise InputError(describe_problem(name, expected=expected, got=repr(value), action="leave it out if unsure"))


@dataclass(frozen=True)
class _Layer:
    """One radiance to filter and what it is filtered by."""

    radiance: FloatArray
    albedo: FloatArray | None
    mask: NDArray[np.bool_]
    features: tuple[Feature, ...]


def choose_similarity(frame: Frame, similarity: str) -> str:
    """Return the similarity that "auto" stands for on this frame; others are returned as they are."""
    if similarity != "auto":
        return similarity
    guides = frame.gbuffer
    placed = guides.position is not None or guides.depth is not None
    has_lobes = guides.normal is not None and guides.alpha_u is not None and frame.camera is not None and placed
    return DEFAULT_SIMILARITY if has_lobes else "normal"


def estimate_spp(frame: Frame) -> float:
    """Return how many samples per pixel of a well-lit scene the noise is worth, > 0.

    Where the frame has its variance, the median relative variance of the mean is compared with what the built-in
    ``showroom`` has at the same sample count, ``0.0825 (4/spp)^0.56`` (it falls more slowly than 1/spp because few
    samples hide the tail). A dim, indirectly lit room is then worth fewer samples than it took. Without variance it is
    the sample count itself, and without that 4.
    """
    spp = float(frame.spp) if frame.spp is not None else None
    if frame.variance is None:
        return spp or 4.0
    mean, variance = frame.radiance.color.mean(axis=-1), frame.variance.color.mean(axis=-1)
    lit = np.isfinite(mean) & np.isfinite(variance) & (mean > 0.0) & (variance >= 0.0)
    if not lit.any():
        return spp or 4.0
    noise = max(float(np.median(variance[lit] / mean[lit] ** 2)), 1e-9)
    if spp is None:
        return float(np.clip(4.0 * math.pow(0.0825 / noise, 1.0 / 0.56), 0.25, 4096.0))
    excess = noise / (0.0825 * math.pow(4.0 / spp, 0.56))
    return spp / float(np.clip(excess, 0.25, 16.0))


def choose_beta(spp: float) -> float:
    """Return the exponent of the lobe similarity for a sample count: narrower kernels as the noise falls.

    The bias of a kernel grows with the square of its area and the variance falls with it, so the best exponent goes
    with the cube root of the sample count; the factor is fitted (benchmarks/results/quality.json, "tuned beta").
    """
    return min(max(2.5 * math.pow(spp, 1.0 / 3.0), 1.0), 64.0)


def choose_screen_sigma(spp: float, radius: int) -> float:
    """Return the standard deviation of the screen distance, pixels, for a sample count.

    It bounds what lobes cannot see: how fast the reflected light itself changes.
    """
    return max(radius * min(1.0, 0.6 * math.pow(8.0 / max(spp, 1.0), 0.25)), 0.5)


def choose_tau(spp: float, pixel_tau: float) -> float:
    """Return the band-limit of the lobes, radians, for a sample count; never below that of a pixel.

    A sharp lobe passes the noise of what it reflects, so few samples ask for more smoothing than the pixel does, and
    mirrors become sharp as their noise goes. The factor was fitted on the built-in scenes.
    """
    return max(0.03 * math.sqrt(4.0 / max(spp, 1.0)), pixel_tau)


def _find_good(image: FloatArray) -> NDArray[np.bool_]:
    """Return where all three channels are finite and not negative.

    Channel by channel: NumPy's reductions over an axis of three are several times slower.
    """
    # Not-finite compares false with everything, so the good side is what is tested.
    each = (image >= 0.0) & (image <= np.finfo(np.float32).max)
    good: NDArray[np.bool_] = each[..., 0] & each[..., 1] & each[..., 2]
    return good


def find_bad_pixels(frame: Frame) -> NDArray[np.bool_]:
    """Return where any radiance of the frame is NaN, infinite or negative, shape (height, width)."""
    bad = np.zeros(frame.shape, dtype=bool)
    for image in (frame.radiance.color, frame.radiance.diffuse, frame.radiance.specular):
        if image is not None:
            bad |= ~_find_good(image)
    return bad


def _require_channel(value: FloatArray | None, name: str, settings: DenoiseSettings) -> FloatArray:
    if value is None:
        raise MissingChannelError(
            describe_problem(
                f"channel {name}",
                expected=f"one for similarity {settings.similarity!r}",
                got="none",
                action="render it with the frame, or choose another similarity",
            )
        )
    return value


def _make_position_features(frame: Frame, settings: DenoiseSettings) -> list[Feature]:
    assert not isinstance(settings.screen_sigma, str)
    features: list[Feature] = [] if settings.form == "atrous" else [ScreenFeature(settings.screen_sigma)]
    guides = frame.gbuffer
    if frame.camera is not None and (guides.position is not None or guides.depth is not None):
        depth = guides.depth
        if depth is None:
            assert guides.position is not None
            depth = np.linalg.norm(guides.position - frame.camera.position.astype(np.float32), axis=-1)
        place = guides.position if guides.position is not None else frame.camera.make_positions(depth)
        features.append(
            PositionFeature(
                place,
                depth,
                pixel_angle=frame.camera.get_pixel_angle(frame.height),
                sigma=settings.position_sigma,
            )
        )
    return features


def _make_specular_feature(
    frame: Frame, settings: DenoiseSettings, lobes: LobeField | None, beta: float
) -> list[Feature]:
    if settings.similarity == "normal" or lobes is None:
        features: list[Feature] = [
            NormalFeature(_require_channel(frame.gbuffer.normal, "normal", settings), settings.normal_exponent)
        ]
        if settings.band_limit is not None:
            assert lobes is not None and lobes.sharpness is not None and frame.camera is not None
            features.append(
                BandLimitFeature(
                    lobes.sharpness,
                    pixel_angle=frame.camera.get_pixel_angle(frame.height),
                    scale=settings.band_limit,
                    largest_sigma=float(max(settings.radius, 1)),
                )
            )
        return features
    if settings.similarity == "sg":
        assert lobes.axis is not None and lobes.sharpness is not None
        return [SgFeature(lobes.axis, lobes.sharpness, beta)]
    assert lobes.tangent_axis is not None and lobes.covariance is not None and lobes.determinant is not None
    return [GgxFeature(lobes.tangent_axis, lobes.covariance, lobes.determinant, beta)]


def _find_surface(frame: Frame) -> NDArray[np.bool_]:
    """Return where a pixel sees a surface with finite guides."""
    surface = np.ones(frame.shape, dtype=bool)
    guides = frame.gbuffer
    if guides.depth is not None:
        surface &= (guides.depth > 0.0) & np.isfinite(guides.depth)
    if guides.position is not None:
        x, y, z = (guides.position[..., k] for k in range(3))
        with np.errstate(invalid="ignore", over="ignore"):
            surface &= np.isfinite(x + y + z)
    if guides.normal is not None:
        # A missing surface has a zero normal in every renderer's convention.
        x, y, z = (guides.normal[..., k] for k in range(3))
        with np.errstate(invalid="ignore", over="ignore"):
            squared = x * x + y * y + z * z
        surface &= (squared > 0.01) & np.isfinite(squared)
    return surface


def _make_layers(frame: Frame, settings: DenoiseSettings) -> list[_Layer]:
    guides, radiance = frame.gbuffer, frame.radiance
    normal = _require_channel(guides.normal, "normal", settings)
    apart = radiance.diffuse is not None and radiance.specular is not None
    assert not isinstance(settings.beta, str) and not isinstance(settings.diffuse_beta, str)
    assert not isinstance(settings.tau, str)
    surface = _find_surface(frame)
    lobes: LobeField | None = None
    if settings.similarity != "normal" or settings.band_limit is not None:
        if frame.camera is None:
            raise MissingChannelError(
                describe_problem(
                    "camera",
                    expected=f"one for similarity {settings.similarity!r}",
                    got="none in the frame",
                    action="give the frame a camera, or use similarity 'normal'",
                )
            )
        lobes = build_lobe_field(
            guides,
            frame.camera,
            tau=settings.tau,
            representation="ggx" if settings.similarity == "ggx" else "sg",
            diffuse_fallback=True,
        )
    position = _make_position_features(frame, settings)
    specular = _make_specular_feature(frame, settings, lobes, settings.beta)
    specular_mask = surface if lobes is None else surface & lobes.valid
    if not apart:
        albedo = None
        if guides.diffuse_albedo is not None and guides.specular_albedo is not None:
            albedo = guides.diffuse_albedo + guides.specular_albedo
        return [_Layer(radiance.color, albedo, specular_mask, (*position, *specular))]
    assert radiance.diffuse is not None and radiance.specular is not None
    diffuse: list[Feature]
    if settings.similarity == "normal":
        diffuse = [NormalFeature(normal, settings.normal_exponent)]
    else:
        diffuse = [DiffuseFeature(normal, settings.diffuse_beta)]
    return [
        _Layer(radiance.diffuse, guides.diffuse_albedo, surface, (*position, *diffuse)),
        _Layer(radiance.specular, guides.specular_albedo, specular_mask, (*position, *specular)),
    ]


def _refill(image: FloatArray, holes: NDArray[np.bool_], settings: DenoiseSettings) -> FloatArray:
    """Return ``image`` with the pixels of ``holes`` replaced by the mean of the nearest others on the screen."""
    everywhere = np.ones(holes.shape, dtype=bool)
    source = np.where(holes[..., None], np.float32(np.nan), image)
    for features in ([ScreenFeature(1.0)], [ScreenFeature(16.0)], []):
        filled = run_filter(source, everywhere, features, form="atrous", radius=0, device=settings.device)
        reached = holes & (filled.weight_sum > 0.0)
        source = np.where(reached[..., None], filled.image, source)
        holes = holes & ~reached
        if not holes.any():
            return source
    return np.where(holes[..., None], np.nanmean(source.reshape(-1, 3), axis=0).astype(np.float32), source)


def resolve_settings(frame: Frame, settings: DenoiseSettings) -> DenoiseSettings:
    """Return ``settings`` with every "auto" replaced by what it stands for on this frame."""
    spp = estimate_spp(frame)
    beta = choose_beta(spp)
    sigma, tau = settings.screen_sigma, settings.tau
    pixel_tau = default_tau(frame.camera, frame.height) if frame.camera is not None else 0.0
    return replace(
        settings,
        # Half way between noise and count: noise that is not the lobe's own (small lights seen in a mirror) stays.
        tau=choose_tau(math.sqrt(spp * (frame.spp or spp)), pixel_tau) if tau == "auto" else float(tau),
        screen_sigma=choose_screen_sigma(spp, settings.radius) if sigma == "auto" else float(sigma),
        similarity=choose_similarity(frame, settings.similarity),
        beta=beta if settings.beta == "auto" else float(settings.beta),
        diffuse_beta=beta if settings.diffuse_beta == "auto" else float(settings.diffuse_beta),
        device=choose_device(settings.device),
    )


def denoise(frame: Frame, settings: DenoiseSettings | None = None, **changes: Any) -> Result:
    """Denoise a frame by averaging, for every pixel, the neighbours that reflect like it.

    Diffuse and specular radiance are filtered apart where the frame has both, each divided by its albedo where the
    frame has that; emission and background pass through. Source: Tokuyoshi 2015, "Specular Lobe-Aware Filtering and
    Upsampling for Interactive Indirect Illumination". Departs: lobes of two radiances are never mixed, and the lobe
    similarity may be the GGX covariance instead of a spherical Gaussian.

    Parameters
    ----------
    frame : Frame
        Noisy radiance with its G-buffer; normals at least, for lobes also roughness, camera and position or depth.
    settings : DenoiseSettings, optional
        Parameters; by default those that won the comparison.
    **changes
        Single parameters, by name, that replace those of ``settings``.

    Returns
    -------
    Result
        Finite, non-negative radiance and the filter's statistics.

    Raises
    ------
    InputError
        If a parameter is out of range or unknown, or no pixel of the frame is usable.
    MissingChannelError
        If the frame lacks what the similarity compares.
    DeviceError
        If the device cannot run here.

    Examples
    --------
    >>> import lobewise
    >>> frame = lobewise.read_frame("frame.exr")  # doctest: +SKIP
    >>> clean = lobewise.denoise(frame, radius=12).image  # doctest: +SKIP
    """
    start = time.perf_counter()
    for name in changes:
        require_choice("setting", name, [item.name for item in fields(DenoiseSettings)])
    chosen = resolve_settings(frame, replace(settings or DenoiseSettings(), **changes))
    bad = find_bad_pixels(frame)
    if bad.all():
        raise InputError(
            describe_problem(
                "radiance",
                expected="at least one pixel that is finite and not negative",
                got=f"{bad.size} bad pixels of {bad.size}",
                action="check the render or the channel mapping",
            )
        )
    layers = _make_layers(frame, chosen)
    outputs = [
        run_filter(
            layer.radiance,
            layer.mask,
            layer.features,
            form=chosen.form,
            radius=chosen.radius,
            albedo=layer.albedo,
            device=chosen.device,
        )
        for layer in layers
    ]
    parts = [_keep_unfiltered(layer, output) for layer, output in zip(layers, outputs, strict=True)]
    image = _compose(frame, parts)
    untouched = np.logical_and.reduce([output.weight_sum <= 0.0 for output in outputs])
    holes = ~_find_good(image) | (bad & untouched)
    if holes.any():
        image = _refill(image, holes, chosen)
    apart = len(parts) == 2
    decisive = outputs[-1]
    return Result(
        image=image,
        diffuse=np.nan_to_num(parts[0]) if apart else None,
        specular=np.nan_to_num(parts[1]) if apart else None,
        weight_sum=decisive.weight_sum,
        effective_samples=decisive.effective_samples,
        bad_pixels=bad,
        settings=asdict(chosen),
        seconds=time.perf_counter() - start,
    )


def _keep_unfiltered(layer: _Layer, output: FilterOutput) -> FloatArray:
    """Return the filtered radiance, and the input where no tap had weight; NaN where that is bad too."""
    lost = output.weight_sum <= 0.0
    if not lost.any():
        return output.image
    kept = np.where(_find_good(layer.radiance)[..., None], layer.radiance, np.float32(np.nan))
    return np.where(lost[..., None], kept, output.image)


def _compose(frame: Frame, parts: Sequence[FloatArray]) -> FloatArray:
    """Return the total: the filtered parts, and what was in none of them (emission, background) as it came."""
    if len(parts) == 1:
        return parts[0]
    radiance = frame.radiance
    assert radiance.diffuse is not None and radiance.specular is not None
    with np.errstate(invalid="ignore", over="ignore"):  # bad pixels are infinite or NaN here; the next line drops them
        rest = radiance.color - radiance.diffuse - radiance.specular
    rest = np.where((rest > 0.0) & (rest <= np.finfo(np.float32).max), rest, np.float32(0.0))
    return np.asarray(parts[0] + parts[1] + rest, dtype=np.float32)
