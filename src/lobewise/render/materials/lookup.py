"""Finds a material of a scene by its id, for `lobewise fit --mitsuba`."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise.errors import InputError
from lobewise.fitting.arrays import Array
from lobewise.fitting.fit import COSINES, Evaluate
from lobewise.render.loading import load_scene
from lobewise.render.materials.bsdfs import list_nested, list_shapes
from lobewise.render.materials.fitted import (
    is_isotropic,
    list_fitted_views,
    make_azimuths,
    make_specular_evaluate,
    make_views,
)
from lobewise.render.materials.probe import list_parts

_MAX_SHOWN_NAMES = 5
"""Number of ids that an error message lists."""


@dataclass(frozen=True)
class SceneMaterial:
    """The smooth specular part of a BSDF, and the views at which to fit it."""

    name: str
    evaluate: Evaluate
    """BRDF in a local frame whose x is the BSDF's tangent."""
    cosines: Array
    """n.v of the views, (V,)."""
    azimuths: Array | None
    """Azimuths of the views, radians, (P,), for an anisotropic material; otherwise None."""


def open_scene_material(reference: str) -> SceneMaterial:
    """Return a material of a scene.

    Parameters
    ----------
    reference : str
        ``SCENE#ID``: a scene for `load_scene`, and the id of a BSDF or of a shape with a BSDF.

    Raises
    ------
    InputError
        If there is no ``#``, no such scene or id, several BSDFs have the id, or the BSDF has no glossy lobe to fit.
    FileError
        If the scene's file cannot be read.
    UnsupportedBsdfError
        If the BSDF cannot be evaluated.
    MissingDependencyError
        If Mitsuba or libLLVM is not installed.
    """
    scene, mark, name = reference.rpartition("#")
    if not (mark and scene and name):
        raise InputError(
            "Mitsuba material",
            expected="SCENE#ID, a scene and the id of a BSDF or shape in it",
            got=repr(reference),
            action="pass for example scene.xml#paint",
        )
    bsdf = _look_up_bsdf(load_scene(scene), scene, name)
    evaluate = make_specular_evaluate(bsdf, list_parts(bsdf))
    if evaluate is None:
        expected = "a glossy lobe"
        got = "mirrors or diffuse lobes alone"
        raise InputError(f"BSDF {name!r}", expected=expected, got=got, action="only glossy reflection can be fitted")
    isotropic = is_isotropic(evaluate)
    cosines = list_fitted_views(evaluate, np.asarray(COSINES) if isotropic else make_views(isotropic))
    return SceneMaterial(name, evaluate, cosines, None if isotropic else make_azimuths())


def _look_up_bsdf(scene: Any, scene_name: str, name: str) -> Any:
    bsdfs: dict[str, dict[int, Any]] = {}
    for shape in list_shapes(scene):
        bsdf = shape.bsdf()
        if bsdf is not None:
            bsdfs.setdefault(str(shape.id()), {})[bsdf.ptr] = bsdf
            for inner in list_nested(bsdf):
                bsdfs.setdefault(str(inner.id()), {})[inner.ptr] = inner
    bsdfs.pop("", None)
    if name not in bsdfs:
        near = difflib.get_close_matches(name, bsdfs, n=_MAX_SHOWN_NAMES, cutoff=0.0)
        expected = f"the id of one of its BSDFs or shapes, such as {', '.join(near)}" if near else "named BSDFs"
        action = "correct the id" if near else "give the BSDF an id in the scene"
        raise InputError(f"scene {scene_name!r}", expected=expected, got=repr(name), action=action)
    if len(bsdfs[name]) > 1:
        expected = f"one BSDF with the id {name!r}"
        got = str(len(bsdfs[name]))
        raise InputError(f"scene {scene_name!r}", expected=expected, got=got, action="name the shape that carries it")
    return next(iter(bsdfs[name].values()))
