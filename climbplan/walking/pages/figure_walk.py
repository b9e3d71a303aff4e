"""Figures of an MPC plan: tracking, gait diagram, snapshots with forces."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle

from climbplan.arrays import Array, IntArray
from climbplan.reports import palette
from climbplan.reports.sheet import (
    foot_legend,
    heading,
    new_figure,
    panel_title,
    plain,
    style_axes,
)
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.pages.figure_loop import even_runs, mark_pushes, push_times
from climbplan.walking.plan.foot_centres import material
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, VELOCITY

_VELOCITY = "#B01E8C"
_FORCE = palette.FAILURE
_BEGUN = palette.LIMBS[1]
_SHOTS = 5
_ABOUT = (-0.5, 0.5, 1.5, 2.5, 4.5)  # knots from a push at which a closed loop is shown
_LONGEST = 0.22  # [m] arrow of the force limit
_AROUND = 0.42  # [m] shown about the body, at least
_ROOM = 0.14  # [m] beyond the boxes of toes
_DOWN = 1.2  # of what toes reach down, shown below the body
_AHEAD = 0.12  # [s] that arrows of the velocity lead ahead


def tracking(plan: WalkPlan) -> Figure:
    """Velocity and attitude against the reference."""
    task, found = plan.task, plan.trajectory
    time = task.step * np.arange(task.knots + 1)
    figure = new_figure(5.2, entries=2)
    axes = figure.subplots(2, 3, sharex=True)
    rows = (
        ("velocity", "xyz", found.state[:, VELOCITY], task.reference.velocity, "m/s"),
        (
            "",
            ("roll", "pitch", "yaw"),
            np.rad2deg(found.state[:, ANGLES]),
            np.rad2deg(task.reference.euler),
            "deg",
        ),
    )
    color = palette.LIMBS[0]
    begun = None if plan.begun is None else (plan.begun[:, VELOCITY], plan.begun[:, ANGLES])
    for line, (row, (word, names, values, wanted, unit)) in enumerate(zip(axes, rows, strict=True)):
        for k, ax in enumerate(row):
            ax.plot(time[1:], wanted[:, k], color=palette.INK, lw=1.2, ls="--")
            if begun is not None:
                before = begun[line][:, k] if line == 0 else np.rad2deg(begun[line][:, k])
                ax.plot(time, before, color=_BEGUN, lw=1.4, marker=_marker(plan), ms=2.5)
            ax.plot(time, values[:, k], color=color, lw=1.8, marker=_marker(plan), ms=3.5)
            mark_pushes(ax, plan)
            style_axes(ax)
            panel_title(ax, f"{word} {names[k]}".strip(), f"[{unit}]")
            _room(ax, 0.05 if unit == "m/s" else 1.0)
    for ax in axes[1]:
        ax.set_xlabel("time [s]")
    handles = [
        Line2D([], [], color=color, lw=1.8),
        Line2D([], [], color=palette.INK, lw=1.2, ls="--"),
    ]
    words = ["plan" if plan.loop is None else "walked", "reference"]
    if begun is not None:
        handles.append(Line2D([], [], color=_BEGUN, lw=1.4))
        words.append("trajectory that it started from")
    if push_times(plan):
        handles.append(Line2D([], [], color=_FORCE, lw=1.4, ls=":"))
        words.append("push")
    foot_legend(figure, handles, words)
    # A closed loop is tracked at its samples: their sum compares with no plan's cost.
    cost = f", cost {plan.objective:.4g}" if plan.loop is None else ""
    heading(figure, _title(plan), f"{plan.method}{cost}")
    return figure


def convergence(plan: WalkPlan) -> Figure:
    """Best cost and bound over time, and what gap they leave."""
    figure = new_figure(3.4, entries=2)
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    seconds = np.array([step.seconds for step in plan.history])
    cost = np.array([step.objective for step in plan.history])
    bound = np.array([step.bound for step in plan.history])
    proved = np.isfinite(bound)
    color = palette.LIMBS[0]
    left.step(seconds, cost, where="post", color=color, lw=1.8)
    left.step(seconds[proved], bound[proved], where="post", color=_BEGUN, lw=1.8)
    gap = 100 * (cost - bound) / np.maximum(np.abs(cost), 1e-12)
    right.step(seconds[proved], gap[proved], where="post", color=palette.INK, lw=1.6)
    for ax, name, unit in ((left, "Cost and bound", ""), (right, "Gap", "[%]")):
        style_axes(ax)
        ax.set_xlabel("time [s]")
        ax.set_ylim(0, 1.05 * ax.get_ylim()[1])
        panel_title(ax, name, unit)
    handles = [Line2D([], [], color=c, lw=1.8) for c in (color, _BEGUN)]
    foot_legend(figure, handles, ["best cost, true dynamics", "bound within the tube"])
    heading(figure, f"{_title(plan)}: convergence", plan.method)
    return figure


def gait(plan: WalkPlan) -> Figure:
    """Which legs stand when, and how hard they push."""
    task, found = plan.task, plan.trajectory
    figure = new_figure(2.7, entries=1)
    ax = figure.subplots()
    push = np.linalg.norm(found.force[:-1], axis=-1)
    most = max(float(push.max()), 1e-9)
    for leg in range(task.body.leg_count):
        color = palette.limb_color(leg)
        for first, last in even_runs(np.where(found.gait.contact[:-1, leg], push[:, leg], -1.0)):
            if found.gait.contact[first, leg]:
                shade = 0.25 + 0.75 * push[first, leg] / most
                bar = (task.step * first, task.body.leg_count - 1 - leg - 0.36)
                wide = task.step * (last - first)
                ax.add_patch(Rectangle(bar, wide, 0.72, color=color, alpha=shade, lw=0))
    style_axes(ax)
    ax.set_xlim(0, task.step * task.knots)
    ax.set_ylim(-0.6, task.body.leg_count - 0.4)
    ax.set_yticks(
        range(task.body.leg_count), list(reversed([plain(n, 10) for n in task.body.leg_names]))
    )
    ax.set_xlabel("time [s]")
    ax.grid(visible=False, axis="y")
    handles = [Patch(color=palette.INK, alpha=a, lw=0) for a in (0.25, 1.0)]
    foot_legend(figure, handles, ["contact force 0 N", f"contact force {most:.0f} N"])
    panel_title(ax, "Standing legs", "the darker, the harder they push")
    heading(figure, f"{_title(plan)}: gait", plan.method)
    return figure


def snapshots(plan: WalkPlan) -> Figure:
    """The body, its legs and its forces from the side and from above."""
    task = plan.task
    figure = new_figure(5.4, entries=9)
    axes = figure.subplots(2, _SHOTS, height_ratios=(0.52, 0.84))
    moments = _moments(plan)
    heights = plan.trajectory.state[moments, 2]
    below = max(0.30, -_DOWN * float(task.body.toe_center[:, 2].min()))
    for column in range(_SHOTS):
        for row, (x, y) in enumerate(((0, 2), (0, 1))):
            ax = axes[row, column]
            if column < len(moments):
                _shot(ax, plan, int(moments[column]), x, y)
            else:
                ax.set_visible(False)
        axes[0, column].set_ylim(heights.min() - below, heights.max() + 0.22)
        axes[1, column].set_xlabel("x [m]")
    axes[0, 0].set_ylabel("z [m]")
    axes[1, 0].set_ylabel("y [m]")
    handles = [
        Line2D([], [], color=_FORCE, lw=2),
        Line2D([], [], color=_VELOCITY, lw=2),
        Line2D([], [], color=palette.FORCE, lw=2),
        Line2D([], [], color=palette.BODY, lw=0, marker="o", ms=5),
        Line2D([], [], color=palette.BODY, lw=0, marker="o", ms=5, mfc="white"),
        *(
            Line2D([], [], color=palette.limb_color(leg), lw=1.6)
            for leg in range(task.body.leg_count)
        ),
    ]
    words = [
        f"force, {_LONGEST / task.body.force_limit * 1e3:.2g} mm/N",
        f"velocity, {_AHEAD:.2g} s of it",
        "heading",
        "toe standing",
        "swinging",
    ]
    foot_legend(figure, handles, [*words, *(plain(name, 10) for name in task.body.leg_names)])
    heading(figure, f"{_title(plan)}: snapshots", "from the side, from above")
    return figure


def _moments(plan: WalkPlan) -> IntArray:
    """Samples to show: evenly over the horizon, or a closed loop's knots about its first push."""
    task, pushes = plan.task, push_times(plan)
    moments = np.linspace(0, task.knots - 1, _SHOTS)
    if plan.loop is not None and pushes:
        moments = pushes[0] / task.step + plan.loop.samples * np.array(_ABOUT)
    shown: IntArray = np.unique(np.clip(moments, 0, task.knots - 1).round().astype(np.int64))
    return shown


