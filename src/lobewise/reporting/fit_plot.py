"""A plot of fitted lobes against the data of a material: cuts in the plane of incidence, as PNG by Matplotlib."""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np

from lobewise.errors import MissingDependencyError
from lobewise.fitting.arrays import Array, make_view
from lobewise.fitting.fit import Evaluate, measure_reflection
from lobewise.fitting.table import TableLobes, evaluate_lobes, evaluate_table
from lobewise.lobes.vectors import LUMINANCE
from lobewise.records.lobe_table import LobeTable

DOTS_PER_INCH = 110
VIEW_COSINES = (1.0, 0.8, 0.6, 0.4, 0.2, 0.1)
"""n.v of the cuts. Each cut is drawn at the nearest view of the table."""
AXIS_DECADES = 5.0
"""Height of the logarithmic axis, powers of ten."""


def require_matplotlib() -> None:
    """Raise MissingDependencyError if Matplotlib is not installed."""
    try:
        import matplotlib.backends.backend_agg  # noqa: F401 - only to see whether it is installed
    except ImportError as problem:
        raise MissingDependencyError(
            "the plot of a fit",
            expected="the package matplotlib",
            got=str(problem),
            action="install it with `pip install 'lobewise[fit]'` or leave the plot out",
        ) from problem


def draw_fit(table: LobeTable, evaluate: Evaluate) -> bytes:
    """Return a PNG of reflected luminance times cosine over the light's angle, data against lobes.

    The cuts are at the first azimuth of the table; ``evaluate`` is the material that the lobes were fitted to.

    Raises MissingDependencyError if Matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = sorted({int(np.argmin(np.abs(table.cosine - cosine))) for cosine in VIEW_COSINES}, reverse=True)
    inches = 11.0, 3.4 * math.ceil(len(rows) / 3) + 0.5
    figure = Figure(figsize=inches, dpi=DOTS_PER_INCH, layout="constrained")
    panels = figure.subplots(math.ceil(len(rows) / 3), min(3, len(rows)), squeeze=False).ravel()
    for panel in panels[len(rows) :]:
        panel.set_axis_off()
    for panel, row in zip(panels, rows, strict=False):
        _draw_cut(panel, table, row, evaluate)
    panels[0].set_ylabel("luminance of BRDF times cosine, 1/sr")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="small", frameon=False)
    lobes = f"{table.lobe_count} {table.kind.upper()} lobe{'s' if table.lobe_count > 1 else ''}"
    # A dollar sign in a name would start a formula.
    figure.suptitle(f"{table.name.replace('$', '') or 'material'}: {lobes} against the data, in the plane of incidence")
    out = io.BytesIO()
    FigureCanvasAgg(figure).print_png(out)  # type: ignore[no-untyped-call]
    return out.getvalue()


def _draw_cut(panel: Any, table: LobeTable, row: int, evaluate: Evaluate) -> None:
    cosine, azimuth = float(table.cosine[row]), float(table.azimuth[0])
    mirror = math.acos(cosine)
    angle = _space_angles(mirror)
    data, lobes, light = _sample_cut(table, cosine, azimuth, angle, evaluate)
    fit = evaluate_lobes(lobes, light, table.kind)
    top = float(np.nanmax(np.append(data, fit.max())))
    floor = top * 10.0**-AXIS_DECADES
    degrees = np.degrees(angle)
    for index in range(table.lobe_count):
        only = slice(index, index + 1)
        one = TableLobes(lobes.axis[only], lobes.x[only], lobes.sharpness[only], lobes.amplitude[only])
        label = "each lobe" if index == 0 else None
        panel.plot(degrees, _mask(evaluate_lobes(one, light, table.kind), floor), color="0.7", lw=0.8, label=label)
    panel.plot(degrees, _mask(data, floor), color="black", lw=2.2, label="data")
    panel.plot(degrees, _mask(fit, floor), color="tab:orange", lw=1.2, label="sum of lobes")
    panel.axvline(math.degrees(mirror), color="0.85", lw=0.8, zorder=0)
    panel.set_yscale("log")
    panel.set_ylim(floor, 3.0 * top)
    panel.set_xlim(-90.0, 90.0)
    panel.set_xticks([-90, -45, 0, 45, 90])
    panel.set_xlabel("angle of the light, degrees (+ away from the viewer)", fontsize="small")
    panel.set_title(f"n.v {cosine:.2f}, L2 cosine {float(table.cosine_l2[row, 0]):.4f}", fontsize="medium")


def _sample_cut(
    table: LobeTable, cosine: float, azimuth: float, angle: Array, evaluate: Evaluate
) -> tuple[Array, TableLobes, Array]:
    """Return (data, lobes, lights) for lights in the plane of incidence; data is NaN where there is no measurement."""
    away, up, view = make_view([0.0, 1.0, cosine], azimuth)
    light = -np.sin(angle)[:, None] * away + np.cos(angle)[:, None] * up
    data = measure_reflection(evaluate, view, light) @ LUMINANCE * np.cos(angle)
    return data, evaluate_table(table, up, view, np.asarray([1.0, 0.0, 0.0])), light


def _space_angles(mirror: float) -> Array:
    """Return ascending angles from horizon to horizon, dense around the mirror direction."""
    limit = 0.5 * math.pi - 1e-4
    near = mirror + 1e-3 * np.sinh(np.linspace(-8.0, 8.0, 401))
    both = np.concatenate([np.linspace(-limit, limit, 361), near])
    return np.unique(both[np.abs(both) <= limit])


def _mask(values: Array, floor: float) -> Array:
    """Return values with NaN where they are far below the axis."""
    return np.asarray(np.where(values > 0.01 * floor, values, np.nan))
