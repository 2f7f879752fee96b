"""Checks of the conventions of foreign frames. Sure errors are corrected, doubtful ones are reported."""

from lobewise.interchange.checks.denoised import MARKED
from lobewise.interchange.checks.finding import Finding
from lobewise.interchange.checks.lacks import describe_alone, list_uses

__all__ = ["MARKED", "Finding", "describe_alone", "list_uses"]
