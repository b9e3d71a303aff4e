"""Gripping forces and pull-out margins over the instants, one line a limb."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.climb.pages.figure_series import format_rounds_label, mark_rounds
from climbplan.climb.pages.series import list_drawn_labels
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_limb_name,
    format_plain,
    new_figure,
    style_axes,
)


def grips(plan: ClimbPlan) -> Figure:
    """Return gripping force, pull on the holds and what more they would hold, limbs in contact."""
    gripper, grip_plan = plan.robot.gripper, plan.grips
    assert gripper is not None
    assert grip_plan is not None
    names, contact = plan.robot.limb_names, plan.instants.contact
    figure = new_figure(7.6, entries=len(names) + 1)
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    force = np.where(contact, grip_plan.instants.grip, np.nan)
    _draw_lines(top, force)
    top.axhline(gripper.max_force, color=palette.FAILURE, lw=1.2, ls=(0, (5, 2)))
    worst = int(np.nanargmax(np.nanmax(force, axis=1)))
    max_text = f"most {np.nanmax(force):.1f} N: {list_drawn_labels(plan)[worst]}"
    draw_panel_title(
        top, "Gripping force of each finger", f"{max_text}; limit {gripper.max_force:g} N"
    )
    onto = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    pull = np.where(contact, -onto, np.nan)
    _draw_lines(middle, pull)
    middle.axhline(0.0, color=palette.MUTED, lw=0.8)
    draw_panel_title(middle, "Pull on the holds", "below zero the limb pushes")
    margin = np.where(contact & np.isfinite(grip_plan.pull_margin), grip_plan.pull_margin, np.nan)
    _draw_lines(bottom, margin)
    min_text = "no pull is too much"
    if not np.isnan(margin).all():
        k, limb = np.unravel_index(int(np.nanargmin(margin)), margin.shape)
        min_text = f"least {margin[k, limb]:.1f} N: {list_drawn_labels(plan)[k]}, {names[limb]}"
    draw_panel_title(
        bottom, "Further pull held at that gripping force, without safety factor", min_text
    )
    bottom.set_ylim(0, None)
    for ax in (top, middle, bottom):
        style_axes(ax)
        mark_rounds(ax, plan)
        ax.set_ylabel("N")
    top.set_ylim(0, 1.1 * max(gripper.max_force, float(np.nanmax(force))))
    bottom.set_xlabel(format_rounds_label(plan))
    handles = [
        *(Line2D([], [], color=palette.choose_limb_color(i), lw=1.4) for i in range(len(names))),
        Line2D([], [], color=palette.FAILURE, lw=1.2, ls=(0, (5, 2))),
    ]
    draw_foot_legend(figure, handles, [*(format_limb_name(name) for name in names), "limit"])
    draw_heading(figure, "Grips", format_plain(f"{plan.name}, {plan.robot.name}"))
    return figure


def _draw_lines(ax: Axes, values: Array) -> None:
    """One line a limb (K, N), broken where it is lifted."""
    k = np.arange(len(values))
    for limb in range(values.shape[1]):
        ax.plot(k, values[:, limb], "o-", color=palette.choose_limb_color(limb), lw=1.2, ms=2.5)
