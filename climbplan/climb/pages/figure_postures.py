"""The climb in one picture: terrain, postures of some rounds, footholds, path (as in Fig. 5.4)."""

from __future__ import annotations

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from climbplan.arrays import Array
from climbplan.climb.pages.patches import choose_oblique_camera, compute_climb_box
from climbplan.climb.pages.view import View
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.camera import FRONT, SIDE
from climbplan.reports.sheet import (
    draw_foot_legend,
    draw_heading,
    draw_panel_title,
    format_limb_name,
    format_plain,
    new_figure,
    style_axes,
)
from climbplan.robots.kinematics import standing_inverse

_SHADES = LinearSegmentedColormap.from_list("rounds", ["#D9E2EC", "#7B8FA5", "#334E68"])
_DETAILED = 4  # postures drawn with legs
_OUTLINES = 13  # postures drawn at all


def _select_evenly(count: int, max_count: int) -> list[int]:
    """Return at most `max_count` of 0..count, evenly spread, ends included."""
    return sorted({round(i) for i in np.linspace(0, count, min(max_count, count + 1))})


def compute_round_angles(plan: ClimbPlan) -> Array:
    """Return joint angles (M+1, N, 3) [rad] of the rounds' postures."""
    rounds, surfaces = plan.rounds, plan.terrain.surfaces
    normal = np.empty_like(rounds.toes)
    for index, surface in enumerate(surfaces):
        on_surface = rounds.region == index
        normal[on_surface] = surface.normal_at(rounds.toes[on_surface])
    return standing_inverse(plan.robot, rounds.com, rounds.rpy, rounds.toes, normal).best()


def _select_rounds(count: int) -> tuple[list[int], list[int]]:
    """Return which of the rounds 0..count are drawn at all, and which of those with legs."""
    outlined = _select_evenly(count, _OUTLINES)
    return outlined, [outlined[i] for i in _select_evenly(len(outlined) - 1, _DETAILED)]


def _draw_climb(view: View, plan: ClimbPlan, angles: Array) -> None:
    """Terrain, bodies, legs, footholds and path of a climb."""
    rounds = plan.rounds
    outlined, detailed = _select_rounds(rounds.count)
    view.terrain(plan)
    for j in outlined:
        pose = rounds.com[j], rounds.rpy[j]
        full = j in detailed
        shade = to_hex(_SHADES(j / max(rounds.count, 1)))
        view.body(plan, *pose, color=shade, alpha=0.9 if full else 0.35)
        if full:
            view.legs(plan, *pose, angles[j], alpha=0.75, width=2.0)
    view.footholds(rounds.toes, size=14)
    style = {"color": palette.INK, "linewidth": 1.2, "marker": "o", "markersize": 2.5}
    view.line(rounds.com, 20, **style)


def _draw_numbers(view: View, com: Array) -> None:
    """Round numbers beside the path, left out where they would collide."""
    low, high = view.ax.get_ylim()
    last = -np.inf
    for j in _select_rounds(len(com) - 1)[1]:
        x, z = view.camera.project(com[j])
        if z - last < 0.035 * (high - low):
            continue
        last = z
        tag = view.ax.annotate(
            str(j), (x, z), (9, 0), textcoords="offset points", va="center", fontsize=9, zorder=21
        )
        tag.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8})


def postures(plan: ClimbPlan) -> Figure:
    """Return oblique, front (x-z) and side (y-z) views of a climb."""
    box = compute_climb_box(plan)
    angles = compute_round_angles(plan)
    wide = box.size[2] > 1.7 * max(box.size[:2])
    figure = new_figure(_compute_height(box.size, wide), entries=plan.robot.limb_count + 1)
    if wide:
        grid = figure.add_gridspec(1, 3, width_ratios=[1.75, 1.0, box.size[1] / box.size[0]])
        cells = [grid[0, 0], grid[0, 1], grid[0, 2]]
    else:
        grid = figure.add_gridspec(2, 2, width_ratios=[1.5, 1.0])
        cells = [grid[:, 0], grid[0, 1], grid[1, 1]]
    oblique = View(figure.add_subplot(cells[0]), choose_oblique_camera(plan, -63.0, 18.0), box)
    oblique.oblique_axes()
    _draw_climb(oblique, plan, angles)
    for cell, camera, name in (
        (cells[1], FRONT, "front"),
        (cells[2], SIDE, "side, from the right"),
    ):
        view = View(figure.add_subplot(cell), camera, box, obstacle_alpha=0.4, cut_walls=True)
        style_axes(view.ax)
        view.plain_axes("x" if camera is FRONT else "y")
        draw_panel_title(view.ax, name)
        _draw_climb(view, plan, angles)
        _draw_numbers(view, plan.rounds.com)
    names_by_limb = plan.robot.limb_names
    handles = [
        Line2D([], [], color=palette.choose_limb_color(i), marker="o", markersize=5, linewidth=2)
        for i in range(len(names_by_limb))
    ]
    path = Line2D([], [], color=palette.INK, marker="o", markersize=2.5, linewidth=1.2)
    draw_foot_legend(
        figure, [*handles, path], [*map(format_limb_name, names_by_limb), "body path by round"]
    )
    count = plan.rounds.count
    draw_heading(
        figure,
        f"Postures: {format_plain(plan.name, 36)}",
        f"{format_plain(plan.robot.name, 24)}, {count} round{'s' if count > 1 else ''}, "
        f"{float(plan.rounds.com[-1, 2] - plan.rounds.com[0, 2]):.2f} m up; dots are footholds",
    )
    return figure


def _compute_height(size: Array, wide: bool) -> float:
    """Return figure height [in] at which the views fill their columns."""
    if wide:
        return float(np.clip(2.0 + 3.0 * size[2] / size[0], 6.0, 13.0))
    return float(np.clip(1.5 + 2 * 3.6 * size[2] / max(size[0], size[1]), 6.0, 9.5))
