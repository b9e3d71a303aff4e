"""The climb in one picture: terrain, postures of some rounds, footholds, path (as in Fig. 5.4)."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.climb.pages.patches import climb_box, oblique_camera
from climbplan.climb.pages.view import View
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.camera import FRONT, SIDE
from climbplan.reports.sheet import (
    foot_legend,
    heading,
    limb_name,
    new_figure,
    panel_title,
    plain,
    style_axes,
)
from climbplan.robots.kinematics import standing_inverse

_SHADES = LinearSegmentedColormap.from_list("rounds", ["#D9E2EC", "#7B8FA5", "#334E68"])
_DETAILED = 4  # postures drawn with legs
_OUTLINES = 13  # postures drawn at all


def _picked(count: int, wanted: int) -> list[int]:
    """At most `wanted` of 0..count, evenly spread, ends included."""
    return sorted({round(i) for i in np.linspace(0, count, min(wanted, count + 1))})


def round_angles(plan: ClimbPlan) -> Array:
    """Joint angles (M+1, N, 3) [rad] of the rounds' postures."""
    rounds, surfaces = plan.rounds, plan.terrain.surfaces
    normal = np.empty_like(rounds.toes)
    for index, surface in enumerate(surfaces):
        here = rounds.region == index
        normal[here] = surface.normal_at(rounds.toes[here])
    return standing_inverse(plan.robot, rounds.com, rounds.rpy, rounds.toes, normal).best()


def _drawn(count: int) -> tuple[list[int], list[int]]:
    """Which of the rounds 0..count are drawn at all, and which of those with legs."""
    drawn = _picked(count, _OUTLINES)
    return drawn, [drawn[i] for i in _picked(len(drawn) - 1, _DETAILED)]


def _climb(view: View, plan: ClimbPlan, angles: Array) -> None:
    """Terrain, bodies, legs, footholds and path of a climb."""
    rounds = plan.rounds
    drawn, detailed = _drawn(rounds.count)
    view.terrain(plan)
    for j in drawn:
        pose = rounds.com[j], rounds.rpy[j]
        full = j in detailed
        shade = to_hex(_SHADES(j / max(rounds.count, 1)))
        view.body(plan, *pose, color=shade, alpha=0.9 if full else 0.35)
        if full:
            view.legs(plan, *pose, angles[j], alpha=0.75, width=2.0)
    view.footholds(rounds.toes, size=14)
    style = {"color": palette.INK, "linewidth": 1.2, "marker": "o", "markersize": 2.5}
    view.line(rounds.com, 20, **style)


def _number(view: View, com: Array) -> None:
    """Round numbers beside the path, left out where they would collide."""
    low, high = view.ax.get_ylim()
    last = -np.inf
    for j in _drawn(len(com) - 1)[1]:
        x, z = view.camera.project(com[j])
        if z - last < 0.035 * (high - low):
            continue
        last = z
        tag = view.ax.annotate(
            str(j), (x, z), (9, 0), textcoords="offset points", va="center", fontsize=9, zorder=21
        )
        tag.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8})


def postures(plan: ClimbPlan) -> Figure:
    """Oblique, front (x-z) and side (y-z) views of a climb."""
    box = climb_box(plan)
    angles = round_angles(plan)
    wide = box.size[2] > 1.7 * max(box.size[:2])
    figure = new_figure(_height(box.size, wide), entries=plan.robot.limb_count + 1)
    if wide:
        grid = figure.add_gridspec(1, 3, width_ratios=[1.75, 1.0, box.size[1] / box.size[0]])
        cells = [grid[0, 0], grid[0, 1], grid[0, 2]]
    else:
        grid = figure.add_gridspec(2, 2, width_ratios=[1.5, 1.0])
        cells = [grid[:, 0], grid[0, 1], grid[1, 1]]
    oblique = View(figure.add_subplot(cells[0]), oblique_camera(plan, -63.0, 18.0), box)
    oblique.oblique_axes()
    _climb(oblique, plan, angles)
    for cell, camera, name in (
        (cells[1], FRONT, "front"),
        (cells[2], SIDE, "side, from the right"),
    ):
        view = View(figure.add_subplot(cell), camera, box, obstacle_alpha=0.4, cut_walls=True)
        style_axes(view.ax)
        view.plain_axes("x" if camera is FRONT else "y")
        panel_title(view.ax, name)
        _climb(view, plan, angles)
        _number(view, plan.rounds.com)
    names_by_limb = plan.robot.limb_names
    handles = [
        Line2D([], [], color=palette.limb_color(i), marker="o", markersize=5, linewidth=2)
        for i in range(len(names_by_limb))
    ]
    path = Line2D([], [], color=palette.INK, marker="o", markersize=2.5, linewidth=1.2)
    foot_legend(figure, [*handles, path], [*map(limb_name, names_by_limb), "body path by round"])
    count = plan.rounds.count
    heading(
        figure,
        f"Postures: {plain(plan.name, 36)}",
        f"{plain(plan.robot.name, 24)}, {count} round{'s' if count > 1 else ''}, "
        f"{float(plan.rounds.com[-1, 2] - plan.rounds.com[0, 2]):.2f} m up; dots are footholds",
    )
    return figure


def _height(size: Array, wide: bool) -> float:
    """Figure height [in] at which the views fill their columns."""
    if wide:
        return float(np.clip(2.0 + 3.0 * size[2] / size[0], 6.0, 13.0))
    return float(np.clip(1.5 + 2 * 3.6 * size[2] / max(size[0], size[1]), 6.0, 9.5))
