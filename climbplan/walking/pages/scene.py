"""Walks, offline or in closed loop, as 3D scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.reports import palette
from climbplan.reports.viewer.scene import (
    Boxes,
    ForceArrows,
    Rods,
    StaticLines,
    StaticMesh,
    ViewerScene,
    build_polygons,
)
from climbplan.robots.rotations import rotation_world_body
from climbplan.walking.plan.file import read_walk_plan
from climbplan.walking.plan.foot_centres import restore_surface
from climbplan.walking.plan.walk_plan import WalkPlan
from climbplan.walking.task.task import ANGLES, VELOCITY

_RADIUS = 0.012  # [m] of a leg as it is drawn
_THICKNESS = 0.07  # [m] of the body as it is drawn: the model has no shape
_AROUND = 0.6  # [m] of ground drawn beyond the walk


def read_scene(path: Path) -> ViewerScene:
    """Read the scene of an MPC plan file; legs are straight lines from hip to toe.

    Raises:
        PlanFileError: a damaged file.
    """
    return build_walk_scene(read_walk_plan(path))


def build_walk_scene(plan: WalkPlan) -> ViewerScene:
    """Build the scene of a plan."""
    task, trajectory = plan.task, plan.trajectory
    count = len(trajectory.state)
    rotation = rotation_world_body(trajectory.state[:, ANGLES])
    center = trajectory.state[:, :3]
    hips = task.hips
    placed = center[:, None] + np.einsum("fij,nj->fni", rotation, hips)
    legs = np.stack([placed, trajectory.toes], axis=2)  # (F, 4, 2, 3)
    standing = trajectory.gait.contact
    force = trajectory.force * standing[..., None]
    size = np.array([np.ptp(hips[:, 0]), np.ptp(hips[:, 1]), _THICKNESS])
    every = 1 if plan.loop is None else plan.loop.samples
    points = np.concatenate([trajectory.toes.reshape(-1, 3), center])
    lower, upper = points.min(axis=0) - 0.1, points.max(axis=0) + 0.1
    return ViewerScene(
        title=plan.name,
        facts=(
            f"{task.body.name}, {task.body.mass:g} kg, {plan.method}",
            f"friction {task.ground.min_friction:g}, objective {plan.objective:.4g}",
        ),
        time=np.arange(count) * np.float64(task.dt),
        caption=_write_captions(plan),
        marks=np.arange(0, count, every),
        shapes=_build_ground(plan, lower, upper),
        paths=(StaticLines("body", np.stack([center[:-1], center[1:]], axis=1), palette.TRACE),),
        rods=Rods(
            legs,
            np.full(plan.task.body.leg_count, _RADIUS),
            tuple(map(palette.choose_limb_color, range(plan.task.body.leg_count))),
        ),
        boxes=Boxes(
            center[:, None],
            rotation[:, None],
            np.broadcast_to(size, (count, 1, 3)),
            (palette.BODY,),
            0.85,
        ),
        forces=ForceArrows(
            point=trajectory.toes,
            force=force,
            normal=standing[..., None] * np.array([0.0, 0.0, 1.0]),
            mu=np.where(standing, task.ground.find_friction(trajectory.gait.region), 0.0),
        ),
        lower=lower,
        upper=upper,
    )


def _write_captions(plan: WalkPlan) -> tuple[str, ...]:
    """Write a caption for each sample: speed and standing legs."""
    trajectory, names = plan.trajectory, plan.task.body.leg_names
    texts = []
    for n, (state, contact) in enumerate(
        zip(trajectory.state, trajectory.gait.contact, strict=True)
    ):
        legs = " ".join(name for name, stands in zip(names, contact, strict=True) if stands)
        speed = float(np.linalg.norm(state[VELOCITY]))
        pushed = plan.loop is not None and bool(plan.loop.push[n].any())
        texts.append(
            f"{speed:.2f} m/s, standing: {legs or 'none'}{', pushed here' if pushed else ''}"
        )
    return tuple(texts)


def _build_ground(plan: WalkPlan, lower: Array, upper: Array) -> tuple[StaticMesh, ...]:
    """Build the shapes of the terrain within a rectangle."""
    ground, shapes = restore_surface(plan.task.ground), []
    low, high = lower[:2] - _AROUND, upper[:2] + _AROUND
    friction = ground.find_friction(np.arange(ground.count))
    for region, name in enumerate(ground.names):
        corners = ground.outline(region, low, high)
        if len(corners):
            note = f"{name}  mu {friction[region]:g}"
            shapes.append(build_polygons(name, [corners], palette.SURFACE, 0.6, note))
    return tuple(shapes)
