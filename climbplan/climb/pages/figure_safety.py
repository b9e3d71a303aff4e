"""Safety factors over the instants, with the values asked for."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.climb.pages.figure_series import mark_rounds, rounds_label
from climbplan.climb.pages.series import drawn_labels, least_at
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    foot_legend,
    heading,
    limb_name,
    panel_grid,
    panel_title,
    plain,
    style_axes,
)


def _panel(ax: Axes, plan: ClimbPlan, factor: Array, asked: float, name: str) -> None:
    """One safety factor."""
    k = np.arange(plan.instants.count)
    finite = np.where(np.isfinite(factor), factor, np.nan)
    lifted = plan.instants.lifted
    ax.plot(k, finite, color=palette.TRACE, lw=1.0)
    for limb in range(plan.robot.limb_count):
        here = lifted[:, limb]
        ax.scatter(k[here], finite[here], s=15, color=palette.limb_color(limb), lw=0, zorder=3)
    pushed = ~lifted.any(axis=1)
    ax.scatter(
        k[pushed], finite[pushed], s=11, facecolor="white", edgecolor=palette.INK, lw=0.7, zorder=3
    )
    ax.axhline(asked, color=palette.REQUIRED, lw=1.4)
    ax.axhline(1.0, color=palette.FAILURE, lw=1.2, ls=(0, (5, 2)), zorder=2.5)
    style_axes(ax)
    mark_rounds(ax, plan)
    ax.set_ylabel(name)
    what = f"{name}, {'torque' if 'tau' in name else 'friction'}"
    if np.isnan(finite).all():  # no load at all: nothing can fail
        panel_title(ax, what, f"no load at any instant; asked for {asked:g}")
        ax.set_ylim(0, 1.25 * asked)
        return
    worst = least_at(factor)
    ax.scatter(worst, finite[worst], s=90, facecolor="none", edgecolor=palette.FAILURE, zorder=4)
    top = 1.15 * float(np.nanpercentile(finite, 99))  # a lone unloaded instant may run off the top
    ax.set_ylim(0, max(top, 1.25 * asked))
    note = f"least {finite[worst]:.2f}: {drawn_labels(plan)[worst]}; asked for {asked:g}"
    panel_title(ax, what, note)


def safety(plan: ClimbPlan) -> Figure:
    """S_tau and S_mu by instant; dots in the colour of the lifted limb."""
    figure, axes = panel_grid(5.6, entries=plan.robot.limb_count + 3, rows=2, own_heights=True)
    upper, lower = axes[:, 0]
    _panel(upper, plan, plan.forces.safety_torque, plan.limits.safety_torque, r"$S_\tau$")
    _panel(lower, plan, plan.forces.safety_friction, plan.limits.safety_friction, r"$S_\mu$")
    lower.set_xlabel(rounds_label(plan))
    names = plan.robot.limb_names
    handles = [
        *(
            Line2D([], [], ls="", marker="o", ms=5, color=palette.limb_color(i))
            for i in range(len(names))
        ),
        Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec=palette.INK),
        Line2D([], [], color=palette.REQUIRED, lw=1.4),
        Line2D([], [], color=palette.FAILURE, lw=1.2, ls=(0, (5, 2))),
    ]
    labels = [*(f"{limb_name(name)} lifted" for name in names), "pushed", "asked for", "failure"]
    foot_legend(figure, handles, labels)
    heading(figure, "Safety factors", plain(f"{plan.name}, {plan.robot.name}"))
    return figure