def _around(plan: WalkPlan) -> float:
    """How much is shown about the body [m]."""
    body = plan.task.body
    return max(_AROUND, float((np.abs(body.toe_center) + body.toe_half)[:, :2].max()) + _ROOM)


def _shot(ax: Axes, plan: WalkPlan, n: int, x: int, y: int) -> None:
    task, found = plan.task, plan.trajectory
    state, toes = found.state[n], found.toes[n]
    com, R = state[:3], rotation_world_body(state[ANGLES])
    hips, shown = com + task.hips @ R.T, _around(plan)
    ax.set_aspect("equal")
    around = com[:2] - shown, com[:2] + shown
    ground = material(task.ground)
    for region in range(ground.count):
        corners = ground.outline(region, *around)
        if not len(corners):
            continue
        if y == 2:
            ends = corners[[corners[:, 0].argmin(), corners[:, 0].argmax()]]
            ax.plot(ends[:, 0], ends[:, 2], color=palette.SURFACE, lw=2)
        elif task.ground.count > 1:
            ax.add_patch(Polygon(corners[:, :2], color=palette.SURFACE, alpha=0.25, lw=0))
    ring = np.concatenate([hips[::2], hips[-1::-2]])
    ax.add_patch(Polygon(ring[:, [x, y]], fill=y == 1, color=palette.BODY, alpha=0.35, lw=2))
    front = hips[:2].mean(axis=0)
    ax.plot([com[x], front[x]], [com[y], front[y]], color=palette.FORCE, lw=2)
    scale = _LONGEST / task.body.force_limit
    for leg in range(task.body.leg_count):
        color, stands = palette.limb_color(leg), bool(found.gait.contact[n, leg])
        ax.plot([hips[leg, x], toes[leg, x]], [hips[leg, y], toes[leg, y]], color=color, lw=1.4)
        ax.plot(*toes[leg, [x, y]], "o", ms=4.5, color=color, mfc=color if stands else "white")
        if stands:
            _arrow(ax, toes[leg, [x, y]], scale * found.force[n, leg, [x, y]], _FORCE)
    _arrow(ax, com[[x, y]], _AHEAD * state[VELOCITY][[x, y]], _VELOCITY)
    style_axes(ax)
    ax.set_xlim(com[0] - shown, com[0] + shown)
    if y == 2:
        panel_title(ax, f"{task.step * n:.2f} s")
    else:
        ax.set_ylim(com[1] - shown, com[1] + shown)


def _arrow(ax: Axes, base: Array, along: Array, color: str) -> None:
    if float(np.hypot(*along)) > 1e-3:
        arrow = {"arrowstyle": "-|>", "color": color, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", xy=tuple(base + along), xytext=tuple(base), arrowprops=arrow)


def _room(ax: Axes, least: float) -> None:
    """Keep flat curves from looking wild."""
    low, high = ax.get_ylim()
    if high - low < 2 * least:
        middle = (low + high) / 2
        ax.set_ylim(middle - least, middle + least)


def _marker(plan: WalkPlan) -> str:
    return "o" if plan.task.knots <= 60 else ""


def _title(plan: WalkPlan) -> str:
    return plain(plan.title or plan.name)
