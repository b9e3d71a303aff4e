"""A robot in its stance from above, in front and at its side, with where its toes can be."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
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
from climbplan.robots.facts import RobotFacts
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.visual_geometry import VisualGeometry, compute_piece_poses, split_by_link

_VIEWS = (("from above", 0, 1), ("front", 0, 2), ("side, from the right", 1, 2))
_AXES = "xyz"
_DOTS = 1200  # of a limb's sampled toes that are drawn


def draw_robot_picture(
    facts: RobotFacts, title: str = "", geometry: VisualGeometry | None = None
) -> Figure:
    """Draw a robot in its stance in three views, body frame [m].

    Args:
        facts: Measured facts of the robot: stance, joint angles and samples of its reach.
        title: What is shown; "" is the robot's name.
        geometry: Visual geometry, which takes the place of the body's box; None draws the box.
    """
    robot = facts.robot
    angles = np.nan_to_num(facts.stance_angles)
    triangles = None if geometry is None else _collect_triangles(geometry, robot, angles)
    figure = new_figure(4.6, entries=robot.limb_count)
    points = joint_points_body(robot, angles)  # (N, P, 3)
    grid = figure.add_gridspec(1, 3)
    for column, (name, horizontal, vertical) in enumerate(_VIEWS):
        ax = figure.add_subplot(grid[0, column])
        style_axes(ax)
        draw_panel_title(ax, name)
        if triangles is not None:
            _draw_triangles(ax, triangles, horizontal, vertical)
        for start, end in _list_edges(robot.body_hull) if triangles is None else ():
            ax.plot(
                [start[horizontal], end[horizontal]],
                [start[vertical], end[vertical]],
                color=palette.INK,
                linewidth=1,
            )
        for limb in range(robot.limb_count):
            color = palette.choose_limb_color(limb)
            toes = facts.samples[limb, :_DOTS]
            ax.scatter(
                toes[:, horizontal], toes[:, vertical], s=1.2, color=color, alpha=0.12, linewidths=0
            )
            if np.isfinite(facts.stance_angles[limb]).all():
                limb_points = points[limb]
                ax.plot(
                    limb_points[:, horizontal], limb_points[:, vertical], color=color,
                    linewidth=2 if geometry is None else 1,
                    marker="o", markersize=3.5 if geometry is None else 2.5,
                )  # fmt: skip
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel(f"{_AXES[horizontal]} [m]")
        ax.set_ylabel(f"{_AXES[vertical]} [m]")
    handles = [
        Line2D([], [], color=palette.choose_limb_color(n), marker="o", markersize=5, linewidth=2)
        for n in range(robot.limb_count)
    ]
    draw_foot_legend(figure, handles, [format_limb_name(name) for name in robot.limb_names])
    draw_heading(
        figure,
        format_plain(title or robot.name, 36),
        f"{robot.mass:.4g} kg, stance {facts.standing_height:.3f} m above its toes; "
        "dots: toes within joint bounds",
    )
    return figure


def _collect_triangles(visual_geometry: VisualGeometry, robot: Robot, angles: Array) -> Array:
    """Return corners (F, 3, 3) of all triangles at angles (N, J), body frame [m]."""
    chain = robot.mechanism
    if not isinstance(chain, SerialChain):
        raise TypeError("a robot from a URDF is a serial chain")
    pieces = split_by_link(visual_geometry, chain)
    positions, rotations = compute_piece_poses(pieces, chain, angles)
    return np.concatenate(
        [
            (piece.vertices @ rotations[k].T + positions[k])[piece.faces]
            for k, piece in enumerate(pieces)
        ]
    )


def _draw_triangles(ax: Axes, triangles: Array, horizontal: int, vertical: int) -> None:
    """Draw triangles that face the viewer, the nearest last, darker the more they turn away."""
    toward = np.cross(np.eye(3)[horizontal], np.eye(3)[vertical])
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    size = np.linalg.norm(normal, axis=1)
    facing = normal @ toward / np.maximum(size, 1e-15)
    visible = np.flatnonzero(facing > 0)
    visible = visible[np.argsort((triangles[visible] @ toward).mean(axis=1), kind="stable")]
    grey = 0.55 + 0.38 * facing[visible]
    colors = np.repeat(grey[:, None], 3, axis=1)
    ax.add_collection(
        PolyCollection(
            list(triangles[visible][..., [horizontal, vertical]]), facecolors=colors,
            edgecolors=colors, linewidths=0.2, zorder=0.5,
        )
    )  # fmt: skip


def _list_edges(hull: Array) -> list[tuple[Array, Array]]:
    """Return edges of the body's box, from its corners in any order."""
    low, high = hull.min(axis=0), hull.max(axis=0)
    corners = [np.array(c) for c in itertools.product(*zip(low, high, strict=True))]
    return [(a, b) for a, b in itertools.combinations(corners, 2) if np.count_nonzero(a != b) == 1]
