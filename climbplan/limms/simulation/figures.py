"""Figures of simulated modules: path of the box, loads of latches and torques against the plan."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.simulation.replay import ModuleRun
from climbplan.reports import palette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
    style_axes,
)


def plot_path(plan: LimmsPlan, run: ModuleRun) -> Figure:
    """Plot the position of the box over time, planned and simulated, and its tilt."""
    figure = new_figure(4.6, entries=2)
    axes = figure.subplots(2, 2, sharex=True).ravel()
    for k, ax in enumerate(axes[:3]):
        ax.plot(run.time, run.planned_box[:, :, k], color=palette.LIMBS[0], lw=1.8)
        ax.plot(run.time, run.box[:, :, k], color=palette.INK, lw=0.9)
        draw_panel_title(ax, "xyz"[k], "[m]")
    axes[3].plot(run.time, np.rad2deg(run.tilt), color=palette.INK, lw=0.9)
    draw_panel_title(axes[3], "tilt", "[deg]")
    _style_panels(plan, run, axes)
    draw_heading(
        figure, "Boxes" if plan.deliveries > 1 else "Box", format_plain(f"{plan.name}, MuJoCo")
    )
    _add_legend(figure)
    return figure


def plot_loads(plan: LimmsPlan, run: ModuleRun) -> Figure:
    """Plot the largest loads of latches and ends on the ground, and the largest torque."""
    module, start = run.module, _find_start(plan)
    panels = []
    for components, title, kind, limit in (
        (slice(0, 3), "force on a latch", "latch", module.max_force),
        (slice(3, 6), "moment on a latch", "latch", module.latch_moment),
        (slice(0, 3), "force on an end on the ground", "ground", module.max_force),
    ):
        planned_and_simulated = [
            _find_max_load(run, which, components, kind) for which in ("planned", "found")
        ]
        if np.isfinite(planned_and_simulated[1][run.time >= start]).any():
            panels.append(
                (title, "[N m]" if components.start else "[N]", limit, planned_and_simulated)
            )
    max_torque = [np.abs(values).max(axis=(1, 2)) for values in (run.planned_torque, run.torque)]
    panels.append(("torque at the worst joint", "[N m]", module.max_torque, max_torque))
    rows = (len(panels) + 1) // 2
    figure = new_figure(2.3 * rows, entries=3)
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for ax, (title, unit, limit, values) in zip(axes, panels, strict=False):
        ax.plot(run.time, values[0], color=palette.LIMBS[0], lw=1.8)
        ax.plot(run.time, values[1], color=palette.INK, lw=0.9)
        draw_panel_title(ax, title, unit)
        if not plan.massless:
            ax.axhline(limit, color=palette.FAILURE, lw=1.2, ls=(0, (5, 2)))
    for ax in axes[len(panels) :]:
        ax.remove()
    _style_panels(plan, run, axes[: len(panels)])
    draw_heading(figure, "Loads, the most of any", format_plain(f"{plan.name}, MuJoCo"))
    _add_legend(figure, limit=not plan.massless)
    return figure


def _find_max_load(run: ModuleRun, which: str, components: slice, kind: str) -> Array:
    """Return the largest load (S,) of all contacts of a kind; NaN where there is none."""
    max_load = np.full(len(run.time), np.nan)
    for bearing in run.bearings:
        if bearing.kind != kind:
            continue
        magnitude = np.linalg.norm(getattr(bearing, which)[:, components], axis=1)
        samples = np.searchsorted(run.time, bearing.time)
        max_load[samples] = np.fmax(max_load[samples], magnitude)
    return max_load


def _style_panels(plan: LimmsPlan, run: ModuleRun, axes: Array) -> None:
    """Style the panels, from shortly before the box moves."""
    for ax in axes:
        ax.set_xlim(min(_find_start(plan), float(run.time[-1]) - 0.1), float(run.time[-1]))
        _fit_range(ax)
        style_axes(ax)
        ax.tick_params(labelbottom=True)
    for ax in axes[-2:]:
        ax.set_xlabel("time [s]")


def _find_start(plan: LimmsPlan) -> float:
    """Return a time one second before the box moves [s]."""
    moving_samples = np.flatnonzero((plan.motion.box_mode != 1).any(axis=1))
    start = float(plan.motion.time[moving_samples[0]]) if len(moving_samples) else 0.0
    return max(start - 1.0, 0.0)


def _fit_range(ax: Axes) -> None:
    """Fit the vertical range to the visible lines."""
    left, right = ax.get_xlim()
    lows, highs = [], []
    for line in ax.lines:
        x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        visible = y[(x >= left) & (x <= right) & np.isfinite(y)] if len(x) > 2 else y
        if len(visible):
            lows.append(visible.min())
            highs.append(visible.max())
    if lows:
        margin = 0.06 * max(max(highs) - min(lows), 1e-3)
        ax.set_ylim(min(lows) - margin, max(highs) + margin)


def _add_legend(figure: Figure, limit: bool = False) -> None:
    """Add the legend of planned and simulated lines."""
    handles = [Line2D([], [], color=palette.LIMBS[0], lw=1.8)]
    handles.append(Line2D([], [], color=palette.INK, lw=0.9))
    names = ["planned", "simulated"]
    if limit:
        handles.append(Line2D([], [], color=palette.FAILURE, lw=1.2, ls=(0, (5, 2))))
        names.append("limit")
    draw_foot_legend(figure, handles, names)
