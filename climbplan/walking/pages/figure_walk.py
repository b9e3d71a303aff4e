"""Figures of an MPC plan: tracking, gait diagram, snapshots with forces, convergence."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle

from climbplan.arrays import Array, IntArray
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.pages.figure_loop import list_push_times, mark_pushes, split_runs
from climbplan.walking.plan.foot_centres import restore_surface
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, VELOCITY

_VELOCITY = "#B01E8C"
_FORCE = palette.FAILURE
_BEGUN = palette.LIMBS[1]
_NUM_SNAPSHOTS = 5
_KNOTS_ABOUT_PUSH = (-0.5, 0.5, 1.5, 2.5, 4.5)  # knots after a push
_MAX_ARROW = 0.22  # [m] of the arrow for the force limit
_MIN_VIEW_RADIUS = 0.42  # [m] about the body
_VIEW_MARGIN = 0.14  # [m] beyond the toes' boxes
_VIEW_BELOW = 1.2  # as a factor of the toes' depth
_VELOCITY_SCALE = 0.12  # [s] length of velocity arrows


def plot_tracking(plan: WalkPlan) -> Figure:
    """Plot velocity and attitude with their references."""
    task, trajectory = plan.task, plan.trajectory
    time = task.dt * np.arange(task.knots + 1)
    figure = new_figure(5.2, entries=2)
    axes = figure.subplots(2, 3, sharex=True)
    rows = (
        ("velocity", "xyz", trajectory.state[:, VELOCITY], task.reference.velocity, "m/s"),
        (
            "",
            ("roll", "pitch", "yaw"),
            np.rad2deg(trajectory.state[:, ANGLES]),
            np.rad2deg(task.reference.euler),
            "deg",
        ),
    )
    color = palette.LIMBS[0]
    states = plan.initial_states
    initial = None if states is None else (states[:, VELOCITY], states[:, ANGLES])
    for line, (row, (label, names, values, reference, unit)) in enumerate(
        zip(axes, rows, strict=True)
    ):
        for k, ax in enumerate(row):
            ax.plot(time[1:], reference[:, k], color=palette.INK, lw=1.2, ls="--")
            if initial is not None:
                before = initial[line][:, k] if line == 0 else np.rad2deg(initial[line][:, k])
                ax.plot(time, before, color=_BEGUN, lw=1.4, marker=_choose_marker(plan), ms=2.5)
            ax.plot(time, values[:, k], color=color, lw=1.8, marker=_choose_marker(plan), ms=3.5)
            mark_pushes(ax, plan)
            style_axes(ax)
            draw_panel_title(ax, f"{label} {names[k]}".strip(), f"[{unit}]")
            _expand_flat_axis(ax, 0.05 if unit == "m/s" else 1.0)
    for ax in axes[1]:
        ax.set_xlabel("time [s]")
    handles = [
        Line2D([], [], color=color, lw=1.8),
        Line2D([], [], color=palette.INK, lw=1.2, ls="--"),
    ]
    labels = ["plan" if plan.loop is None else "walked", "reference"]
    if initial is not None:
        handles.append(Line2D([], [], color=_BEGUN, lw=1.4))
        labels.append("trajectory that it started from")
    if list_push_times(plan):
        handles.append(Line2D([], [], color=_FORCE, lw=1.4, ls=":"))
        labels.append("push")
    draw_foot_legend(figure, handles, labels)
    # The cost of a closed loop is a sum over samples and not comparable with that of a plan.
    cost = f", cost {plan.objective:.4g}" if plan.loop is None else ""
    draw_heading(figure, _format_title(plan), f"{plan.method}{cost}")
    return figure


def plot_convergence(plan: WalkPlan) -> Figure:
    """Plot best cost and bound over time, and the gap."""
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
        draw_panel_title(ax, name, unit)
    handles = [Line2D([], [], color=c, lw=1.8) for c in (color, _BEGUN)]
    draw_foot_legend(figure, handles, ["best cost, true dynamics", "bound within the tube"])
    draw_heading(figure, f"{_format_title(plan)}: convergence", plan.method)
    return figure


def plot_gait(plan: WalkPlan) -> Figure:
    """Plot the gait diagram: contacts of each leg, shaded by force."""
    task, trajectory = plan.task, plan.trajectory
    figure = new_figure(2.7, entries=1)
    ax = figure.subplots()
    push = np.linalg.norm(trajectory.force[:-1], axis=-1)
    max_force = max(float(push.max()), 1e-9)
    for leg in range(task.body.leg_count):
        color = palette.choose_limb_color(leg)
        for first, last in split_runs(
            np.where(trajectory.gait.contact[:-1, leg], push[:, leg], -1.0)
        ):
            if trajectory.gait.contact[first, leg]:
                shade = 0.25 + 0.75 * push[first, leg] / max_force
                bar = (task.dt * first, task.body.leg_count - 1 - leg - 0.36)
                wide = task.dt * (last - first)
                ax.add_patch(Rectangle(bar, wide, 0.72, color=color, alpha=shade, lw=0))
    style_axes(ax)
    ax.set_xlim(0, task.dt * task.knots)
    ax.set_ylim(-0.6, task.body.leg_count - 0.4)
    ax.set_yticks(
        range(task.body.leg_count),
        list(reversed([format_plain(n, 10) for n in task.body.leg_names])),
    )
    ax.set_xlabel("time [s]")
    ax.grid(visible=False, axis="y")
    handles = [Patch(color=palette.INK, alpha=a, lw=0) for a in (0.25, 1.0)]
    draw_foot_legend(figure, handles, ["contact force 0 N", f"contact force {max_force:.0f} N"])
    draw_panel_title(ax, "Standing legs", "the darker, the harder they push")
    draw_heading(figure, f"{_format_title(plan)}: gait", plan.method)
    return figure


def plot_snapshots(plan: WalkPlan) -> Figure:
    """Plot the body, its legs and forces at some samples, from the side and from above."""
    task = plan.task
    figure = new_figure(5.4, entries=9)
    axes = figure.subplots(2, _NUM_SNAPSHOTS, height_ratios=(0.52, 0.84))
    moments = _select_samples(plan)
    heights = plan.trajectory.state[moments, 2]
    below = max(0.30, -_VIEW_BELOW * float(task.body.toe_center[:, 2].min()))
    for column in range(_NUM_SNAPSHOTS):
        for row, (x, y) in enumerate(((0, 2), (0, 1))):
            ax = axes[row, column]
            if column < len(moments):
                _plot_snapshot(ax, plan, int(moments[column]), x, y)
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
            Line2D([], [], color=palette.choose_limb_color(leg), lw=1.6)
            for leg in range(task.body.leg_count)
        ),
    ]
    labels = [
        f"force, {_MAX_ARROW / task.body.force_limit * 1e3:.2g} mm/N",
        f"velocity, {_VELOCITY_SCALE:.2g} s of it",
        "heading",
        "toe standing",
        "swinging",
    ]
    draw_foot_legend(
        figure, handles, [*labels, *(format_plain(name, 10) for name in task.body.leg_names)]
    )
    draw_heading(figure, f"{_format_title(plan)}: snapshots", "from the side, from above")
    return figure


def _select_samples(plan: WalkPlan) -> IntArray:
    """Select samples to show: evenly, or a closed loop's knots about its first push."""
    task, pushes = plan.task, list_push_times(plan)
    moments = np.linspace(0, task.knots - 1, _NUM_SNAPSHOTS)
    if plan.loop is not None and pushes:
        moments = pushes[0] / task.dt + plan.loop.samples * np.array(_KNOTS_ABOUT_PUSH)
    selected: IntArray = np.unique(np.clip(moments, 0, task.knots - 1).round().astype(np.int64))
    return selected


