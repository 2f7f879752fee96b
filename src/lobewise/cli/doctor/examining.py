"""Looks at everything that `lobewise doctor` reports."""

from __future__ import annotations

import lobewise
from lobewise.cli.doctor.folders import examine_cache, examine_data
from lobewise.cli.doctor.machine import (
    examine_devices,
    examine_kernels,
    examine_mitsuba,
    examine_platform,
    examine_program,
    examine_python,
    examine_terminal,
)
from lobewise.cli.doctor.packages import examine_extras, examine_packages
from lobewise.cli.doctor.report import Report


def examine() -> Report:
    """Return facts and problems of this machine. A kernel is run; the first one on a machine takes some seconds."""
    parts = (
        examine_program,
        examine_python,
        examine_platform,
        examine_terminal,
        examine_packages,
        examine_extras,
        examine_devices,
        examine_kernels,
        examine_mitsuba,
        examine_cache,
        examine_data,
    )
    return Report(lobewise.__version__, tuple(part() for part in parts))
