"""Contact forces and friction cones at a few instants (as on the right of Fig. 5.4)."""

from __future__ import annotations

from itertools import product

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch as Swatch
from matplotlib.patheffects import withStroke

from climbplan.arrays import Array
from climbplan.climb.pages.cones import (
    FrictionConeView,
    compute_contact_forces,
    compute_force_scale,
    select_round_force,
)
from climbplan.climb.pages.patches import (
    AxisAlignedBox,
    choose_oblique_camera,
    compute_hull_points,
    compute_limb_points,
)
from climbplan.climb.pages.series import find_minimum, list_drawn_labels
from climbplan.climb.pages.view import View
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.camera import OrthographicCamera
from climbplan.reports.sheet import (
    build_panel_grid,
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_limb_name,
    format_plain,
)

_LONGEST = 0.26  # [m] length of the largest force
_PANEL = 5.3  # [in] width of one picture
_TOP = 10.0  # drawing order of forces, over the robot
_HALO = [withStroke(linewidth=2.5, foreground="white")]


def select_instants(plan: ClimbPlan, count: int = 4) -> list[int]:
    """Return the instants nearest to overload, to slipping, and the last; filled up evenly."""
    last = plan.instants.count - 1
    torque, friction = plan.forces.safety_torque, plan.forces.safety_friction
    instants = [find_minimum(torque), find_minimum(friction), last]
    for k in np.linspace(last / 2, 0, 4 * count).round().astype(int):
        if len(set(instants)) >= count:
            break
        instants.append(int(k))
    return sorted(set(instants))


def _compute_box(plan: ClimbPlan, k: int, forces: tuple[FrictionConeView, ...]) -> AxisAlignedBox:
    """Return bounds of the robot and its forces at an instant."""
    pose = plan.instants.com[k], plan.instants.rpy[k]
    points = [compute_limb_points(plan, *pose, plan.instants.joint_angles[k]).reshape(-1, 3)]
    points.append(compute_hull_points(plan, *pose))
    points += [np.vstack([f.outer, f.tip[None]]) for f in forces]
    every = np.concatenate(points)
    return AxisAlignedBox(every.min(axis=0) - 0.06, every.max(axis=0) + 0.06)


def _draw_contact(view: View, force: FrictionConeView) -> None:
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


def _draw_labels(
    view: View, plan: ClimbPlan, acting: tuple[FrictionConeView, ...], point: float
) -> None:
    """Limb and force beside each toe, outside the robot; `point` is the length of one point [m]."""
    center = view.camera.project((view.box.lower + view.box.upper) / 2)
    toes = view.camera.project(np.array([force.toe for force in acting]).reshape(-1, 3))
    for right in (False, True):
        on_side = [i for i in range(len(acting)) if (toes[i, 0] >= center[0]) == right]
        label_positions = _spread_labels(toes[on_side] - [0.0, 8 * point], 62 * point, 12 * point)
        for i, (x, y) in zip(on_side, label_positions, strict=True):
            force = acting[i]
            view.ax.text(
                x + (6 if right else -6) * point,
                y,
                f"{format_limb_name(plan.robot.limb_names[force.limb])} {force.magnitude:.0f} N",
                ha="left" if right else "right",
                va="center",
                fontsize=8.5,
                color=palette.INK,
                path_effects=_HALO,
                zorder=_TOP + 2,
            )


def _spread_labels(places: Array, width: float, height: float) -> Array:
    """Return places (L, 2) moved down until labels of this size do not cover each other."""
    spread_positions = places.copy()
    done: list[int] = []
    for i in np.argsort(-places[:, 1]):
        # Each pass clears the label of one that stands above it; one pass for each is enough.
        for j in sorted(done, key=lambda j: -spread_positions[j, 1]):
            is_near = abs(spread_positions[i, 0] - spread_positions[j, 0]) < width
            if is_near and spread_positions[j, 1] - spread_positions[i, 1] < height:
                spread_positions[i, 1] = spread_positions[j, 1] - height
        done.append(int(i))
    return spread_positions


def _draw_scale_arrow(view: View, scale: float, low: Array) -> None:
    """A horizontal arrow of a round number of newtons."""
    newtons = select_round_force(scale, 0.25)
    if newtons <= 0:
        return
    start = low + np.array([0.02, 0.05])
    tip = start + np.array([newtons * scale, 0.0])
    style = {"arrowstyle": "-|>,head_width=0.22,head_length=0.45", "color": palette.FORCE}
    arrow = {**style, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
    view.ax.annotate("", tip, start, arrowprops=arrow)
    label = f"{newtons:g} N"
    view.ax.text(tip[0] + 0.02, tip[1], label, fontsize=8.5, color=palette.INK, va="center")


def _draw_picture(
    view: View, plan: ClimbPlan, k: int, acting: tuple[FrictionConeView, ...], point: float
) -> None:
    """The robot and its forces at instant k."""
    instants = plan.instants
    pose = instants.com[k], instants.rpy[k]
    view.terrain(plan)
    view.body(plan, *pose, color="#B8C4D0", alpha=0.95)
    view.legs(plan, *pose, instants.joint_angles[k], alpha=0.9, width=2.6)
    for force in acting:
        _draw_contact(view, force)
    _draw_labels(view, plan, acting, point)


def _project_box(box: AxisAlignedBox, camera: OrthographicCamera) -> Array:
    """Return the picture (8, 2) of a box's corners."""
    return camera.project(np.array(list(product(*zip(box.lower, box.upper, strict=True)))))


def forces(plan: ClimbPlan) -> Figure:
    """Return the robot with its contact forces: the most critical instants, one on the way, the
    last.
    """
    instants = select_instants(plan)
    scale = compute_force_scale(plan, _LONGEST)
    camera = choose_oblique_camera(plan, -64.0, 27.0)
    labels = list_drawn_labels(plan)
    acting = [compute_contact_forces(plan, k, scale) for k in instants]
    boxes = [_compute_box(plan, k, f) for k, f in zip(instants, acting, strict=True)]
    # All pictures at the same scale.
    sizes = [np.ptp(_project_box(box, camera), axis=0) for box in boxes]
    span = np.max(sizes, axis=0) + np.array([0.36, 0.10])
    rows = -(-len(instants) // 2)
    point = span[0] / (_PANEL * 72)
    height = 0.85 + rows * (0.45 + _PANEL * span[1] / span[0])
    figure, grid = build_panel_grid(height, entries=3, rows=rows, columns=2, axes_drawn=False)
    axes = grid.ravel()
    for ax, k, box, contact_forces_shown in zip(axes, instants, boxes, acting, strict=False):
        view = View(ax, camera, box, obstacle_alpha=0.5)
        _draw_picture(view, plan, k, contact_forces_shown, point)
        flat = _project_box(box, camera)
        start = (flat.min(axis=0) + flat.max(axis=0) - span) / 2
        ax.set_xlim(start[0], start[0] + span[0])
        ax.set_ylim(start[1], start[1] + span[1])
        ax.set_aspect("equal")
        ax.set_axis_off()
        _draw_scale_arrow(view, scale, start)
        s_tau, s_mu = plan.forces.safety_torque[k], plan.forces.safety_friction[k]
        note = rf"$S_\tau$ {s_tau:.2f}   $S_\mu$ {s_mu:.2f}"
        draw_panel_title(ax, labels[k], note)
    for ax in axes[len(instants) :]:
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
    draw_foot_legend(figure, handles, names)
    draw_heading(figure, title, format_plain(f"{plan.name}, {plan.robot.name}"))
    return figure