def _compute_view_radius(plan: WalkPlan) -> float:
    """Return the half width of the view about the body [m]."""
    body = plan.task.body
    return max(
        _MIN_VIEW_RADIUS,
        float((np.abs(body.toe_center) + body.toe_half)[:, :2].max()) + _VIEW_MARGIN,
    )


def _plot_snapshot(ax: Axes, plan: WalkPlan, n: int, x: int, y: int) -> None:
    """Plot one sample in the plane of two axes."""
    task, trajectory = plan.task, plan.trajectory
    state, toes = trajectory.state[n], trajectory.toes[n]
    com, R = state[:3], rotation_world_body(state[ANGLES])
    hips, radius = com + task.hips @ R.T, _compute_view_radius(plan)
    ax.set_aspect("equal")
    around = com[:2] - radius, com[:2] + radius
    ground = restore_surface(task.ground)
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
    scale = _MAX_ARROW / task.body.force_limit
    for leg in range(task.body.leg_count):
        color, stands = palette.choose_limb_color(leg), bool(trajectory.gait.contact[n, leg])
        ax.plot([hips[leg, x], toes[leg, x]], [hips[leg, y], toes[leg, y]], color=color, lw=1.4)
        ax.plot(*toes[leg, [x, y]], "o", ms=4.5, color=color, mfc=color if stands else "white")
        if stands:
            _draw_arrow(ax, toes[leg, [x, y]], scale * trajectory.force[n, leg, [x, y]], _FORCE)
    _draw_arrow(ax, com[[x, y]], _VELOCITY_SCALE * state[VELOCITY][[x, y]], _VELOCITY)
    style_axes(ax)
    ax.set_xlim(com[0] - radius, com[0] + radius)
    if y == 2:
        draw_panel_title(ax, f"{task.dt * n:.2f} s")
    else:
        ax.set_ylim(com[1] - radius, com[1] + radius)


def _draw_arrow(ax: Axes, base: Array, along: Array, color: str) -> None:
    """Draw an arrow unless it is very short."""
    if float(np.hypot(*along)) > 1e-3:
        arrow = {"arrowstyle": "-|>", "color": color, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", xy=tuple(base + along), xytext=tuple(base), arrowprops=arrow)


def _expand_flat_axis(ax: Axes, min_half_range: float) -> None:
    """Expand the range of an axis to a minimum, so that flat curves look flat."""
    low, high = ax.get_ylim()
    if high - low < 2 * min_half_range:
        middle = (low + high) / 2
        ax.set_ylim(middle - min_half_range, middle + min_half_range)


def _choose_marker(plan: WalkPlan) -> str:
    """Return the marker of samples; none for long walks."""
    return "o" if plan.task.knots <= 60 else ""


def _format_title(plan: WalkPlan) -> str:
    """Return the title of a plan, or its name."""
    return format_plain(plan.title or plan.name)
