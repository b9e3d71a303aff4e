"""Figures of a simulated walk: path, contact forces and friction of each leg, with the plan."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from climbplan.arrays import Array, spans_of
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
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.simulation.comparison import WalkComparison
from climbplan.walking.simulation.replay import WalkRun, compute_euler_angles
from climbplan.walking.simulation.whole_body_replay import WholeBodyRun
from climbplan.walking.task.task import ANGLES, POSITION


def plot_path(plan: WalkPlan, run: WalkRun) -> Figure:
    """Plot position and attitude of the body, planned and simulated."""
    figure = new_figure(5.2, entries=2)
    axes = figure.subplots(2, 3, sharex=True)
    planned = plan.trajectory.state
    time = plan.task.dt * np.arange(len(planned))
    angles = np.array([compute_euler_angles(rotation) for rotation in run.rotation])
    rows: tuple[tuple[tuple[str, ...], Array, Array, str], ...] = (
        (("x", "y", "z"), 1e3 * planned[:, POSITION], 1e3 * run.com, "mm"),
        (("roll", "pitch", "yaw"), np.rad2deg(planned[:, ANGLES]), np.rad2deg(angles), "deg"),
    )
    for row, (names, reference, values, unit) in zip(axes, rows, strict=True):
        for k, ax in enumerate(row):
            ax.plot(time, reference[:, k], color=palette.LIMBS[0], lw=1.6)
            ax.plot(run.time, values[:, k], color=palette.INK, lw=0.9)
            draw_panel_title(ax, names[k], f"[{unit}]")
            style_axes(ax)
    for ax in axes[1]:
        ax.set_xlabel("time [s]")
    handles = [Line2D([], [], color=palette.LIMBS[0], lw=1.6)]
    handles.append(Line2D([], [], color=palette.INK, lw=0.9))
    draw_foot_legend(figure, handles, ["planned", "simulated"])
    draw_heading(figure, "Body", format_plain(f"{plan.name}, MuJoCo{_describe_end(run)}"))
    return figure


def plot_forces(plan: WalkPlan, run: WalkRun, compared: WalkComparison) -> Figure:
    """Plot normal force and critical friction of each leg, planned and simulated."""
    figure = new_figure(6.4, entries=4)
    axes = figure.subplots(plan.task.body.leg_count, 2, sharex=True)
    last = max(run.samples - 1, 1)
    time = run.time[:last]
    trajectory = plan.trajectory
    for leg, (left, right) in enumerate(axes):
        name = format_limb_name(plan.task.body.leg_names[leg])
        loaded = compared.loaded[:, leg]
        _plot_steps(left, time, trajectory.force[:last, leg, 2], palette.LIMBS[0], 1.6)
        _plot_steps(left, time, run.pressure[:last, leg], palette.INK, 0.9)
        coefficients = (compared.friction_planned[:, leg], compared.friction[:, leg])
        for values, color, width in zip(
            coefficients, (palette.LIMBS[0], palette.INK), (1.6, 0.9), strict=True
        ):
            _plot_steps(right, time, np.where(loaded, values, np.nan), color, width)
        right.axhline(compared.mu, color=palette.FAILURE, lw=1.2, ls=(0, (5, 2)))
        right.set_ylim(0, 1.3 * compared.mu)
        left.set_ylabel("[N]")
        draw_panel_title(left, f"{name}: pressure")
        draw_panel_title(right, f"{name}: friction coefficient at which it slips")
        for ax in (left, right):
            for first, after in spans_of(~trajectory.gait.contact[:last, leg]):
                end = time[min(after, last - 1)]
                ax.axvspan(time[first], end, color=palette.MUTED, alpha=0.22, lw=0)
            style_axes(ax)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    handles = [
        Line2D([], [], color=palette.LIMBS[0], lw=1.6),
        Line2D([], [], color=palette.INK, lw=0.9),
        Line2D([], [], color=palette.FAILURE, lw=1.2, ls=(0, (5, 2))),
        Patch(color=palette.MUTED, alpha=0.22, lw=0),
    ]
    draw_foot_legend(
        figure, handles, ["planned", "simulated", "the ground's friction", "leg swings"]
    )
    draw_heading(figure, "Contact forces", format_plain(f"{plan.name}, MuJoCo{_describe_end(run)}"))
    return figure


def plot_torques(plan: WalkPlan, run: WholeBodyRun) -> Figure:
    """Plot the largest torque of each joint as a fraction of its limit, sample by sample."""
    legs, joints = run.torque.shape[1:]
    figure = new_figure(2.6 * (legs // 2), entries=joints + 1)
    axes = figure.subplots(legs // 2, 2, sharex=True, sharey=True).ravel()
    last = max(run.samples - 1, 1)
    time = run.time[:last]
    for leg, ax in enumerate(axes):
        for joint in range(joints):
            _plot_steps(
                ax, time, run.torque[:last, leg, joint], palette.choose_limb_color(joint), 1.1
            )
        ax.axhline(1.0, color=palette.FAILURE, lw=1.2, ls=(0, (5, 2)))
        ax.set_ylim(0, 1.1)
        draw_panel_title(ax, format_limb_name(plan.task.body.leg_names[leg]), "[torque limits]")
        style_axes(ax)
    for ax in axes[-2:]:
        ax.set_xlabel("time [s]")
    handles = [
        Line2D([], [], color=palette.choose_limb_color(joint), lw=1.1) for joint in range(joints)
    ]
    handles.append(Line2D([], [], color=palette.FAILURE, lw=1.2, ls=(0, (5, 2))))
    labels = [f"joint {joint + 1}" for joint in range(joints)]
    draw_foot_legend(figure, handles, [*labels, "limit"])
    draw_heading(figure, "Joint torques", format_plain(f"{plan.name}, MuJoCo{_describe_end(run)}"))
    return figure


def _plot_steps(ax: Axes, time: Array, values: Array, color: str, width: float) -> None:
    """Plot values that are constant between samples."""
    ax.step(time, values, where="post", color=color, lw=width)


def _describe_end(run: WalkRun) -> str:
    """Return the addition to a title for a walk that ends with a fall."""
    return f", falls at {run.time[-1]:.2f} s" if run.fallen else ""
