"""The features that compare two pixels: each is a distribution per pixel. Related features share a file."""

from lobewise.features.base import Feature
from lobewise.features.ggx import GgxFeature, GgxLobe
from lobewise.features.normal import DiffuseFeature, NormalFeature
from lobewise.features.position import PlaneFeature, PositionFeature
from lobewise.features.screen import BandLimitFeature, ScreenFeature, TentFeature
from lobewise.features.seen import HitDistanceFeature
from lobewise.features.sg import SgFeature, SgMixtureFeature

__all__ = [
    "BandLimitFeature",
    "DiffuseFeature",
    "Feature",
    "GgxFeature",
    "GgxLobe",
    "HitDistanceFeature",
    "NormalFeature",
    "PlaneFeature",
    "PositionFeature",
    "ScreenFeature",
    "SgFeature",
    "SgMixtureFeature",
    "TentFeature",
]
