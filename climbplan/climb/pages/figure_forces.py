"""Contact forces and friction cones at a few instants (as on the right of Fig. 5.4)."""

from __future__ import annotations

from itertools import product

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch as Swatch
from matplotlib.patheffects import withStroke

from climbplan.arrays import Array
from climbplan.climb.pages.cones import ContactForce, contact_forces, force_scale, round_newtons
from climbplan.climb.pages.patches import Box, hull_points, limb_points, oblique_camera
from climbplan.climb.pages.series import drawn_labels, least_at
from climbplan.climb.pages.view import View
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.camera import Camera
from climbplan.reports.sheet import foot_legend, heading, limb_name, panel_grid, panel_title, plain

_LONGEST = 0.26  # [m] length of the largest force
_PANEL = 5.3  # [in] width of one picture
_TOP = 10.0  # drawing order of forces, over the robot
_HALO = [withStroke(linewidth=2.5, foreground="white")]


def chosen_instants(plan: ClimbPlan, wanted: int = 4) -> list[int]:
    """The instants nearest to overload, to slipping, and the last; filled up evenly."""
    last = plan.instants.count - 1
    torque, friction = plan.forces.safety_torque, plan.forces.safety_friction
    picked = [least_at(torque), least_at(friction), last]
    for k in np.linspace(last / 2, 0, 4 * wanted).round().astype(int):
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


def _contact(view: View, force: ContactForce) -> None:
    """One force with its cone."""
    if np.ptp(force.outer, axis=0).any():
        cone = np.vstack([force.toe[None], force.outer])
        view.outline(cone, _TOP, facecolor=palette.CONE, alpha=0.10, linewidth=0)
        line = {"fill": False, "linewidth": 1.0}
        view.polygon(force.outer, _TOP + 0.2, edgecolor=palette.CONE, **line)
        view.polygon(force.inner, _TOP + 0.1, facecolor=palette.CONE, alpha=0.25, linewidth=0)
        dashed = {"linestyle": (0, (3, 2)), **line}
        view.polygon(force.inner, _TOP + 0.2, edgecolor=palette.CONE, **dashed)
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


def _labels(view: View, plan: ClimbPlan, acting: tuple[ContactForce, ...], point: float) -> None:
    """Limb and force beside each toe, outside the robot; `point` is the length of one point [m]."""
    center = view.camera.project((view.box.lower + view.box.upper) / 2)
    toes = view.camera.project(np.array([force.toe for force in acting]).reshape(-1, 3))
    for right in (False, True):
        here = [i for i in range(len(acting)) if (toes[i, 0] >= center[0]) == right]
        places = _spread(toes[here] - [0.0, 8 * point], 62 * point, 12 * point)
        for i, (x, y) in zip(here, places, strict=True):
            force = acting[i]
            view.ax.text(
                x + (6 if right else -6) * point,
                y,
                f"{limb_name(plan.robot.limb_names[force.limb])} {force.magnitude:.0f} N",
                ha="left" if right else "right",
                va="center",
                fontsize=8.5,
                color=palette.INK,
                path_effects=_HALO,
                zorder=_TOP + 2,
            )


def _spread(places: Array, width: float, height: float) -> Array:
    """Places (L, 2) moved down until labels of this size do not cover each other."""
    moved = places.copy()
    done: list[int] = []
    for i in np.argsort(-places[:, 1]):
        # Each pass clears the label of one that stands above it; one pass for each is enough.
        for j in sorted(done, key=lambda j: -moved[j, 1]):
            near = abs(moved[i, 0] - moved[j, 0]) < width
            if near and moved[j, 1] - moved[i, 1] < height:
                moved[i, 1] = moved[j, 1] - height
        done.append(int(i))
    return moved


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
    label = f"{newtons:g} N"
    view.ax.text(tip[0] + 0.02, tip[1], label, fontsize=8.5, color=palette.INK, va="center")


def _picture(
    view: View, plan: ClimbPlan, k: int, acting: tuple[ContactForce, ...], point: float
) -> None:
    """The robot and its forces at instant k."""
    instants = plan.instants
    pose = instants.com[k], instants.rpy[k]
    view.terrain(plan)
    view.body(plan, *pose, color="#B8C4D0", alpha=0.95)
    view.legs(plan, *pose, instants.joint_angles[k], alpha=0.9, width=2.6)
    for force in acting:
        _contact(view, force)
    _labels(view, plan, acting, point)


def _flat(box: Box, camera: Camera) -> Array:
    """The picture (8, 2) of a box's corners."""
    return camera.project(np.array(list(product(*zip(box.lower, box.upper, strict=True)))))


def forces(plan: ClimbPlan) -> Figure:
    """The robot with its contact forces: the most critical instants, one on the way, the last."""
    picked = chosen_instants(plan)
    scale = force_scale(plan, _LONGEST)
    camera = oblique_camera(plan, -64.0, 27.0)
    labels = drawn_labels(plan)
    acting = [contact_forces(plan, k, scale) for k in picked]
    boxes = [_box(plan, k, f) for k, f in zip(picked, acting, strict=True)]
    # All pictures at the same scale.
    sizes = [np.ptp(_flat(box, camera), axis=0) for box in boxes]
    span = np.max(sizes, axis=0) + np.array([0.36, 0.10])
    rows = -(-len(picked) // 2)
    point = span[0] / (_PANEL * 72)
    height = 0.85 + rows * (0.45 + _PANEL * span[1] / span[0])
    figure, grid = panel_grid(height, entries=3, rows=rows, columns=2, axes_drawn=False)
    axes = grid.ravel()
    for ax, k, box, found in zip(axes, picked, boxes, acting, strict=False):
        view = View(ax, camera, box, obstacle_alpha=0.5)
        _picture(view, plan, k, found, point)
        flat = _flat(box, camera)
        start = (flat.min(axis=0) + flat.max(axis=0) - span) / 2
        ax.set_xlim(start[0], start[0] + span[0])
        ax.set_ylim(start[1], start[1] + span[1])
        ax.set_aspect("equal")
        ax.set_axis_off()
        _scale_arrow(view, scale, start)
        s_tau, s_mu = plan.forces.safety_torque[k], plan.forces.safety_friction[k]
        note = rf"$S_\tau$ {s_tau:.2f}   $S_\mu$ {s_mu:.2f}"
        panel_title(ax, labels[k], note)
    for ax in axes[len(picked) :]:
        ax.set_visible(False)
    handles = [
        Line2D([], [], color=palette.FORCE, lw=1.8, marker=">", ms=5),
        Line2D([], [], color=palette.CONE, lw=1.0),
        Swatch(facecolor=palette.CONE_SHRUNK, edgecolor=palette.CONE, ls=(0, (3, 2)), alpha=0.7),
    ]
    names = [
        "force on the robot",
        r"cone of $\mu$, cut at the height of the normal force",
        r"cone of $\mu / S_\mu$",
    ]
    title = "Contact forces and friction cones"
    if plan.grips is not None:  # drawn where wrists bring them, without cones
        gripper = Line2D([], [], color=palette.INK, lw=1.8)
        handles, names = [handles[0], gripper], ["force on the robot, at the wrist", "gripper"]
        title = "Contact forces of grips"
    foot_legend(figure, handles, names)
    heading(figure, title, plain(f"{plan.name}, {plan.robot.name}"))
    return figure
