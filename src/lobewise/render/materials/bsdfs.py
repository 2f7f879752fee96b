"""Reads Mitsuba's BSDF objects: the plugin of each, its nested BSDFs, and the parameters that shape its lobes.

A wrapper (``twosided``, ``normalmap``, ``bumpmap``, ``mask``, ``blendbsdf``) does not forward the attributes of its
nested BSDFs. So all objects are read, once per scene; `lobewise.render.materials.surface` evaluates them at every hit.
A BSDF without a formula is fitted (`lobewise.render.materials.fitted`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from lobewise.records.frame import LobeKind
from lobewise.records.lobe_table import LobeTable
from lobewise.render.bridge import dr, mi
from lobewise.render.materials.fitted import Fit, compute_spreads, fit_bsdf
from lobewise.render.materials.fitted_hits import FittedLobes

PLUGIN_OF_CLASS = {
    "SmoothDiffuse": "diffuse",
    "SmoothConductor": "conductor",
    "RoughConductor": "roughconductor",
    "SmoothDielectric": "dielectric",
    "RoughDielectric": "roughdielectric",
    "SmoothPlastic": "plastic",
    "RoughPlastic": "roughplastic",
    "Principled": "principled",
    "PrincipledThin": "principledthin",
    "Null": "null",
    "TwoSidedBRDF": "twosided",
    "NormalMap": "normalmap",
    "BumpMap": "bumpmap",
    "MaskBSDF": "mask",
    "BlendBSDF": "blendbsdf",
}
"""Names of plugins in scene files, by C++ class name."""

INSTANCE = "Instance"
"""Class name of a shape that repeats a shape group."""

FITTED = "fitted"
"""Plugin name for every other class."""

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
    """One BSDF object, with its textures and numbers by parameter name."""

    bsdf: Any
    plugin: str
    """A value of `PLUGIN_OF_CLASS`, or `FITTED`."""
    textures: dict[str, Any] = field(default_factory=dict)
    numbers: dict[str, Any] = field(default_factory=dict)
    """Dr.Jit arrays of width 1."""
    nested: tuple[Material, ...] = ()
    """Materials inside a wrapper."""
    lobe_kind: LobeKind = LobeKind.NONE
    """Kind of the material's own specular lobe; NONE for a wrapper."""
    diffuse_spread: float = 0.0
    """For plastics: `measure_diffuse_spread`."""
    without_specular: Any = None
    """For a thin principled BSDF: the same one with ``spec_trans`` 0, whose light is the diffuse part of it."""
    fitted: FittedLobes | None = None
    number: int = 0
    """For a fitted material with lobe tables: the number of the first of them in the scene, from 1. Otherwise 0."""

    def __iter__(self) -> Iterator[Material]:
        """Yield this material, then all materials nested in it."""
        yield self
        for child in self.nested:
            yield from child

    @property
    def can_be_transparent(self) -> bool:
        """Whether a ray may pass through unchanged (``mask``, ``null``)."""
        return any(
            node.plugin in ("mask", "null") or (node.fitted is not None and node.fitted.fit.can_be_transparent)
            for node in self
        )

    @property
    def obeys_context(self) -> bool:
        """Whether this material, and all nested ones, evaluate only the lobes that a context asks for."""
        return all(
            node.plugin not in ("principled", "principledthin")
            and (node.fitted is None or node.fitted.fit.parts.obeys_context)
            for node in self
        )


