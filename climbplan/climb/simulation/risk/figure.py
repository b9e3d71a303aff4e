"""Figure of the causes of falls: by first failure and round, and by uncertain quantity."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.risk.estimation import RiskEstimate, count_causes
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)

_MAX_ROWS = 10  # rows of a panel


def plot_causes(risk: RiskEstimate, plan: ClimbPlan) -> Figure:
    """Plot the first failures of falls, and how far quantities differ in worlds with a fall."""
    figure = new_figure(4.2, entries=0)
    left, right = figure.subplots(1, 2)
    rows = count_causes(risk, plan.robot.limb_names, plan)[:_MAX_ROWS][::-1]
    labels = [
        f"{cause}{f', {limb}' if limb else ''}, round {number}" for (cause, limb, number), _ in rows
    ]
    left.barh(np.arange(len(rows)), [frequency for _, frequency in rows], color=palette.FAILURE)
    left.set_yticks(np.arange(len(rows)), labels)
    left.set_xlabel("worlds that fall")
    draw_panel_title(left, "what went wrong first")
    ranked = risk.parameters[:_MAX_ROWS][::-1]
    right.barh(
        np.arange(len(ranked)), [difference for _, difference in ranked], color=palette.LIMBS[0]
    )
    right.set_yticks(np.arange(len(ranked)), [key for key, _ in ranked])
    right.set_xlabel("falls against stands [standard errors]")
    draw_panel_title(right, "which quantity")
    for ax in (left, right):
        style_axes(ax)
    low, high = risk.interval
    falls_text = f"{risk.falls} of {len(risk.outcomes)} worlds fall, {low:.1%} to {high:.1%}"
    draw_heading(figure, f"{format_plain(plan.name)}: {falls_text}", risk.engine)
    return figure
