"""The gait of a closed loop about a push: contacts, footholds, speed, and sources of plans."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke

from climbplan.arrays import Array
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)
from climbplan.walking.online.candidate_selection import (
    NAMED_GAIT,
    PLAN_CONTINUES,
    PREVIOUS_PLAN,
    SAFE_STANCE,
)
from climbplan.walking.plan.walk_plan import LoopRecord, WalkPlan
from climbplan.walking.task.task import VELOCITY

_BEFORE, _AFTER = 0.4, 1.0  # [s] of the window about a push
_PUSH = palette.FAILURE
_NEIGHBOUR = 0  # and all other sections of the library: one colour
_SOURCES = {  # of ticks: word, colour
    PREVIOUS_PLAN: ("plan before", palette.GRID),
    _NEIGHBOUR: ("neighbour", palette.MUTED),
    NAMED_GAIT: ("named gait", palette.INK),
    SAFE_STANCE: ("safe stance", palette.FAILURE),
    PLAN_CONTINUES: ("plan kept", palette.TRACE),  # between knots
}


def plot_loop_gait(plan: WalkPlan) -> Figure:
    """Plot all contacts, and about the first push lengths of steps, speed and sources of plans."""
    assert plan.loop is not None
    task = plan.task
    pushes = list_push_times(plan)
    end = task.dt * task.knots
    first = max(0.0, pushes[0] - _BEFORE) if pushes else 0.0
    window = (first, min(end, first + _BEFORE + _AFTER))
    figure = new_figure(6.4, entries=len(_SOURCES) + task.body.leg_count)
    whole, detail, speed = figure.subplots(3, 1, height_ratios=(1.0, 1.35, 1.15))
    _plot_contacts(whole, plan)
    whole.set_xlim(0, end)
    whole.axvspan(*window, color=palette.GRID, alpha=0.5, lw=0, zorder=0)
    draw_panel_title(whole, "Standing legs", "darker: pushes harder")
    _plot_contacts(detail, plan)
    _plot_step_lengths(detail, plan, window)
    detail.set_xlim(*window)
    draw_panel_title(
        detail, "About the push" if pushes else "The beginning", "length of each step [cm]"
    )
    _plot_speed(speed, plan, window)
    _plot_sources(speed, plan, plan.loop)
    speed.set_xlim(*window)
    speed.set_xlabel("time [s]")
    draw_panel_title(speed, "Forward speed", "[m/s], what each tick chose below")
    for ax in (whole, detail, speed):
        mark_pushes(ax, plan)
    handles = [Patch(color=color) for _, color in _SOURCES.values()]
    labels = [label for label, _ in _SOURCES.values()]
    line = Line2D([], [], color=_PUSH, lw=1.4, ls=":")
    draw_foot_legend(figure, [*handles, line], [*labels, "push"])
    draw_heading(figure, f"{format_plain(plan.title or plan.name)}: gait", _format_pushes(plan))
    return figure


def list_push_times(plan: WalkPlan) -> list[float]:
    """List the times of all pushes of a closed loop [s]; none offline."""
    if plan.loop is None:
        return []
    times: list[float] = (plan.task.dt * np.flatnonzero(plan.loop.push.any(axis=1))).tolist()
    return times


def mark_pushes(ax: Axes, plan: WalkPlan) -> None:
    """Mark each push by a dotted line."""
    for time in list_push_times(plan):
        ax.axvline(time, color=_PUSH, lw=1.4, ls=":", zorder=4)


def split_runs(values: Array) -> list[tuple[int, int]]:
    """Split values into runs [first, last) of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return list(pairwise(edges))


def _format_pushes(plan: WalkPlan) -> str:
    """Return the text about the pushes."""
    if plan.loop is None or not plan.loop.push.any():
        return "no push"
    pushes = plan.loop.push[plan.loop.push.any(axis=1)]
    velocities = ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in pushes[:3].tolist())
    return f"pushed by {velocities} m/s"


