"""Scenes of modules that deliver a box, for the viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.pages.obstacles import find_obstacles
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import BOX_MODES, MODULE_MODES, LimmsPlan
from climbplan.limms.plan.summary import describe_boxes
from climbplan.limms.scene.placement import rotation_about_vertical
from climbplan.reports import palette
from climbplan.reports.key_frames import select_key_frames
from climbplan.reports.viewer.scene import (
    Boxes,
    ForceArrows,
    Rods,
    StaticLines,
    StaticMesh,
    ViewerScene,
    build_block,
)

_TOLERANCE = 2e-3  # [m], error of the view between key frames
_GROUND_MARGIN = 0.4  # [m] of ground and walls drawn beyond the motion
_ANCHOR_SIZE = 0.03  # [m], edge of a drawn anchor


def read_scene(path: Path) -> ViewerScene:
    """Read the scene of a LIMMS plan file.

    Raises:
        PlanFileError: The file is damaged.
    """
    return build_module_scene(read_limms_plan(path))


def build_module_scene(plan: LimmsPlan) -> ViewerScene:
    """Build the scene of a plan."""
    motion = plan.motion
    count, modules = motion.joint_position.shape[:2]
    # Rotations count by the path of corners
    radii = np.linalg.norm(plan.box_size[:, :2] / 2, axis=1)
    values = np.concatenate(
        [
            motion.box_position.reshape(count, -1),
            motion.box_yaw * radii,
            motion.joint_position.reshape(count, -1),
        ],
        axis=1,
    )
    changed = (np.diff(motion.time) <= 0) | (np.diff(motion.mode, axis=0) != 0).any(axis=1)
    forced = np.concatenate([[False], changed]) | np.concatenate([changed, [False]])
    frames = select_key_frames(motion.time, values, forced, _TOLERANCE)
    joints = motion.joint_position[frames]  # (F, L, 8, 3)
    links = np.stack([joints[:, :, :-1], joints[:, :, 1:]], axis=3)  # (F, L, 7, 2, 3)
    boxes = motion.box_position[frames]
    points = np.concatenate([joints.reshape(-1, 3), boxes.reshape(-1, 3), plan.goal])
    lower, upper = points.min(axis=0) - 0.2, points.max(axis=0) + 0.2
    num_links = links.shape[2]
    starts = [start for _, start, _ in plan.stages]
    time = motion.time[frames]
    return ViewerScene(
        title=plan.name,
        facts=(
            f"{modules} modules, {describe_boxes(plan)}, {plan.method}",
            f"{1e3 * plan.objective:.2f} mm off its goal at the end",
        ),
        time=time,
        caption=_build_captions(plan, frames),
        marks=np.unique(np.searchsorted(time, starts)).astype(np.int64),
        shapes=(*_build_solids(plan, lower, upper), *_build_anchors(plan)),
        paths=tuple(
            StaticLines(
                f"box {b}" if plan.deliveries > 1 else "box",
                np.stack([boxes[:-1, b], boxes[1:, b]], axis=1),
                palette.TRACE,
            )
            for b in range(plan.deliveries)
        ),
        rods=Rods(
            links.reshape(len(frames), modules * num_links, 2, 3),
            np.full(modules * num_links, float(plan.module["radius"])),
            tuple(palette.choose_limb_color(m) for m in range(modules) for _ in range(num_links)),
        ),
        boxes=_build_boxes(plan, boxes, motion.box_yaw[frames]),
        forces=_build_forces(plan, frames),
        lower=lower,
        upper=upper,
    )


def _build_captions(plan: LimmsPlan, frames: IntArray) -> tuple[str, ...]:
    """Return the caption of each frame."""
    motion, texts = plan.motion, []
    names = np.array([name for name, _, _ in plan.stages])
    starts = np.array([start for _, start, _ in plan.stages])
    for k in frames:
        stage = names[max(int(np.searchsorted(starts, motion.time[k], side="right")) - 1, 0)]
        modes = ", ".join(
            f"{name} {MODULE_MODES[int(mode)]}"
            for name, mode in zip(plan.module_names, motion.mode[k], strict=True)
        )
        modes_of_boxes = motion.box_mode[k, : plan.deliveries]
        box_names = (
            ["box"]
            if len(modes_of_boxes) == 1
            else [f"box {b}" for b in range(len(modes_of_boxes))]
        )
        boxes = ", ".join(
            f"{n} {BOX_MODES[int(m)]}" for n, m in zip(box_names, modes_of_boxes, strict=True)
        )
        texts.append(f"{stage}: {boxes}, {modes}")
    return tuple(texts)


def _build_solids(plan: LimmsPlan, lower: Array, upper: Array) -> list[StaticMesh]:
    """Return shapes of solids, clipped to the surroundings of the motion."""
    low_limit, high_limit = lower - _GROUND_MARGIN, upper + _GROUND_MARGIN
    obstacles, shapes = find_obstacles(plan), []
    for number, (low, high) in enumerate(plan.solids):
        a, b = np.maximum(low, low_limit), np.minimum(high, high_limit)
        if not (a < b).all():
            continue
        if (obstacles == np.stack([low, high])).all(axis=(1, 2)).any():
            shapes.append(build_block(f"obstacle {number}", a, b, palette.MUTED, 0.8))
        else:
            shapes.append(build_block(f"solid {number}", a, b, palette.SURFACE, 0.5))
    return shapes


def _build_anchors(plan: LimmsPlan) -> list[StaticMesh]:
    """Return shapes of anchors on walls and ground, and of goals; those of boxes move with them."""
    first = 4 * len(plan.box_size)
    half = _ANCHOR_SIZE / 2
    anchors = zip(plan.anchor_names[first:], plan.motion.anchor_position[0, first:], strict=True)
    shapes = [
        build_block(name, position - half, position + half, palette.FORCE, 1.0)
        for name, position in anchors
    ]
    for b, (goal, half) in enumerate(zip(plan.goal, plan.box_size / 2, strict=True)):
        if b < plan.deliveries:
            name = f"goal {b}" if plan.deliveries > 1 else "goal"
            yaw = float(plan.goal_yaw[b])
            shapes.append(build_block(name, goal - half, goal + half, palette.LABELS[0], 0.2, yaw))
    return shapes


def _build_boxes(plan: LimmsPlan, center: Array, yaw: Array) -> Boxes:
    """Return all boxes in motion."""
    count, boxes = center.shape[:2]
    return Boxes(
        center,
        rotation_about_vertical(yaw),
        np.broadcast_to(plan.box_size, (count, boxes, 3)),
        tuple(palette.OBSTACLE if b < plan.deliveries else palette.MUTED for b in range(boxes)),
        0.85,
    )


def _build_forces(plan: LimmsPlan, frames: IntArray) -> ForceArrows:
    """Return the forces on boxes."""
    motion = plan.motion
    count, boxes = motion.force[frames].shape[:2]
    force = motion.force[frames].reshape(count, 4 * boxes, 3)
    return ForceArrows(
        point=motion.anchor_position[frames][:, : 4 * boxes],
        force=force,
        normal=np.zeros_like(force),  # latches on boxes have no friction cone
        mu=np.zeros(force.shape[:2]),
    )
