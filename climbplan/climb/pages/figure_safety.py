"""Safety factors over the instants, with the values asked for."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.climb.pages.figure_series import format_rounds_label, mark_rounds
from climbplan.climb.pages.series import find_minimum, list_drawn_labels
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    build_panel_grid,
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_limb_name,
    format_plain,
    style_axes,
)


def _draw_panel(ax: Axes, plan: ClimbPlan, factor: Array, required: float, name: str) -> None:
    """One safety factor."""
    k = np.arange(plan.instants.count)
    finite = np.where(np.isfinite(factor), factor, np.nan)
    lifted = plan.instants.lifted
    ax.plot(k, finite, color=palette.TRACE, lw=1.0)
    for limb in range(plan.robot.limb_count):
        is_lifted = lifted[:, limb]
        ax.scatter(
            k[is_lifted],
            finite[is_lifted],
            s=15,
            color=palette.choose_limb_color(limb),
            lw=0,
            zorder=3,
        )
    pushed = ~lifted.any(axis=1)
    ax.scatter(
        k[pushed], finite[pushed], s=11, facecolor="white", edgecolor=palette.INK, lw=0.7, zorder=3
    )
    ax.axhline(required, color=palette.REQUIRED, lw=1.4)
    ax.axhline(1.0, color=palette.FAILURE, lw=1.2, ls=(0, (5, 2)), zorder=2.5)
    style_axes(ax)
    mark_rounds(ax, plan)
    ax.set_ylabel(name)
    what = f"{name}, {'torque' if 'tau' in name else 'friction'}"
    if np.isnan(finite).all():  # no load at all: nothing can fail
        draw_panel_title(ax, what, f"no load at any instant; asked for {required:g}")
        ax.set_ylim(0, 1.25 * required)
        return
    worst = find_minimum(factor)
    ax.scatter(worst, finite[worst], s=90, facecolor="none", edgecolor=palette.FAILURE, zorder=4)
    top = 1.15 * float(np.nanpercentile(finite, 99))  # a lone unloaded instant may run off the top
    ax.set_ylim(0, max(top, 1.25 * required))
    note = f"least {finite[worst]:.2f}: {list_drawn_labels(plan)[worst]}; asked for {required:g}"
    draw_panel_title(ax, what, note)


def safety(plan: ClimbPlan) -> Figure:
    """Return S_tau and S_mu by instant; dots in the colour of the lifted limb."""
    figure, axes = build_panel_grid(
        5.6, entries=plan.robot.limb_count + 3, rows=2, own_heights=True
    )
    upper, lower = axes[:, 0]
    _draw_panel(upper, plan, plan.forces.safety_torque, plan.limits.safety_torque, r"$S_\tau$")
    _draw_panel(lower, plan, plan.forces.safety_friction, plan.limits.safety_friction, r"$S_\mu$")
    lower.set_xlabel(format_rounds_label(plan))
    names = plan.robot.limb_names
    handles = [
        *(
            Line2D([], [], ls="", marker="o", ms=5, color=palette.choose_limb_color(i))
            for i in range(len(names))
        ),
        Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec=palette.INK),
        Line2D([], [], color=palette.REQUIRED, lw=1.4),
        Line2D([], [], color=palette.FAILURE, lw=1.2, ls=(0, (5, 2))),
    ]
    labels = [
        *(f"{format_limb_name(name)} lifted" for name in names),
        "pushed",
        "asked for",
        "failure",
    ]
    draw_foot_legend(figure, handles, labels)
    draw_heading(figure, "Safety factors", format_plain(f"{plan.name}, {plan.robot.name}"))
    return figure