def _plot_contacts(ax: Axes, plan: WalkPlan) -> None:
    """Plot contacts as bars, darker for larger forces."""
    task, trajectory = plan.task, plan.trajectory
    push = np.linalg.norm(trajectory.force[:-1], axis=-1)
    max_force = max(float(push.max()), 1e-9)
    for leg in range(task.body.leg_count):
        color, stands = palette.choose_limb_color(leg), trajectory.gait.contact[:-1, leg]
        for first, last in split_runs(np.where(stands, push[:, leg], -1.0)):
            if stands[first]:
                corner = (task.dt * first, task.body.leg_count - 1 - leg - 0.36)
                shade = 0.25 + 0.75 * push[first, leg] / max_force
                wide = task.dt * (last - first)
                ax.add_patch(Rectangle(corner, wide, 0.72, color=color, alpha=shade, lw=0))
    style_axes(ax)
    ax.set_ylim(-0.6, task.body.leg_count - 0.4)
    ax.set_yticks(
        range(task.body.leg_count),
        list(reversed([format_plain(n, 10) for n in task.body.leg_names])),
    )
    ax.grid(visible=False, axis="y")


def _plot_step_lengths(ax: Axes, plan: WalkPlan, window: tuple[float, float]) -> None:
    """Write the length of each step along the reference's direction into its bar."""
    task, trajectory = plan.task, plan.trajectory
    ahead = _read_direction(plan)
    for leg in range(task.body.leg_count):
        stands = trajectory.gait.contact[:-1, leg]
        last: Array | None = None
        for first, end in split_runs(stands.astype(float)):
            if not stands[first]:
                continue
            spot = trajectory.toes[first, leg, :2]
            middle = task.dt * (first + end) / 2
            if last is not None and window[0] < middle < window[1]:
                length = 100 * float((spot - last) @ ahead)
                back = length < -0.5
                ax.text(
                    middle,
                    task.body.leg_count - 1 - leg,
                    f"{length:+.0f}",
                    ha="center",
                    va="center",
                    fontsize=8,
                    fontweight="bold" if back else "normal",
                    color=_PUSH if back else palette.INK,
                    path_effects=[withStroke(linewidth=2.0, foreground="white")],  # on dark bars
                )
            last = spot


def _plot_speed(ax: Axes, plan: WalkPlan, window: tuple[float, float]) -> None:
    """Plot the forward speed with its reference."""
    task, ahead = plan.task, _read_direction(plan)
    time = task.dt * np.arange(task.knots + 1)
    in_window = (time >= window[0] - 1e-9) & (time <= window[1] + 1e-9)
    speed = plan.trajectory.state[:, VELOCITY][:, :2] @ ahead
    reference = task.reference.velocity[:, :2] @ ahead
    ax.plot(time[1:], reference, color=palette.INK, lw=1.2, ls="--")
    ax.plot(time, speed, color=palette.LIMBS[0], lw=1.8)
    style_axes(ax)
    low, high = float(speed[in_window].min()), float(max(speed[in_window].max(), reference.max()))
    margin = 0.12 * max(high - low, 0.2)
    ax.set_ylim(low - 3 * margin, high + margin)


def _plot_sources(ax: Axes, plan: WalkPlan, loop: LoopRecord) -> None:
    """Plot a strip with the source of each tick's plan."""
    bottom, top = ax.get_ylim()
    height = 0.1 * (top - bottom)
    source = np.minimum(loop.winner[:-1], _NEIGHBOUR)
    for first, last in split_runs(source.astype(float)):
        corner, wide = (plan.task.dt * first, bottom), plan.task.dt * (last - first)
        _, color = _SOURCES[int(source[first])]
        ax.add_patch(Rectangle(corner, wide, height, color=color, lw=0))


def _read_direction(plan: WalkPlan) -> Array:
    """Return the horizontal direction (2,) of the reference."""
    reference = plan.task.reference.velocity[-1, :2]
    size = float(np.hypot(*reference))
    direction: Array = reference / size if size > 1e-6 else np.array([1.0, 0.0])
    return direction
