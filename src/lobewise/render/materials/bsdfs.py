"""Open Mitsuba's BSDF objects: which plugin each is, what it nests, and the parameters that shape its lobes.

A wrapper (``twosided``, ``normalmap``, ``bumpmap``, ``mask``, ``blendbsdf``) does not forward the attributes of what it
nests, so the objects themselves are walked, once per scene; `lobewise.render.materials.surface` evaluates them at every
hit. A BSDF for which there is no formula is fitted (`lobewise.render.materials.fitted`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from lobewise.frame import LobeKind
from lobewise.lobe_table import LobeTable
from lobewise.render.bridge import dr, mi
from lobewise.render.materials.fitted import Fit, FittedLobes, fit_bsdf
from lobewise.render.materials.probe import make_context

PLUGIN_OF_CLASS = {
    "SmoothDiffuse": "diffuse",
    "SmoothConductor": "conductor",
    "RoughConductor": "roughconductor",
    "SmoothDielectric": "dielectric",
    "RoughDielectric": "roughdielectric",
    "SmoothPlastic": "plastic",
    "RoughPlastic": "roughplastic",
    "Principled": "principled",
    "Null": "null",
    "TwoSidedBRDF": "twosided",
    "NormalMap": "normalmap",
    "BumpMap": "bumpmap",
    "MaskBSDF": "mask",
    "BlendBSDF": "blendbsdf",
}
"""Plugin name by C++ class name: the first is what a scene file says, the second what an object tells of itself."""

FITTED = "fitted"
"""What stands for the plugin of every other class."""

_NESTED = {
    "twosided": ("brdf_0", "brdf_1"),
    "normalmap": ("nested_bsdf",),
    "bumpmap": ("nested_bsdf",),
    "mask": ("nested_bsdf",),
    "blendbsdf": ("bsdf_0", "bsdf_1"),
}

_NUMBERS = {
    "dielectric": ("eta",),
    "roughdielectric": ("eta",),
    "plastic": ("eta",),
    "roughplastic": ("eta", "alpha"),
    "bumpmap": ("scale",),
}


@dataclass(frozen=True)
class Material:
    """One BSDF object and what it is made of; textures and numbers by parameter name."""

    bsdf: Any
    plugin: str
    """A value of `PLUGIN_OF_CLASS`, or `FITTED`."""
    textures: dict[str, Any] = field(default_factory=dict)
    numbers: dict[str, Any] = field(default_factory=dict)
    """Dr.Jit arrays of width 1."""
    nested: tuple[Material, ...] = ()
    """What a wrapper wraps."""
    lobe_kind: LobeKind = LobeKind.NONE
    """Kind of its own specular lobe, NONE for a wrapper."""
    diffuse_spread: float = 0.0
    """Of a plastic: its diffuse albedo over its diffuse value for light along the normal, the same for every viewer."""
    fitted: FittedLobes | None = None
    number: int = 0
    """Of a fitted one with a lobe table: its place among those of the scene, from 1; else 0."""

    def __iter__(self) -> Iterator[Material]:
        """Yield this material, then every one below it."""
        yield self
        for child in self.nested:
            yield from child

    @property
    def can_be_transparent(self) -> bool:
        """Whether a ray may pass through without noticing (``mask``, ``null``)."""
        return any(
            node.plugin in ("mask", "null") or (node.fitted is not None and node.fitted.fit.can_be_transparent)
            for node in self
        )

    @property
    def heeds_context(self) -> bool:
        """Whether it, and all below it, evaluate the lobes that a context asks for and no others."""
        return all(
            node.plugin != "principled" and (node.fitted is None or node.fitted.fit.parts.heeds_context)
            for node in self
        )


@lru_cache(maxsize=1)
def _make_collector_type() -> Any:
    """Return the class that a BSDF tells its parameters to; its base exists only once a variant is set.

    It is made once: a class made for every walk would hold what it saw until the garbage collector finds the cycle,
    and Dr.Jit compiles every BSDF that lives into every kernel.
    """

    class Collector(mi.TraversalCallback):  # type: ignore[misc]  # Mitsuba is untyped here
        def __init__(self) -> None:
            super().__init__()
            self.objects: dict[str, Any] = {}
            self.numbers: set[str] = set()

        def put(self, name: str, value: Any, flags: Any, cpptype: Any = None) -> None:
            if isinstance(value, mi.Object):
                self.objects[name] = value
            else:
                self.numbers.add(name)

    return Collector


def _list_parameters(bsdf: Any) -> tuple[dict[str, Any], set[str]]:
    """Return the objects that a BSDF holds, by name, and the names of its plain numbers."""
    collector = _make_collector_type()()
    bsdf.traverse(collector)
    return collector.objects, collector.numbers


def list_nested(bsdf: Any) -> list[Any]:
    """Return a BSDF object and every one inside it."""
    objects, _ = _list_parameters(bsdf)
    inner = [item for _, item in sorted(objects.items()) if isinstance(item, mi.BSDF)]
    return [bsdf, *(found for item in inner for found in list_nested(item))]


def _read_lobe_kind(plugin: str, text: str) -> LobeKind:
    if plugin in ("conductor", "dielectric", "plastic"):
        return LobeKind.DELTA
    if plugin == "principled":
        return LobeKind.GGX
    if plugin in ("roughconductor", "roughdielectric", "roughplastic"):
        # No parameter tells the microfacet distribution; the object's own description does.
        found = re.search(r"distribution = (\w+)", text)
        return LobeKind.GGX if found and found.group(1) == "ggx" else LobeKind.BECKMANN
    return LobeKind.NONE


@lru_cache(maxsize=256)
def measure_diffuse_spread(plugin: str, distribution: str, alpha: float, eta: float) -> float:
    """Return ``integral of f cos / f(normal)`` of a plastic's diffuse lobe, for any viewer.

    Light crosses the boundary in and out: ``f(wi, wo) = c T(wi) T(wo)``, so the shape over ``wo`` is the same for all
    ``wi``. It is measured on the plugin itself, whose rough transmittance has no closed form, by the midpoint rule.
    """
    count = 512
    probe: dict[str, Any] = {"type": plugin, "int_ior": eta, "ext_ior": 1.0, "diffuse_reflectance": 0.5}
    if plugin == "roughplastic":
        probe.update(distribution=distribution, alpha=alpha)
    si = dr.zeros(mi.SurfaceInteraction3f, count + 1)
    si.wi = mi.Vector3f(0, 0, 1)
    # Steps of equal projected area, and one last direction along the normal.
    square = (dr.arange(mi.Float, count + 1) + 0.5) / count
    cosine = dr.select(square < 1, dr.sqrt(square), 1.0)
    wo = mi.Vector3f(dr.sqrt(1.0 - dr.square(cosine)), 0, cosine)
    value = np.array(mi.load_dict(probe).eval(make_diffuse_context(), si, wo)[0], dtype=np.float64)
    return float(np.pi * (value[:-1] / np.array(cosine)[:-1]).mean() / value[-1])


def make_diffuse_context() -> Any:
    """Return the context that asks a BSDF for its diffuse lobes alone."""
    return make_context(mi.BSDFFlags.Diffuse)


def _fit_material(bsdf: Any, fits: list[Fit]) -> Material:
    fit = fit_bsdf(bsdf)
    number = 0
    if fit.table is not None:
        # A material that answers alike has the rows of another, which are one object.
        known = [index for index, other in enumerate(fits) if other.rows is fit.rows]
        if not known:
            fits.append(fit)
        number = known[0] + 1 if known else len(fits)
    return Material(bsdf=bsdf, plugin=FITTED, lobe_kind=fit.kind, fitted=FittedLobes(fit), number=number)


def read_material(bsdf: Any, fits: list[Fit] | None = None) -> Material:
    """Return what a BSDF object is made of, nested ones included.

    Parameters
    ----------
    bsdf : mitsuba.BSDF
        Of any class: one that is not in `PLUGIN_OF_CLASS` is fitted.
    fits : list, optional
        Fits of the scene with a lobe table, in the order of their numbers; new ones are appended.

    Raises
    ------
    UnsupportedBsdfError
        If it, or one inside it, is of another class and cannot be evaluated or sampled.
    MissingDependencyError
        If one must be fitted and SciPy is not installed.
    """
    fits = [] if fits is None else fits
    plugin = PLUGIN_OF_CLASS.get(str(bsdf.class_name()))
    if plugin is None:
        return _fit_material(bsdf, fits)
    objects, numbers = _list_parameters(bsdf)
    names = _NESTED.get(plugin, ())
    wanted = set(_NUMBERS.get(plugin, ()))
    if plugin == "principled":
        wanted = {"eta"} if "eta" in numbers else {"specular"}
    parameters = mi.traverse(bsdf) if wanted else {}
    values = {name: mi.Float(parameters[name]) for name in sorted(wanted)}
    lobe_kind = _read_lobe_kind(plugin, "" if names else str(bsdf))
    spread = 0.0
    if "plastic" in plugin:
        alpha, eta = (np.array(values.get(name, 0.0)).item() for name in ("alpha", "eta"))
        spread = measure_diffuse_spread(plugin, lobe_kind.name.lower(), alpha, eta)
    return Material(
        bsdf=bsdf,
        plugin=plugin,
        textures={name: value for name, value in objects.items() if name not in names},
        numbers=values,
        nested=tuple(read_material(objects[name], fits) for name in names),
        lobe_kind=lobe_kind,
        diffuse_spread=spread,
    )


def read_scene_materials(scene: Any) -> dict[int, Material]:
    """Return the material of every BSDF that a shape of the scene carries, by the object's address.

    Errors are those of `read_material`.
    """
    materials: dict[int, Material] = {}
    fits: list[Fit] = []
    for shape in scene.shapes():
        bsdf = shape.bsdf()
        if bsdf is not None and bsdf.ptr not in materials:
            materials[bsdf.ptr] = read_material(bsdf, fits)
    return materials


def list_lobe_tables(materials: dict[int, Material]) -> tuple[LobeTable, ...]:
    """Return the lobe tables of a scene's fitted materials, in the order of their numbers."""
    tables: dict[int, LobeTable] = {}
    for node in (node for material in materials.values() for node in material):
        if node.fitted is not None and node.fitted.fit.table is not None:
            tables.setdefault(node.number, node.fitted.fit.table)
    return tuple(tables[number] for number in sorted(tables))
