"""Conventions of foreign frames are checked: what guides are is measured, mended where it is sure, else told."""

from lobewise.interchange.checks.checking import Guides, check_alpha, check_guides, check_places
from lobewise.interchange.checks.compression import check_compression
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.noise import SHARED, check_noise
from lobewise.interchange.checks.roughness import find_second, name_assumption

__all__ = [
    "SHARED",
    "Finding",
    "Guides",
    "check_alpha",
    "check_compression",
    "check_guides",
    "check_noise",
    "check_places",
    "find_second",
    "name_assumption",
]
