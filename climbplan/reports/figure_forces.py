"""Contact forces and friction cones at a few instants (as on the right of Fig. 5.4)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch as Swatch

from climbplan.plans.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.camera import Camera
from climbplan.reports.cones import ContactForce, contact_forces, force_scale, round_newtons
from climbplan.reports.patches import Box, hull_points, limb_points
from climbplan.reports.series import instant_labels
from climbplan.reports.sheet import foot_legend, heading, new_figure, panel_title, plain
from climbplan.reports.view import View
from climbplan.robots.rotations import Array

_CAMERA = Camera(-72.0, 22.0)
_LONGEST = 0.30  # [m] length of the largest force
_TOP = 10.0  # drawing order of forces, over the robot


def chosen_instants(plan: ClimbPlan, wanted: int = 3) -> list[int]:
    """The instants nearest to overload, to slipping, and the last; filled up evenly."""
    last = plan.instants.count - 1
    picked = [int(np.argmin(plan.forces.safety_torque)), int(np.argmin(plan.forces.safety_friction))]
    evenly = np.linspace(last, 0, 4 * wanted).round().astype(int)
    for k in (last, *evenly):
        if len(set(picked)) >= wanted:
            break
        picked.append(int(k))
    return sorted(set(picked))


def _box(plan: ClimbPlan, k: int, forces: tuple[ContactForce, ...]) -> Box:
    """Bounds of the robot and its forces at an instant."""
    pose = plan.instants.com[k], plan.instants.rpy[k]
    points = [limb_points(plan, *pose, plan.instants.joint_angles[k]).reshape(-1, 3)]
    points.append(hull_points(plan, *pose))
    points += [np.vstack([f.outer, f.tip[None]]) for f in forces]
    every = np.concatenate(points)
    return Box(every.min(axis=0) - 0.06, every.max(axis=0) + 0.06)


def _contact(view: View, plan: ClimbPlan, force: ContactForce) -> None:
    """One force with its cone and its label beyond the toe."""
    cone = np.vstack([force.toe[None], force.outer])
    view.outline(cone, _TOP, facecolor=palette.CONE, alpha=0.10, linewidth=0)
    line = {"fill": False, "linewidth": 1.0}
    view.polygon(force.outer, _TOP + 0.2, edgecolor=palette.CONE, **line)
    view.polygon(force.inner, _TOP + 0.1, facecolor=palette.CONE, alpha=0.25, linewidth=0)
    view.polygon(force.inner, _TOP + 0.2, edgecolor=palette.CONE, linestyle=(0, (3, 2)), **line)
    start, tip = view.camera.project(np.array([force.toe, force.tip]))
    view.ax.annotate(
        "",
        tip,
        start,
        zorder=_TOP + 1,
        arrowprops={
            "arrowstyle": "-|>,head_width=0.22,head_length=0.45",
            "color": palette.FORCE,
            "linewidth": 1.8,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )
    center = view.camera.project((view.box.lower + view.box.upper) / 2)
    right = start[0] >= center[0]
    view.ax.annotate(
        f"{plain(plan.robot.limb_names[force.limb])} {force.magnitude:.0f} N",
        start,
        (6 if right else -6, -9),
        textcoords="offset points",
        ha="left" if right else "right",
        va="center",
        fontsize=8.5,
        color=palette.INK,
        zorder=_TOP + 2,
    )


def _scale_arrow(view: View, scale: float, low: Array) -> None:
    """A horizontal arrow of a round number of newtons."""
    newtons = round_newtons(scale, 0.25)
    if newtons <= 0:
        return
    start = low + np.array([0.02, 0.05])
    tip = start + np.array([newtons * scale, 0.0])
    style = {"arrowstyle": "-|>,head_width=0.22,head_length=0.45", "color": palette.FORCE}
    arrow = {**style, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
    view.ax.annotate("", tip, start, arrowprops=arrow)
    style_text = {"fontsize": 8.5, "color": palette.INK, "va": "center"}
    view.ax.text(tip[0] + 0.02, tip[1], f"{newtons:g} N", **style_text)


def forces(plan: ClimbPlan) -> Figure:
    """The robot with its contact forces at the most critical instants and at the end."""
    picked = chosen_instants(plan)
    scale = force_scale(plan, _LONGEST)
    labels = instant_labels(plan)
    figure = new_figure(4.9, foot=0.36)
    axes = figure.subplots(1, len(picked), squeeze=False)[0]
    for ax, k in zip(axes, picked, strict=True):
        acting = contact_forces(plan, k, scale)
        view = View(ax, _CAMERA, _box(plan, k, acting))
        pose = plan.instants.com[k], plan.instants.rpy[k]
        view.terrain(plan)
        view.body(plan, *pose, color="#B8C4D0", alpha=0.95)
        view.legs(plan, *pose, plan.instants.joint_angles[k], alpha=0.9, width=2.4)
        for force in acting:
            _contact(view, plan, force)
        low, high = _limits(view)
        _scale_arrow(view, scale, low)
        ax.set_xlim(low[0], high[0])
        ax.set_ylim(low[1], high[1])
        ax.set_aspect("equal")
        ax.set_axis_off()
        panel_title(ax, plain(labels[k]))
        s_tau, s_mu = plan.forces.safety_torque[k], plan.forces.safety_friction[k]
        ax.text(
            0.0, 1.0, rf"$S_\tau$ {s_tau:.2f}   $S_\mu$ {s_mu:.2f}", transform=ax.transAxes,
            va="top", fontsize=9, color=palette.MUTED,
        )  # fmt: skip
    handles = [
        Line2D([], [], color=palette.FORCE, lw=1.8, marker=">", ms=5),
        Line2D([], [], color=palette.CONE, lw=1.0),
        Swatch(facecolor=palette.CONE_SHRUNK, edgecolor=palette.CONE, ls=(0, (3, 2)), alpha=0.7),
    ]
    names = ["force on the robot", r"cone of $\mu$ at the force's height", r"cone of $\mu / S_\mu$"]
    foot_legend(figure, handles, names)
    heading(figure, "Contact forces and friction cones", plain(f"{plan.name}, {plan.robot.name}"))
    return figure


def _limits(view: View) -> tuple[Array, Array]:
    """Lower and upper corner of the picture round the box, with room for labels."""
    lower, upper = view.box.lower, view.box.upper
    grid = np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T
    flat = view.camera.project(grid)
    room = np.array([0.14, 0.04])
    return flat.min(axis=0) - room, flat.max(axis=0) + room
