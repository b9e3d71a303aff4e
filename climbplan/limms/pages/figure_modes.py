"""Figure of modes over time: one bar for each box and each module."""

from __future__ import annotations

import itertools
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from climbplan.limms.pages.time_axis import TimeScale
from climbplan.limms.plan.limms_plan import BOX_MODES, MODULE_MODES, LimmsPlan
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)

BOX_COLORS = {1: "#C9D2DC", 2: "#56B4E9", 3: "#E69F00", 4: "#009E73"}
_STYLES = ("-", "--", "-.")  # of boxes
MODULE_COLORS = {1: "#E4E9EF", 2: "#D55E00", 3: "#F0B48A", 4: "#0072B2", 5: "#9CC7E8"}


def plot_modes(plan: LimmsPlan) -> Figure:
    """Plot modes and latches over time, and the path of each box."""
    motion = plan.motion
    count = plan.deliveries
    rows = len(plan.module_names) + count
    figure = new_figure(2.6 + 0.42 * rows, entries=len(BOX_MODES) + len(MODULE_MODES))
    draw_heading(figure, format_plain(plan.title or plan.name), format_plain(plan.sequence))
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=[0.5 * rows + 0.3, 1.6])
    boxes = ["box"] if count == 1 else [f"box {b}" for b in range(count)]
    names = [*boxes, *plan.module_names]
    scale = TimeScale(plan)
    for row in range(len(names)):
        is_box = row < count
        mode = motion.box_mode[:, row] if is_box else motion.mode[:, row - count]
        colors = BOX_COLORS if is_box else MODULE_COLORS
        for first, last in _find_runs(mode):
            start, end = motion.time[first], motion.time[last]
            color = colors.get(int(mode[first]), palette.FAILURE)
            top.barh(row, end - start, left=start, height=0.72, color=color, linewidth=0)
        if not is_box:
            _label_latches(plan, row - count, row, top, scale)

    top.set_yticks(range(len(names)), [format_plain(name, 12) for name in names])
    top.invert_yaxis()
    draw_panel_title(top, "Modes", "text: the anchors that a module's ends are latched to")
    style_axes(top)
    for b, axis in product(range(count), range(3)):
        color, style = palette.LIMBS[axis], _STYLES[b % len(_STYLES)]
        label = "xyz"[axis] + (f", {boxes[b]}" if count > 1 else "")
        path = motion.box_position[:, b, axis]
        below.plot(motion.time, path, label=label, color=color, linewidth=1.4, linestyle=style)
        below.axhline(plan.goal[b, axis], color=color, linewidth=0.7, linestyle=":")
    below.set_xlabel(scale.label)
    below.set_ylabel("box [m]")
    is_turned = bool(motion.box_yaw.any() or plan.goal_yaw.any())
    if is_turned:
        _plot_yaws(plan, below)
    below.legend(frameon=False, fontsize=8, ncols=3 + is_turned, loc="upper left")
    draw_panel_title(below, "Centre of the box" + "es" * (count > 1), "dots: goal")
    style_axes(below)
    scale.apply((top, below))
    handles = [Patch(color=c) for c in (*BOX_COLORS.values(), *MODULE_COLORS.values())]
    labels = [*(f"box {n}" for n in BOX_MODES.values()), *MODULE_MODES.values()]
    draw_foot_legend(figure, handles, labels)
    return figure


def _plot_yaws(plan: LimmsPlan, ax: Axes) -> None:
    """Plot the yaws of boxes on an axis of their own."""
    right = ax.twinx()
    for b in range(plan.deliveries):
        style = _STYLES[b % len(_STYLES)]
        yaw = np.degrees(plan.motion.box_yaw[:, b])
        ax.plot([], [], label="yaw", color=palette.INK, linewidth=1.4, linestyle=style)
        right.plot(plan.motion.time, yaw, color=palette.INK, linewidth=1.4, linestyle=style)
    right.set_ylabel("yaw [deg]", fontsize=ax.yaxis.label.get_fontsize())
    right.tick_params(labelsize=ax.yaxis.get_ticklabels()[0].get_fontsize())
    right.spines["top"].set_visible(False)


def _find_runs(values: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last index of each run of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return [(a, b - 1) for a, b in itertools.pairwise(edges)]


def _label_latches(plan: LimmsPlan, module: int, row: int, ax: Axes, scale: TimeScale) -> None:
    """Write the names of anchors into the bars."""
    motion = plan.motion
    anchor_pairs = motion.base_anchor[:, module] * 100_000 + motion.tip_anchor[:, module]
    for first, last in _find_runs(anchor_pairs):
        names = [
            _name_anchor(plan, int(a))
            for a in (motion.base_anchor[first, module], motion.tip_anchor[first, module])
            if a >= 0
        ]
        start, end = motion.time[first], motion.time[last]
        width = float(np.diff(scale.map_times(np.array([start, end])))[0])
        if names and width > 0.05:
            text = format_plain(" + ".join(names), 28)
            color = palette.choose_ink(
                MODULE_COLORS.get(int(motion.mode[first, module]), palette.FAILURE)
            )
            ax.text(
                (start + end) / 2, row, text, ha="center", va="center", fontsize=7.5, color=color
            )


def _name_anchor(plan: LimmsPlan, anchor: int) -> str:
    """Return an anchor's name, or the module whose end it is."""
    num_anchors = len(plan.anchor_names)
    if anchor < num_anchors:
        return plan.anchor_names[anchor]
    module = (anchor - num_anchors) // 2
    return f"on {plan.module_names[module]}" if module < len(plan.module_names) else "nothing"
