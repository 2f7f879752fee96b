"""Figures as PNG bytes; the only user of Matplotlib."""

from __future__ import annotations

import io
from typing import Any

from lobewise.errors import MissingDependencyError

DOTS_PER_INCH = 110


def require_matplotlib(what: str) -> None:
    """Raise MissingDependencyError if Matplotlib is not installed; ``what`` names the plot."""
    try:
        import matplotlib.backends.backend_agg  # noqa: F401 - only to see whether it is installed
    except ImportError as problem:
        raise MissingDependencyError(
            what,
            expected="the package matplotlib",
            got=str(problem),
            action="install it with `pip install 'lobewise[fit]'` or leave the plot out",
        ) from problem


def make_figure(width: float, height: float) -> Any:
    """Return an empty figure; width and height are in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained")


def encode_figure(figure: Any) -> bytes:
    """Return a figure as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    out = io.BytesIO()
    FigureCanvasAgg(figure).print_png(out)  # type: ignore[no-untyped-call]
    return out.getvalue()
