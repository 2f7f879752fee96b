"""Conventions of foreign frames are checked: what guides are is measured, mended where it is sure, else told."""

from lobewise.interchange.checks.denoised import MARKED, check_own_mark
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.lacks import describe_alone, list_uses

__all__ = ["MARKED", "Finding", "check_own_mark", "describe_alone", "list_uses"]
