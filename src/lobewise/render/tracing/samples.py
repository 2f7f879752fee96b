"""The results of one path, and their sums over the samples of a pixel."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from lobewise.render.bridge import dr, mi


@dataclass
class Lobes:
    """Radiance split by the lobe of its first scattering (Color3f). ``emitted`` was not scattered at all."""

    emitted: Any
    diffuse: Any
    specular: Any

    @property
    def color(self) -> Any:
        """The sum of the three."""
        return self.emitted + self.diffuse + self.specular


@dataclass
class Totals:
    """Light by the number of its scatterings, albedos, and hits of specular reflections.

    ``hit_inverse`` is 1/t, ``hit_position`` the position over t.
    """

    direct: Any
    indirect: Any
    diffuse_albedo: Any
    specular_albedo: Any
    hit_count: Any
    hit_inverse: Any
    hit_position: Any


@dataclass
class Squares:
    """Sums of squared deviations from the mean, of all light and of both lobes (Color3f)."""

    color: Any
    diffuse: Any
    specular: Any


@dataclass
class FirstRay:
    """The ray along which a path leaves the first surface that scatters it.

    ``known`` (Bool) is false if the surface lets light pass: such a ray may be bent.
    ``specular`` (Color3f) is the specular part of ``f cos / p``, which the radiance along the ray is multiplied by.
    """

    known: Any
    specular: Any


@dataclass
class Sample:
    """The results of one path (Dr.Jit arrays; a PyTree). ``ray`` is None where the pass keeps no rays."""

    lobes: Lobes
    totals: Totals
    ray: FirstRay | None = None


@dataclass
class Sums:
    """Running sums over the samples of a pixel (Dr.Jit arrays; a PyTree).

    ``even`` and ``odd`` sum the samples with even and odd numbers. Without guides all light is in ``even.emitted``, and
    the other fields are None.
    """

    even: Lobes
    odd: Lobes | None = None
    squares: Squares | None = None
    totals: Totals | None = None


def _make_zeros(what: Any, width: int = 1) -> Any:
    kinds = {"hit_count": mi.Float, "hit_inverse": mi.Float, "hit_position": mi.Vector3f}
    return what(*(dr.zeros(kinds.get(field.name, mi.Color3f), width) for field in fields(what)))


def make_sample(rays: bool = False) -> Sample:
    """Return a sample of zeros. With ``rays`` it has a ray."""
    ray = FirstRay(dr.zeros(mi.Bool), dr.zeros(mi.Color3f)) if rays else None
    return Sample(_make_zeros(Lobes), _make_zeros(Totals), ray)


def make_sums(width: int, guides: bool) -> Sums:
    """Return sums of zeros for ``width`` pixels."""
    if not guides:
        return Sums(Lobes(dr.zeros(mi.Color3f, width), None, None))
    return Sums(*(_make_zeros(part, width) for part in (Lobes, Lobes, Squares, Totals)))


def add_sample(sums: Sums, sample: Sample, index: Any) -> None:
    """Add sample number ``index``, counted from 0, to the sums of its pixel."""
    if sums.odd is None or sums.squares is None or sums.totals is None:
        sums.even.emitted += sample.lobes.emitted
        return
    is_even = (index & 1) == 0
    names = [field.name for field in fields(Lobes)]
    before = Lobes(*(getattr(sums.even, name) + getattr(sums.odd, name) for name in names))
    # Welford 1962: the squared deviation grows by (x - mean)^2 n / (n + 1), without cancellation.
    count = mi.Float(index)
    rate = dr.select(index > 0, dr.rcp(count), 0.0)
    growth = count / (count + 1.0)
    for field in fields(Squares):
        deviation = getattr(sample.lobes, field.name) - getattr(before, field.name) * rate
        _add(sums.squares, field.name, dr.square(deviation) * growth)
    for name in names:
        value = getattr(sample.lobes, name)
        _add(sums.even, name, dr.select(is_even, value, 0.0))
        _add(sums.odd, name, dr.select(is_even, 0.0, value))
    for field in fields(Totals):
        _add(sums.totals, field.name, getattr(sample.totals, field.name))


def _add(target: Any, name: str, value: Any) -> None:
    setattr(target, name, getattr(target, name) + value)
