"""Figures of simulated modules: the box's way, loads of latches and torques beside the plan."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.simulation.replay import ModuleRun
from climbplan.reports import palette
from climbplan.reports.sheet import foot_legend, heading, new_figure, panel_title, plain, style_axes


def way(plan: LimmsPlan, run: ModuleRun) -> Figure:
    """The box's place over time, planned and simulated, and how far it is tilted."""
    figure = new_figure(4.6, entries=2)
    axes = figure.subplots(2, 2, sharex=True).ravel()
    for k, ax in enumerate(axes[:3]):
        ax.plot(run.time, run.planned_box[:, :, k], color=palette.LIMBS[0], lw=1.8)
        ax.plot(run.time, run.box[:, :, k], color=palette.INK, lw=0.9)
        panel_title(ax, "xyz"[k], "[m]")
    axes[3].plot(run.time, np.rad2deg(run.tilt), color=palette.INK, lw=0.9)
    panel_title(axes[3], "tilt", "[deg]")
    _dress(plan, run, axes)
    heading(figure, "Boxes" if plan.deliveries > 1 else "Box", plain(f"{plan.name}, MuJoCo"))
    _legend(figure)
    return figure


def loads(plan: LimmsPlan, run: ModuleRun) -> Figure:
    """What latches and ends on the ground bear at most, and torque at the worst joint."""
    module, begin = run.module, _begins(plan)
    panels = []
    for part, title, kind, limit in (
        (slice(0, 3), "force on a latch", "latch", module.max_force),
        (slice(3, 6), "moment on a latch", "latch", module.latch_moment),
        (slice(0, 3), "force on an end on the ground", "ground", module.max_force),
    ):
        both = [_most(run, which, part, kind) for which in ("planned", "found")]
        if np.isfinite(both[1][run.time >= begin]).any():
            panels.append((title, "[N m]" if part.start else "[N]", limit, both))
    most = [np.abs(values).max(axis=(1, 2)) for values in (run.planned_torque, run.torque)]
    panels.append(("torque at the worst joint", "[N m]", module.max_torque, most))
    rows = (len(panels) + 1) // 2
    figure = new_figure(2.3 * rows, entries=3)
    axes = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for ax, (title, unit, limit, values) in zip(axes, panels, strict=False):
        ax.plot(run.time, values[0], color=palette.LIMBS[0], lw=1.8)
        ax.plot(run.time, values[1], color=palette.INK, lw=0.9)
        panel_title(ax, title, unit)
        if not plan.massless:
            ax.axhline(limit, color=palette.FAILURE, lw=1.2, ls=(0, (5, 2)))
    for ax in axes[len(panels) :]:
        ax.remove()
    _dress(plan, run, axes[: len(panels)])
    heading(figure, "Loads, the most of any", plain(f"{plan.name}, MuJoCo"))
    _legend(figure, limit=not plan.massless)
    return figure


def _most(run: ModuleRun, which: str, part: slice, kind: str) -> Array:
    """(S,) the largest load of all contacts of a kind; NaN where there is none."""
    out = np.full(len(run.time), np.nan)
    for bearing in run.bearings:
        if bearing.kind != kind:
            continue
        size = np.linalg.norm(getattr(bearing, which)[:, part], axis=1)
        at = np.searchsorted(run.time, bearing.time)
        out[at] = np.fmax(out[at], size)
    return out


def _dress(plan: LimmsPlan, run: ModuleRun, axes: Array) -> None:
    """Time from shortly before the box moves."""
    for ax in axes:
        ax.set_xlim(min(_begins(plan), float(run.time[-1]) - 0.1), float(run.time[-1]))
        _fit(ax)
        style_axes(ax)
        ax.tick_params(labelbottom=True)
    for ax in axes[-2:]:
        ax.set_xlabel("time [s]")


def _begins(plan: LimmsPlan) -> float:
    moving = np.flatnonzero((plan.motion.box_mode != 1).any(axis=1))
    begin = float(plan.motion.time[moving[0]]) if len(moving) else 0.0
    return max(begin - 1.0, 0.0)


def _fit(ax: Axes) -> None:
    """The vertical range of what is seen."""
    begin, end = ax.get_xlim()
    lows, highs = [], []
    for line in ax.lines:
        x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        seen = y[(x >= begin) & (x <= end) & np.isfinite(y)] if len(x) > 2 else y
        if len(seen):
            lows.append(seen.min())
            highs.append(seen.max())
    if lows:
        room = 0.06 * max(max(highs) - min(lows), 1e-3)
        ax.set_ylim(min(lows) - room, max(highs) + room)


def _legend(figure: Figure, limit: bool = False) -> None:
    handles = [Line2D([], [], color=palette.LIMBS[0], lw=1.8)]
    handles.append(Line2D([], [], color=palette.INK, lw=0.9))
    names = ["planned", "simulated"]
    if limit:
        handles.append(Line2D([], [], color=palette.FAILURE, lw=1.2, ls=(0, (5, 2))))
        names.append("limit")
    foot_legend(figure, handles, names)
