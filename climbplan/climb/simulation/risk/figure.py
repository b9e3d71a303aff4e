"""What fells a plan, as a figure: falls by what began them and in which round, and by quantity."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.risk.judging import Judged, causes
from climbplan.reports import palette
from climbplan.reports.sheet import heading, new_figure, panel_title, plain, style_axes

_MOST = 10  # rows of a panel


def first_causes(judged: Judged, plan: ClimbPlan) -> Figure:
    """Bars of first causes, and of how far quantities differ between falls and stands."""
    figure = new_figure(4.2, entries=0)
    left, right = figure.subplots(1, 2)
    rows = causes(judged, plan.robot.limb_names, plan)[:_MOST][::-1]
    labels = [
        f"{cause}{f', {limb}' if limb else ''}, round {number}" for (cause, limb, number), _ in rows
    ]
    left.barh(np.arange(len(rows)), [many for _, many in rows], color=palette.FAILURE)
    left.set_yticks(np.arange(len(rows)), labels)
    left.set_xlabel("worlds that fall")
    panel_title(left, "what went wrong first")
    ranked = judged.parameters[:_MOST][::-1]
    right.barh(np.arange(len(ranked)), [off for _, off in ranked], color=palette.LIMBS[0])
    right.set_yticks(np.arange(len(ranked)), [key for key, _ in ranked])
    right.set_xlabel("falls against stands [standard errors]")
    panel_title(right, "which quantity")
    for ax in (left, right):
        style_axes(ax)
    low, high = judged.interval
    share = f"{judged.falls} of {len(judged.outcomes)} worlds fall, {low:.1%} to {high:.1%}"
    heading(figure, f"{plain(plan.name)}: {share}", judged.engine)
    return figure
