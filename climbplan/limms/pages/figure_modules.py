"""Figure of modules and boxes at key moments: the ends of stages."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from climbplan.arrays import Array
from climbplan.limms.pages.obstacles import find_obstacles
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.placement import rotation_about_vertical
from climbplan.reports import palette
from climbplan.reports.camera import OrthographicCamera, compute_silhouette
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_plain,
    new_figure,
)

_CAMERA = OrthographicCamera(-62.0, 22.0)
_MAX_PICTURES = 8
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def plot_key_poses(plan: LimmsPlan) -> Figure:
    """Plot up to eight pictures: the last of each stage that matters, and the end."""
    samples = _select_samples(plan)
    rows = -(-len(samples) // 4)
    figure = new_figure(0.8 + 2.9 * rows, entries=len(plan.module_names))
    draw_heading(
        figure,
        format_plain(plan.title or plan.name),
        "ends of stages; squares: anchors, dashes: goal",
    )
    axes = np.atleast_1d(figure.subplots(rows, min(4, len(samples)), squeeze=False)).ravel()
    low, high = _compute_bounds(plan)
    for ax, sample in zip(axes, samples, strict=False):
        _draw(ax, plan, sample)
        corners = _CAMERA.project(_build_corners(low, high))
        ax.set_xlim(corners[:, 0].min(), corners[:, 0].max())
        ax.set_ylim(corners[:, 1].min(), corners[:, 1].max())
        ax.set_aspect("equal")
        time = float(plan.motion.time[sample])
        stage = next((n for n, a, b in plan.stages if a <= time <= b + 1e-9), "")
        draw_panel_title(ax, f"{time:.2f} s", format_plain(stage, 24))
    for ax in axes:
        ax.set_axis_off()
    handles = [
        Line2D([], [], color=palette.choose_limb_color(m), linewidth=4)
        for m in range(len(plan.module_names))
    ]
    draw_foot_legend(figure, handles, [format_plain(name, 12) for name in plan.module_names])
    return figure


def _select_samples(plan: LimmsPlan) -> list[int]:
    """Return the samples at the ends of stages, thinned evenly."""
    ends = [int(np.searchsorted(plan.motion.time, end - 1e-9)) for _, _, end in plan.stages]
    samples = sorted({0, *(min(e, len(plan.motion.time) - 1) for e in ends)})
    if len(samples) > _MAX_PICTURES:
        indices = np.unique(np.linspace(0, len(samples) - 1, _MAX_PICTURES).round().astype(int))
        samples = [samples[k] for k in indices]
    return samples


def _compute_bounds(plan: LimmsPlan) -> tuple[Array, Array]:
    """Return lower and upper corner of everything [m]."""
    points = plan.motion.joint_position.reshape(-1, 3)
    boxes = plan.motion.box_position.reshape(-1, 3)
    everything = np.vstack([points, boxes, plan.goal, _list_terrain_anchors(plan)])
    return everything.min(axis=0) - 0.15, everything.max(axis=0) + 0.15


def _list_terrain_anchors(plan: LimmsPlan) -> Array:
    """Return anchors of walls and ground (W, 3), which do not move [m]."""
    fixed: Array = plan.motion.anchor_position[0, 4 * len(plan.box_size) :]
    return fixed


def _build_corners(low: Array, high: Array) -> Array:
    """Return the corners (8, 3) of a block [m]."""
    return np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )


def _draw(ax: Axes, plan: LimmsPlan, sample: int) -> None:
    """Draw the scene at a sample."""
    low, high = _compute_bounds(plan)
    for solid_low, solid_high in plan.solids:
        # Tops of solids under the scene, clipped to the picture
        a, b = np.maximum(solid_low, low), np.minimum(solid_high, high)
        if (a[:2] >= b[:2]).any() or solid_high[2] > high[2] - 0.1:
            continue
        z = solid_high[2]
        top = np.array([[a[0], a[1], z], [b[0], a[1], z], [b[0], b[1], z], [a[0], b[1], z]])
        ax.add_patch(Polygon(_CAMERA.project(top), facecolor="#EEF1F5", edgecolor=palette.GRID))
    for lower, upper in find_obstacles(plan):
        a, b = np.maximum(lower, low), np.minimum(upper, high)
        if (a < b).all():
            _draw_block(ax, a, b, palette.SURFACE, 0.5)
    for number, size in enumerate(plan.box_size):
        centre, yaw = plan.motion.box_position[sample, number], plan.motion.box_yaw[sample, number]
        color = palette.OBSTACLE if number < plan.deliveries else palette.MUTED
        _draw_faces(ax, _build_box_corners(centre, float(yaw), size), color, 0.55)
    count = plan.deliveries
    for goal_position, goal_yaw, size in zip(
        plan.goal, plan.goal_yaw, plan.box_size[:count], strict=False
    ):
        goal = compute_silhouette(
            _CAMERA.project(_build_box_corners(goal_position, float(goal_yaw), size))
        )
        outline = Polygon(goal, fill=False, edgecolor=palette.FAILURE, linestyle="--")
        outline.set_linewidth(1)
        ax.add_patch(outline)
    anchors = _CAMERA.project(_list_terrain_anchors(plan))
    ax.plot(anchors[:, 0], anchors[:, 1], "s", markersize=4.5, color=palette.INK)
    for m in range(len(plan.module_names)):
        points = _CAMERA.project(plan.motion.joint_position[sample, m])
        ax.plot(
            points[:, 0],
            points[:, 1],
            color=palette.choose_limb_color(m),
            linewidth=3.2,
            solid_capstyle="round",
            marker="o",
            markersize=2.6,
            markerfacecolor="white",
            markeredgewidth=0.6,
        )


def _build_box_corners(centre: Array, yaw: float, size: Array) -> Array:
    """Return the corners (8, 3) of an upright box [m]."""
    return centre + _build_corners(-size / 2, size / 2) @ rotation_about_vertical(yaw).T


def _draw_block(ax: Axes, low: Array, high: Array, color: str, alpha: float) -> None:
    """Draw a block."""
    _draw_faces(ax, _build_corners(low, high), color, alpha)


def _draw_faces(ax: Axes, corners: Array, color: str, alpha: float) -> None:
    """Draw the visible faces of a block (8, 3)."""
    projected = _CAMERA.project(corners)
    centre = corners.mean(axis=0)
    for face in _FACES:
        normal = corners[list(face)].mean(axis=0) - centre
        if _CAMERA.faces_viewer(normal):
            ax.add_patch(
                Polygon(
                    projected[list(face)],
                    facecolor=color,
                    edgecolor=palette.INK,
                    linewidth=0.6,
                    alpha=alpha,
                )
            )
