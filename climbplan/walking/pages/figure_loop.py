"""How a closed loop's gait answers a push: who stands when, where toes are put, who decided."""

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
    foot_legend,
    heading,
    new_figure,
    panel_title,
    plain,
    style_axes,
)
from climbplan.walking.online.choice import FALLBACK, KEPT, LAST, SAFE
from climbplan.walking.plan.walk_plan import LoopRecord, WalkPlan
from climbplan.walking.task.task import VELOCITY

_BEFORE, _AFTER = 0.4, 1.0  # [s] of the window about a push
_PUSH = palette.FAILURE
_NEIGHBOUR = 0  # and sections of the library beyond: one colour for all
_WINNERS = {  # of ticks: word, colour
    LAST: ("plan before", palette.GRID),
    _NEIGHBOUR: ("neighbour", palette.MUTED),
    FALLBACK: ("named gait", palette.INK),
    SAFE: ("safe stance", palette.FAILURE),
    KEPT: ("plan kept", palette.TRACE),  # between knots
}


def loop_gait(plan: WalkPlan) -> Figure:
    """The whole walk's contacts; about the first push each step's length, speed and deciders."""
    assert plan.loop is not None
    task = plan.task
    pushes = push_times(plan)
    end = task.step * task.knots
    first = max(0.0, pushes[0] - _BEFORE) if pushes else 0.0
    window = (first, min(end, first + _BEFORE + _AFTER))
    figure = new_figure(6.4, entries=len(_WINNERS) + task.body.leg_count)
    whole, near, speed = figure.subplots(3, 1, height_ratios=(1.0, 1.35, 1.15))
    _bars(whole, plan)
    whole.set_xlim(0, end)
    whole.axvspan(*window, color=palette.GRID, alpha=0.5, lw=0, zorder=0)
    panel_title(whole, "Standing legs", "darker: pushes harder")
    _bars(near, plan)
    _step_lengths(near, plan, window)
    near.set_xlim(*window)
    panel_title(near, "About the push" if pushes else "The beginning", "length of each step [cm]")
    _speed(speed, plan, window)
    _deciders(speed, plan, plan.loop)
    speed.set_xlim(*window)
    speed.set_xlabel("time [s]")
    panel_title(speed, "Forward speed", "[m/s], what each tick chose below")
    for ax in (whole, near, speed):
        mark_pushes(ax, plan)
    handles = [Patch(color=color) for _, color in _WINNERS.values()]
    words = [word for word, _ in _WINNERS.values()]
    line = Line2D([], [], color=_PUSH, lw=1.4, ls=":")
    foot_legend(figure, [*handles, line], [*words, "push"])
    heading(figure, f"{plain(plan.title or plan.name)}: gait", _note(plan))
    return figure


def push_times(plan: WalkPlan) -> list[float]:
    """[s] of all pushes of a closed loop; none offline."""
    if plan.loop is None:
        return []
    found: list[float] = (plan.task.step * np.flatnonzero(plan.loop.push.any(axis=1))).tolist()
    return found


def mark_pushes(ax: Axes, plan: WalkPlan) -> None:
    """A dotted line at each push."""
    for at in push_times(plan):
        ax.axvline(at, color=_PUSH, lw=1.4, ls=":", zorder=4)


def even_runs(values: Array) -> list[tuple[int, int]]:
    """Runs [first, last) of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return list(pairwise(edges))


def _note(plan: WalkPlan) -> str:
    if plan.loop is None or not plan.loop.push.any():
        return "no push"
    pushes = plan.loop.push[plan.loop.push.any(axis=1)]
    told = ", ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in pushes[:3].tolist())
    return f"pushed by {told} m/s"


def _bars(ax: Axes, plan: WalkPlan) -> None:
    task, found = plan.task, plan.trajectory
    push = np.linalg.norm(found.force[:-1], axis=-1)
    most = max(float(push.max()), 1e-9)
    for leg in range(task.body.leg_count):
        color, stands = palette.limb_color(leg), found.gait.contact[:-1, leg]
        for first, last in even_runs(np.where(stands, push[:, leg], -1.0)):
            if stands[first]:
                corner = (task.step * first, task.body.leg_count - 1 - leg - 0.36)
                shade = 0.25 + 0.75 * push[first, leg] / most
                wide = task.step * (last - first)
                ax.add_patch(Rectangle(corner, wide, 0.72, color=color, alpha=shade, lw=0))
    style_axes(ax)
    ax.set_ylim(-0.6, task.body.leg_count - 0.4)
    ax.set_yticks(
        range(task.body.leg_count), list(reversed([plain(n, 10) for n in task.body.leg_names]))
    )
    ax.grid(visible=False, axis="y")


def _step_lengths(ax: Axes, plan: WalkPlan, window: tuple[float, float]) -> None:
    """How far ahead of its last foothold each leg stands, along the reference's direction."""
    task, found = plan.task, plan.trajectory
    ahead = _direction(plan)
    for leg in range(task.body.leg_count):
        stands = found.gait.contact[:-1, leg]
        last: Array | None = None
        for first, end in even_runs(stands.astype(float)):
            if not stands[first]:
                continue
            spot = found.toes[first, leg, :2]
            middle = task.step * (first + end) / 2
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


def _speed(ax: Axes, plan: WalkPlan, window: tuple[float, float]) -> None:
    task, ahead = plan.task, _direction(plan)
    time = task.step * np.arange(task.knots + 1)
    shown = (time >= window[0] - 1e-9) & (time <= window[1] + 1e-9)
    speed = plan.trajectory.state[:, VELOCITY][:, :2] @ ahead
    wanted = task.reference.velocity[:, :2] @ ahead
    ax.plot(time[1:], wanted, color=palette.INK, lw=1.2, ls="--")
    ax.plot(time, speed, color=palette.LIMBS[0], lw=1.8)
    style_axes(ax)
    low, high = float(speed[shown].min()), float(max(speed[shown].max(), wanted.max()))
    room = 0.12 * max(high - low, 0.2)
    ax.set_ylim(low - 3 * room, high + room)


def _deciders(ax: Axes, plan: WalkPlan, loop: LoopRecord) -> None:
    """A strip along the foot: what each tick's plan came from."""
    bottom, top = ax.get_ylim()
    height = 0.1 * (top - bottom)
    winner = np.minimum(loop.winner[:-1], _NEIGHBOUR)
    for first, last in even_runs(winner.astype(float)):
        corner, wide = (plan.task.step * first, bottom), plan.task.step * (last - first)
        _, color = _WINNERS[int(winner[first])]
        ax.add_patch(Rectangle(corner, wide, height, color=color, lw=0))


def _direction(plan: WalkPlan) -> Array:
    """(2,) of the reference's velocity, along x where that stands."""
    wanted = plan.task.reference.velocity[-1, :2]
    size = float(np.hypot(*wanted))
    ahead: Array = wanted / size if size > 1e-6 else np.array([1.0, 0.0])
    return ahead
