"""The contact schedule: which limb stands on what over the steps, and when it is in the air."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    format_limb_name,
    format_plain,
    new_figure,
    style_axes,
)

_SHADES = ("#C9D3DE", "#8FA3B8", "#5B7188", "#D8C3A5", "#B0906A", "#7E6244", "#A9C5A0", "#6E8F63")
_LIFT, _STEP = 0.6, 1.0  # width of a lift, of a whole step


def schedule(plan: ClimbPlan) -> Figure:
    """Return one row a limb, one column a step: bars coloured by surface, gaps while it swings."""
    robot, instants = plan.robot, plan.instants
    n, steps = robot.limb_count, instants.count // 2
    surfaces_used = sorted({int(r) for r in plan.rounds.region.ravel()})
    shade = {r: _SHADES[k % len(_SHADES)] for k, r in enumerate(surfaces_used)}
    figure = new_figure(1.3 + 0.42 * n, entries=len(surfaces_used) + 1)
    ax = figure.add_subplot()
    for limb in range(n):
        row = n - 1 - limb
        start, surface = -0.4, int(plan.rounds.region[0, limb])
        for s in range(steps):
            if not instants.lifted[2 * s, limb]:
                continue
            ax.barh(row, s * _STEP - start, left=start, height=0.62, color=shade[surface])
            width = _LIFT
            ax.barh(
                row,
                width,
                left=s * _STEP,
                height=0.5,
                facecolor="white",
                edgecolor=palette.choose_limb_color(limb),
                hatch="////",
                lw=1.0,
            )
            start, surface = s * _STEP + width, int(instants.region[2 * s + 1, limb])
        ax.barh(row, steps * _STEP - start, left=start, height=0.62, color=shade[surface])
    style_axes(ax)
    ax.grid(visible=False, axis="y")
    ax.set_yticks(range(n), [format_limb_name(name) for name in reversed(robot.limb_names)])
    ax.set_xticks(
        [s * _STEP + _LIFT / 2 for s in range(steps)],
        [
            f"round {instants.round[2 * s]}: {int(instants.lifted[2 * s].sum())}"
            for s in range(steps)
        ]
        if steps <= 10
        else [str(s + 1) for s in range(steps)],
    )
    ax.set_xlim(-0.4, steps * _STEP)
    handles = [Patch(facecolor=shade[r]) for r in surfaces_used]
    handles.append(Patch(facecolor="white", edgecolor=palette.INK, hatch="////"))
    names = [format_plain(plan.terrain.surfaces[r].name, 18) for r in surfaces_used]
    draw_foot_legend(figure, handles, [*names, "in the air"])
    draw_heading(figure, "Contact schedule", format_plain(plan.contact_sequence, 90))
    return figure
