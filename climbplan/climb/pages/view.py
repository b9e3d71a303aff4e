"""One projected picture of the scene on matplotlib axes, nearer things over farther ones."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator

from climbplan.arrays import Array
from climbplan.climb.pages.patches import (
    AxisAlignedBox,
    SurfacePolygon,
    compute_hull_points,
    compute_limb_points,
    list_solid_faces,
    list_surface_patches,
    sort_shoulders,
)
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.camera import OrthographicCamera, compute_silhouette
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.surfaces import Region

_EDGE_ON = 0.25  # |cosine| below which a wall is drawn with its thickness
_BEHIND, _MIDDLE = 1.0, 3.0  # drawing order: walls, then things by depth


def locate_gripper_tip(plan: ClimbPlan, wrist: Array, limb: int) -> Array | None:
    """Return the grip's centre (3,) of a gripper square to the nearest surface, or None."""
    if plan.robot.gripper is None:
        return None
    surface = plan.terrain.surfaces[plan.terrain.nearest_surface(limb, wrist)]
    return np.asarray(wrist - plan.robot.gripper.length * surface.normal_at(wrist))


@dataclass(frozen=True)
class View:
    """Axes, camera and the part of the world shown.

    Things are added as artists: limits are set, and need not be found from hundreds of them.
    """

    ax: Axes
    camera: OrthographicCamera
    box: AxisAlignedBox
    obstacle_alpha: float = 0.85
    cut_walls: bool = False  # walls seen from their edge show their thickness

    def _order(self, points: Array) -> float:
        """Return drawing order of something at these points, nearer later."""
        corners = np.array([self.box.lower, self.box.upper])
        reach = float(np.abs(corners - corners.mean(axis=0)).sum())
        depth = float(np.mean(self.camera.depth(points - corners.mean(axis=0))))
        return _MIDDLE + 2.5 * (1 + depth / reach)

    def polygon(self, vertices: Array, order: float | None = None, **style: Any) -> None:
        """A flat polygon (V, 3)."""
        zorder = self._order(vertices) if order is None else order
        self.ax.add_artist(Polygon(self.camera.project(vertices), zorder=zorder, **style))

    def outline(self, points: Array, order: float | None = None, **style: Any) -> None:
        """The convex outline of points (K, 3)."""
        zorder = self._order(points) if order is None else order
        flat = compute_silhouette(self.camera.project(points))
        self.ax.add_artist(Polygon(flat, zorder=zorder, **style))

    def line(self, points: Array, order: float | None = None, **style: Any) -> None:
        """A polyline (K, 3)."""
        zorder = self._order(points) if order is None else order
        self.ax.add_artist(Line2D(*self.camera.project(points).T, zorder=zorder, **style))

    def dots(self, points: Array, order: float | None = None, **style: Any) -> None:
        """Round markers at points (K, 3); style: of a line's markers."""
        zorder = self._order(points) if order is None else order
        flat = self.camera.project(points).T
        self.ax.add_artist(Line2D(*flat, zorder=zorder, ls="", marker="o", **style))

    def terrain(self, plan: ClimbPlan) -> None:
        """Walls behind the robot filled, walls before it as outlines; obstacles solid."""
        for surface in plan.terrain.surfaces:
            patches = list_surface_patches(surface, self.box)
            for patch in patches:
                if self.camera.faces_viewer(patch.normal):
                    self.polygon(patch.vertices, _BEHIND, fc=palette.SURFACE, alpha=0.28, lw=0)
            if patches:
                corners = np.concatenate([patch.vertices for patch in patches])
                self.outline(corners, _BEHIND + 0.1, fill=False, ec=palette.SURFACE, lw=1.0)
            if self.cut_walls and isinstance(surface, Region):
                self._thickness(surface)
        for solid in plan.terrain.obstacles:
            for face in list_solid_faces(solid, self.box):
                if self.camera.faces_viewer(face.normal):
                    self._obstacle_face(face)

    def _thickness(self, region: Region) -> None:
        """The material behind a wall, if it is seen from its edge."""
        if abs(float(self.camera.axes[2] @ region.normal)) > _EDGE_ON:
            return
        faces = list_solid_faces(region.slab(), self.box)
        if faces:
            points = np.concatenate([face.vertices for face in faces])
            self.outline(points, _BEHIND, fc=palette.SURFACE, alpha=0.55, lw=0)

    def _obstacle_face(self, face: SurfacePolygon) -> None:
        """One face of an obstacle, lit from above."""
        light = 0.62 + 0.38 * abs(float(face.normal @ np.array([0.30, -0.40, 0.87])))
        color = tuple(light * channel for channel in to_rgb(palette.OBSTACLE))
        self.polygon(face.vertices, fc=color, ec=palette.INK, lw=0.6, alpha=self.obstacle_alpha)

    def body(self, plan: ClimbPlan, com: Array, rpy: Array, *, color: str, alpha: float) -> None:
        """The body's box and the frame through its shoulders at a pose (3,), (3,)."""
        box = compute_hull_points(plan, com, rpy)
        ring = com + sort_shoulders(plan) @ rotation_world_body(rpy).T
        order = self._order(com[None])
        self.outline(box, order, fc=color, ec=palette.INK, lw=0.6, alpha=alpha)
        self.outline(ring, order + 1e-3, fc=color, ec=palette.INK, lw=0.8, alpha=0.6 * alpha)

    def legs(
        self, plan: ClimbPlan, com: Array, rpy: Array, angles: Array, *, alpha: float, width: float
    ) -> None:
        """Links and toes of all limbs, angles (N, 3) [rad], in the limbs' colours."""
        for limb, chain in enumerate(compute_limb_points(plan, com, rpy, angles)):
            color = palette.choose_limb_color(limb)
            for link in pairwise(chain):
                ends = np.array(link)
                self.line(ends, color=color, alpha=alpha, lw=width, solid_capstyle="round")
            size = math.sqrt(7 * width)
            self.dots(chain[3:], ms=size, color=color, alpha=alpha, mew=0)
            tip = locate_gripper_tip(plan, chain[-1], limb)
            if tip is not None:
                ends = np.array([chain[-1], tip])
                self.line(ends, color=palette.INK, alpha=alpha, lw=0.7 * width)

    def footholds(self, toes: Array, *, size: float) -> None:
        """Toe positions (M, N, 3) of all rounds in the limbs' colours; size: area [pt^2]."""
        for limb in range(toes.shape[1]):
            color = palette.choose_limb_color(limb)
            self.dots(toes[:, limb], ms=math.sqrt(size), color=color, mew=0.4, mec="white")

    def plain_axes(self, horizontal: str) -> None:
        """Limits, equal scale, grid and units for a view along an axis."""
        flat = self.camera.project(np.array([self.box.lower, self.box.upper]))
        self.ax.set_xlim(flat[:, 0].min(), flat[:, 0].max())
        self.ax.set_ylim(flat[:, 1].min(), flat[:, 1].max())
        self.ax.set_aspect("equal")
        self.ax.set_xlabel(f"{horizontal} [m]")
        self.ax.set_ylabel("z [m]")
        self.ax.xaxis.set_major_locator(MaxNLocator(5))
        self.ax.grid(color=palette.GRID, linewidth=0.5, zorder=0)
        self.ax.set_axisbelow(True)

    def oblique_axes(self) -> None:
        """Three edges of the box with ticks in metres, and the picture fitted round the box."""
        lower, upper = self.box.lower, self.box.upper
        toward = self.camera.axes[2]
        # Edges along the near bottom; z on the left of the picture.
        near_x = upper[0] if toward[0] > 0 else lower[0]
        near_y = upper[1] if toward[1] > 0 else lower[1]
        corners = [(lower[0], near_y), (near_x, upper[1]), (upper[0], near_y), (near_x, lower[1])]
        left = min(corners, key=lambda xy: self.camera.project(np.array([*xy, 0.0]))[0])
        self._edge(np.array([lower[0], near_y, lower[2]]), 0, upper[0], "x [m]")
        self._edge(np.array([near_x, lower[1], lower[2]]), 1, upper[1], "y [m]")
        self._edge(np.array([*left, lower[2]]), 2, upper[2], "z [m]")
        grid = np.array(list(itertools.product(*zip(lower, upper, strict=True))))
        flat = self.camera.project(grid)
        pad = np.array([[-0.30, -0.28], [0.08, 0.05]])
        low, high = np.array([flat.min(axis=0), flat.max(axis=0)]) + pad
        self.ax.set_xlim(low[0], high[0])
        self.ax.set_ylim(low[1], high[1])
        self.ax.set_aspect("equal")
        self.ax.set_axis_off()

    def _edge(self, start: Array, axis: int, end: float, label: str) -> None:
        """One labelled edge of the box with ticks outside it."""
        stop = start.copy()
        stop[axis] = end
        middle = (self.box.lower + self.box.upper) / 2
        style: dict[str, Any] = {"color": palette.MUTED, "linewidth": 0.8}
        self.line(np.array([start, stop]), _BEHIND - 0.2, **style)
        # Ticks point away from the picture's middle, at right angles to the edge.
        along = self.camera.project(stop) - self.camera.project(start)
        out = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        center = self.camera.project((start + stop) / 2)
        if out @ (center - self.camera.project(middle)) < 0:
            out = -out
        ticks = np.asarray(MaxNLocator(5, steps=[1, 2, 5, 10]).tick_values(start[axis], end))
        for value in ticks[(ticks > start[axis] - 1e-9) & (ticks < end + 1e-9)]:
            point = start.copy()
            point[axis] = value
            base = self.camera.project(point)
            tick = np.array([base, base + 0.02 * out]).T
            self.ax.add_artist(Line2D(*tick, zorder=_BEHIND - 0.2, **style))
            text = f"{value:g}".replace("-", "\N{MINUS SIGN}")
            self._text(base + 0.075 * out, text, fontsize=8, color=palette.MUTED)
        self._text(center + 0.20 * out, label, fontsize=9, color=palette.INK)

    def _text(self, position: Array, text: str, **style: Any) -> None:
        self.ax.text(
            float(position[0]), float(position[1]), text, ha="center", va="center", **style
        )
