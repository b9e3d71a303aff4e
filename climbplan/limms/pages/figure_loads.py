"""Figure of forces and joint torques of modules while they hold or push the box."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.limms.modules.loads import compute_loads
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)


def plot_loads(plan: LimmsPlan) -> Figure:
    """Plot the force of each module and the torque at its worst joint, with limits."""
    loads = compute_loads(plan)
    count = len(plan.module_names)
    figure = new_figure(3.9, entries=count + 2)
    draw_heading(figure, format_plain(plan.title or plan.name), "from the box's forces alone")
    left, right = figure.subplots(1, 2)
    limit = float(plan.module["max_force"])
    _plot_curves(left, plan, loads.force, limit)
    draw_panel_title(left, "Force [N]", f"limit {limit:g} N")
    _plot_curves(right, plan, loads.torque, loads.limit)
    draw_panel_title(right, "Torque at the worst joint [N m]", f"limit {loads.limit:g} N m")
    if loads.own_weight <= loads.limit:
        right.axhline(loads.own_weight, color=palette.REQUIRED, linewidth=0.9, linestyle=":")
    handles = [
        Line2D([], [], color=palette.choose_limb_color(m), linewidth=2) for m in range(count)
    ]
    handles.append(Line2D([], [], color=palette.FAILURE, linewidth=0.9, linestyle="--"))
    handles.append(Line2D([], [], color=palette.REQUIRED, linewidth=0.9, linestyle=":"))
    names = [format_plain(name, 12) for name in plan.module_names]
    draw_foot_legend(figure, handles, [*names, "limit", "a straight module held level, itself"])
    return figure


def _plot_curves(ax: Axes, plan: LimmsPlan, values: Array, limit: float) -> None:
    """Plot one curve for each module over the time with forces."""
    time = plan.motion.time
    count = values.shape[1]
    for m in range(count):
        if values[:, m].max() > 0:
            # Decreasing widths keep coinciding curves visible
            width = 1.3 + 0.9 * (count - 1 - m)
            ax.plot(time, values[:, m], color=palette.choose_limb_color(m), linewidth=width)
    ax.axhline(limit, color=palette.FAILURE, linewidth=0.9, linestyle="--")
    start, end = _find_loaded_time(plan, values)
    ax.set_xlim(start, end)
    ax.set_ylim(0, 1.08 * max(limit, float(values.max())))
    ax.set_xlabel("time [s]")
    style_axes(ax)


def _find_loaded_time(plan: LimmsPlan, values: Array) -> tuple[float, float]:
    """Return start and end of the time with forces [s], with a margin."""
    time = plan.motion.time
    loaded = np.flatnonzero(values.max(axis=1) > 0)
    if not len(loaded):
        return float(time[0]), float(time[-1])
    start, end = float(time[loaded[0]]), float(time[loaded[-1]])
    margin = max(0.03 * (end - start), 0.02)
    return start - margin, end + margin