@lru_cache(maxsize=1)
def _make_collector_type() -> Any:
    """Return the class that collects a BSDF's parameters. Its base class exists only once a variant is set.

    The class is made once. A new class for every BSDF would keep the BSDF alive until the garbage collector finds the
    cycle, and Dr.Jit compiles every BSDF that is alive into every kernel.
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
    """Return a BSDF object and all BSDFs nested in it."""
    objects, _ = _list_parameters(bsdf)
    inner = [item for _, item in sorted(objects.items()) if isinstance(item, mi.BSDF)]
    return [bsdf, *(nested for item in inner for nested in list_nested(item))]


def _read_lobe_kind(plugin: str, text: str) -> LobeKind:
    if plugin in ("conductor", "dielectric", "plastic"):
        return LobeKind.DELTA
    if plugin in ("principled", "principledthin"):
        return LobeKind.GGX
    if plugin in ("roughconductor", "roughdielectric", "roughplastic"):
        # Only the text description of the object names the microfacet distribution.
        match = re.search(r"distribution = (\w+)", text)
        return LobeKind.GGX if match and match.group(1) == "ggx" else LobeKind.BECKMANN
    return LobeKind.NONE


@lru_cache(maxsize=256)
def measure_diffuse_spread(plugin: str, distribution: str, alpha: float, eta: float) -> float:
    """Return a plastic's diffuse albedo over its diffuse value for light along the normal, ``int f cos / f(normal)``.

    Light crosses the boundary in and out: ``f(wi, wo) = c T(wi) T(wo)``. So the shape over ``wo``, and this ratio, are
    the same for all ``wi``. It is measured on the plugin, whose rough transmittance has no closed form.
    """
    probe: dict[str, Any] = {"type": plugin, "int_ior": eta, "ext_ior": 1.0, "diffuse_reflectance": 0.5}
    if plugin == "roughplastic":
        probe.update(distribution=distribution, alpha=alpha)
    spreads = compute_spreads(mi.load_dict(probe), mi.BSDFFlags.Diffuse, np.asarray([[0.0, 0.0, 1.0]]), steps=(512, 1))
    return float(spreads[0, 0])


def _fit_material(bsdf: Any, fits: list[Fit], extent: float) -> Material:
    fit = fit_bsdf(bsdf, extent)
    number = 0
    if fit.tables:
        # Materials with equal values share one fit, and so the object ``rows``.
        known = [index for index, other in enumerate(fits) if other.rows is fit.rows]
        number = 1 + sum(len(other.tables) for other in (fits[: known[0]] if known else fits))
        if not known:
            fits.append(fit)
    return Material(bsdf=bsdf, plugin=FITTED, lobe_kind=fit.kind, fitted=FittedLobes(fit), number=number)


def read_material(bsdf: Any, fits: list[Fit] | None = None, extent: float = 1.0) -> Material:
    """Return the material of a BSDF object, nested ones included. A class not in `PLUGIN_OF_CLASS` is fitted.

    ``fits`` holds the scene's fits with lobe tables, in the order of their numbers; new ones are appended. ``extent``
    is the largest coordinate of hits, for fitted BSDFs that depend on the position.

    Raises
    ------
    UnsupportedBsdfError
        If a BSDF must be fitted but cannot be evaluated or sampled.
    MissingDependencyError
        If a BSDF must be fitted and SciPy is not installed.
    """
    fits = [] if fits is None else fits
    plugin = PLUGIN_OF_CLASS.get(str(bsdf.class_name()))
    if plugin is None:
        return _fit_material(bsdf, fits, extent)
    objects, numbers = _list_parameters(bsdf)
    names = _NESTED.get(plugin, ())
    parameter_names = set(_NUMBERS.get(plugin, ()))
    if plugin == "principled":
        parameter_names = {"eta"} if "eta" in numbers else {"specular"}
    parameters = mi.traverse(bsdf) if parameter_names else {}
    values = {name: mi.Float(parameters[name]) for name in sorted(parameter_names)}
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
        nested=tuple(read_material(objects[name], fits, extent) for name in names),
        lobe_kind=lobe_kind,
        diffuse_spread=spread,
        without_specular=mi.load_dict({"type": plugin, **objects, "spec_trans": 0.0})
        if plugin == "principledthin"
        else None,
    )


def list_shapes(scene: Any) -> list[Any]:
    """Return the shapes of a scene, and after them those inside shape groups, which instances repeat.

    Mitsuba lists no shapes of a group. So if there is an instance, every other shape that is alive counts, also the
    shapes of other scenes. Their BSDFs are then read in vain.
    """
    shapes = list(scene.shapes())
    if not any(shape.class_name() == INSTANCE for shape in shapes):
        return shapes
    known = {shape.ptr for shape in shapes}
    inner: list[Any] = []

    def visit(self: Any, lane: Any) -> Any:
        if self.ptr not in known:
            inner.append(self)
        return lane

    # Dr.Jit visits every shape that is alive.
    dr.dispatch(mi.ShapePtr(shapes[0]), visit, dr.opaque(mi.UInt32, 0))
    return shapes + inner


def _measure_extent(scene: Any) -> float:
    """Return the largest coordinate of a scene's surfaces; 1 if there is none."""
    box = scene.bbox()
    corners = np.abs(np.array([box.min, box.max]))
    largest = float(corners.max()) if box.valid() and np.isfinite(corners).all() else 0.0
    return largest or 1.0


def read_scene_materials(scene: Any) -> dict[int, Material]:
    """Return the materials of a scene's shapes, by the address of the BSDF object. Errors as in `read_material`."""
    materials: dict[int, Material] = {}
    fits: list[Fit] = []
    extent = _measure_extent(scene)
    for shape in list_shapes(scene):
        bsdf = shape.bsdf()
        if bsdf is not None and bsdf.ptr not in materials:
            materials[bsdf.ptr] = read_material(bsdf, fits, extent)
    return materials


def tell_attributes(scene: Any) -> str:
    """Return a remark on fitted BSDFs that read attributes of meshes, which a fit does not know; empty without any."""
    said: dict[str, None] = {}
    for bsdf in (shape.bsdf() for shape in list_shapes(scene)):
        for inner in _list_fitted(bsdf) if bsdf is not None else ():
            for name in _list_attributes(inner):
                said[
                    f"BSDF {inner.id()!r} reads the mesh attribute {name!r}; its lobes are those of the attribute's "
                    "value 0, because lobes are fitted without a mesh. Store the values in a bitmap texture instead."
                ] = None
    return " ".join(said)


def _list_fitted(bsdf: Any) -> list[Any]:
    """Return the BSDFs, of one and those nested in it, that `read_material` fits."""
    plugin = PLUGIN_OF_CLASS.get(str(bsdf.class_name()))
    if plugin is None:
        return [bsdf]
    objects = _list_parameters(bsdf)[0] if plugin in _NESTED else {}
    return [fitted for name in _NESTED.get(plugin, ()) for fitted in _list_fitted(objects[name])]


def _list_attributes(item: Any) -> list[str]:
    """Return the names of mesh attributes that a BSDF or a texture reads, itself or through others."""
    if str(item.class_name()) == "MeshAttribute":
        return re.findall(r'name = "([^"]*)"', str(item))
    return [name for _, inner in sorted(_list_parameters(item)[0].items()) for name in _list_attributes(inner)]


def list_lobe_tables(materials: dict[int, Material]) -> tuple[LobeTable, ...]:
    """Return the lobe tables of a scene's fitted materials, in the order of their numbers."""
    tables: dict[int, LobeTable] = {}
    for node in (node for material in materials.values() for node in material):
        if node.fitted is not None:
            for number, table in enumerate(node.fitted.fit.tables, start=node.number):
                tables.setdefault(number, table)
    return tuple(tables[number] for number in sorted(tables))
