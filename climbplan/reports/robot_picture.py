"""A robot in its stance from above, in front and at its side, with where its toes can be."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.reports import palette
from climbplan.reports.sheet import (
    foot_legend,
    heading,
    limb_name,
    new_figure,
    panel_title,
    plain,
    style_axes,
)
from climbplan.robots.facts import RobotFacts
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.rotations import Array

_VIEWS = (("from above", 0, 1), ("front", 0, 2), ("side, from the right", 1, 2))
_AXES = "xyz"
_DOTS = 1200  # of a limb's sampled toes that are drawn


def robot_picture(facts: RobotFacts, title: str = "") -> Figure:
    """Three views in the body frame [m]; title: what is shown, the robot's name by default."""
    robot = facts.robot
    figure = new_figure(4.6, entries=robot.limb_count)
    points = joint_points_body(robot, np.nan_to_num(facts.stance_angles))  # (N, P, 3)
    grid = figure.add_gridspec(1, 3)
    for column, (name, across, up) in enumerate(_VIEWS):
        ax = figure.add_subplot(grid[0, column])
        style_axes(ax)
        panel_title(ax, name)
        for start, end in _edges(robot.body_hull):
            ax.plot(
                [start[across], end[across]], [start[up], end[up]], color=palette.INK, linewidth=1
            )
        for limb in range(robot.limb_count):
            color = palette.limb_color(limb)
            toes = facts.samples[limb, :_DOTS]
            ax.scatter(toes[:, across], toes[:, up], s=1.2, color=color, alpha=0.12, linewidths=0)
            if np.isfinite(facts.stance_angles[limb]).all():
                own = points[limb]
                ax.plot(
                    own[:, across], own[:, up], color=color, linewidth=2, marker="o", markersize=3.5
                )
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_xlabel(f"{_AXES[across]} [m]")
        ax.set_ylabel(f"{_AXES[up]} [m]")
    handles = [
        Line2D([], [], color=palette.limb_color(n), marker="o", markersize=5, linewidth=2)
        for n in range(robot.limb_count)
    ]
    foot_legend(figure, handles, [limb_name(name) for name in robot.limb_names])
    heading(
        figure,
        plain(title or robot.name, 36),
        f"{robot.mass:.4g} kg, stance {facts.standing_height:.3f} m above its toes; "
        "dots: toes within joint bounds",
    )
    return figure


def _edges(hull: Array) -> list[tuple[Array, Array]]:
    """Edges of the body's box, from its corners in any order."""
    low, high = hull.min(axis=0), hull.max(axis=0)
    corners = [np.array(c) for c in itertools.product(*zip(low, high, strict=True))]
    return [(a, b) for a, b in itertools.combinations(corners, 2) if np.count_nonzero(a != b) == 1]
