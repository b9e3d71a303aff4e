"""Figures of a simulated run: each leg compared with its plan, sag, and falls over a key."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from climbplan.climb.pages.series import find_spans
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.comparison import PlanComparison
from climbplan.climb.simulation.instant_samples import find_instant_samples
from climbplan.climb.simulation.mujoco_run import RecordedRun
from climbplan.climb.simulation.sweep import SweepPoint
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

_MAX_SHOWN_MU = 1.6  # friction axis, in units of the terrain's coefficient


def plot_leg(plan: ClimbPlan, run: RecordedRun, limb: int) -> Figure:
    """Plot worst motor torque and critical friction of one leg: planned, simulated, limits."""
    figure = new_figure(4.6, entries=4)
    top, bottom = figure.subplots(2, 1, sharex=True)
    instant_samples = find_instant_samples(plan)
    time = plan.trajectory.time
    unit = plan.robot.joint_unit[limb]  # forces of joints that slide act at that arm
    planned = np.abs(plan.forces.motor_torques[:, limb] * unit).max(axis=1)
    top.plot(run.time, np.abs(run.torque[:, limb] * unit).max(axis=1), color=palette.INK, lw=0.8)
    top.plot(time[instant_samples], planned, "o-", color=palette.LIMBS[0], ms=2.5, lw=1.2)
    limit = float((plan.robot.max_torque[limb] * unit)[plan.robot.has_joint[limb]].min())
    top.axhline(limit, color=palette.FAILURE, lw=1.4, ls=(0, (5, 2)))
    top.set_ylabel("|torque| [N m]")
    top.set_ylim(0, 1.08 * limit)
    pressing = run.normal[:, limb] > 0.5
    critical = np.where(
        pressing, run.shear[:, limb] / np.maximum(run.normal[:, limb], 1e-9), np.nan
    )
    mu = plan.instants.mu[:, limb] * run.conditions.friction
    bottom.plot(run.time, critical, color=palette.INK, lw=0.8)
    bottom.plot(
        time[instant_samples],
        plan.forces.mu_critical[:, limb],
        "o-",
        color=palette.LIMBS[0],
        ms=2.5,
        lw=1.2,
    )
    bottom.step(
        time[instant_samples], mu, where="mid", color=palette.FAILURE, lw=1.4, ls=(0, (5, 2))
    )
    bottom.set_ylabel(r"critical friction $\mu_c$")
    bottom.set_ylim(0, _MAX_SHOWN_MU * float(mu.max()))
    bottom.set_xlabel("time of the plan [s]")
    for ax in (top, bottom):
        for span in find_spans(~plan.trajectory.contact[:, limb]):
            ax.axvspan(time[span.first], time[span.last], color=palette.MUTED, alpha=0.22, lw=0)
        ax.set_xlim(time[0], time[-1])
        style_axes(ax)
    draw_panel_title(top, "Motor nearest to its limit")
    draw_panel_title(bottom, "Friction coefficient at which the toe slips")
    handles = [
        Line2D([], [], color=palette.INK, lw=1.0),
        Line2D([], [], color=palette.LIMBS[0], lw=1.2, marker="o", ms=3),
        Line2D([], [], color=palette.FAILURE, lw=1.4, ls=(0, (5, 2))),
        Patch(color=palette.MUTED, alpha=0.22, lw=0),
    ]
    draw_foot_legend(figure, handles, ["simulated", "planned", "limit", "limb lifted"])
    name = format_limb_name(plan.robot.limb_names[limb])
    ended = f", falls at {run.time[-1]:.0f} s" if run.fallen else ""
    draw_heading(
        figure, f"{name}: simulated and planned", format_plain(f"{plan.name}, MuJoCo{ended}")
    )
    return figure


def plot_sag(plan: ClimbPlan, run: RecordedRun, comparison: PlanComparison) -> Figure:
    """Plot the deviation of the body from its planned path, simulated and predicted."""
    figure = new_figure(3.4, entries=3)
    ax = figure.subplots()
    deviation = 1e3 * (plan.trajectory.com[: run.samples] - run.com)
    for axis, name in enumerate("xyz"):
        ax.plot(run.time, deviation[:, axis], lw=1.0, color=palette.LIMBS[axis], label=name)
    sample_times = run.time[comparison.sample]
    for axis in range(3):
        ax.plot(
            sample_times,
            1e3 * comparison.sag_predicted[:, axis],
            ".",
            color=palette.LIMBS[axis],
            ms=3.5,
        )
    ax.axhline(0, color=palette.MUTED, lw=0.6)
    ax.set_xlabel("time of the plan [s]")
    ax.set_ylabel("planned less simulated [mm]")
    style_axes(ax)
    lines = [Line2D([], [], color=palette.LIMBS[axis], lw=1.2) for axis in range(3)]
    names = ["x", "y (forward)", "z (sag); dots: static equilibrium at the toes' places"]
    draw_foot_legend(figure, lines, names)
    draw_heading(figure, "Body against its planned path", format_plain(f"{plan.name}, MuJoCo"))
    return figure


def plot_falls(points: Sequence[SweepPoint], key: str, name: str) -> Figure:
    """Plot the fraction of falls in random worlds over a value of the spec."""
    figure = new_figure(3.6, entries=2)
    ax = figure.subplots()
    planned = [p for p in points if p.trials]
    x = [p.value for p in planned]
    y = np.array([p.fall_share.value for p in planned])
    low, high = np.array([p.fall_share.interval for p in planned]).reshape(-1, 2).T
    bars = ax.errorbar(
        x, 100 * y, 100 * np.abs(np.stack([y - low, high - y])), fmt="o-", color=palette.FORCE,
        lw=1.3, ms=4, capsize=3,
    )  # fmt: skip
    for point in points:
        if point.no_plan:
            ax.axvline(point.value, color=palette.MUTED, lw=0.8, ls=":")
    ax.set_xlabel(format_plain(key))
    ax.set_ylabel("runs that fall [%]")
    ax.set_ylim(-3, 103)
    style_axes(ax)
    no_plan_line = Line2D([], [], color=palette.MUTED, lw=0.8, ls=":")
    draw_foot_legend(
        figure, [bars.lines[0], no_plan_line], ["share of falls, 95 % interval", "no plan"]
    )
    runs = max((len(p.trials) for p in points), default=0)
    draw_heading(figure, "Falls in random worlds", format_plain(f"{name}, {runs} runs a value"))
    return figure
