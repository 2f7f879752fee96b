"""Conventions of foreign frames are checked: what guides are is measured, mended where it is sure, else told."""

from lobewise.interchange.checks.alone import describe_alone
from lobewise.interchange.checks.checking import Guides, check_alpha, check_guides, check_places
from lobewise.interchange.checks.compression import check_compression
from lobewise.interchange.checks.denoised import MARKED, check_mark, check_own_mark
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.noise import SHARED, check_noise
from lobewise.interchange.checks.roughness import find_second, name_assumption

__all__ = [
    "MARKED",
    "SHARED",
    "Finding",
    "Guides",
    "check_alpha",
    "check_compression",
    "check_guides",
    "check_mark",
    "check_noise",
    "check_own_mark",
    "check_places",
    "describe_alone",
    "find_second",
    "name_assumption",
]
