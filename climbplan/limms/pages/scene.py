"""Modules that deliver a box, as scenes."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.pages.obstacles import obstacles_of
from climbplan.limms.plan.file import read_limms_plan
from climbplan.limms.plan.limms_plan import BOX_MODES, MODULE_MODES, LimmsPlan
from climbplan.limms.plan.summary import boxes_in_words
from climbplan.limms.scene.placement import rotation_about_vertical
from climbplan.reports import palette
from climbplan.reports.key_frames import key_frames
from climbplan.reports.viewer.scene import Boxes, Forces, Path, Rods, Scene, Shape, block

_TOLERANCE = 2e-3  # [m] by which the view may be off between its samples
_AROUND = 0.4  # [m] of ground and walls drawn beyond the motion
_ANCHOR = 0.03  # [m] edge of an anchor as it is drawn


def read_scene(path: FilePath) -> Scene:
    """The scene of a LIMMS plan file.

    Raises PlanFileError for a damaged file.
    """
    return scene_of_modules(read_limms_plan(path))


def scene_of_modules(plan: LimmsPlan) -> Scene:
    """The scene of a plan that was read."""
    motion = plan.motion
    count, modules = motion.joint_position.shape[:2]
    # A turn counts as what corners go by it
    arms = np.linalg.norm(plan.box_size[:, :2] / 2, axis=1)
    values = np.concatenate(
        [
            motion.box_position.reshape(count, -1),
            motion.box_yaw * arms,
            motion.joint_position.reshape(count, -1),
        ],
        axis=1,
    )
    changed = (np.diff(motion.time) <= 0) | (np.diff(motion.mode, axis=0) != 0).any(axis=1)
    forced = np.concatenate([[False], changed]) | np.concatenate([changed, [False]])
    kept = key_frames(motion.time, values, forced, _TOLERANCE)
    joints = motion.joint_position[kept]  # (F, L, 8, 3)
    links = np.stack([joints[:, :, :-1], joints[:, :, 1:]], axis=3)  # (F, L, 7, 2, 3)
    boxes = motion.box_position[kept]
    reached = np.concatenate([joints.reshape(-1, 3), boxes.reshape(-1, 3), plan.goal])
    lower, upper = reached.min(axis=0) - 0.2, reached.max(axis=0) + 0.2
    each = links.shape[2]
    begins = [begin for _, begin, _ in plan.stages]
    time = motion.time[kept]
    return Scene(
        title=plan.name,
        facts=(
            f"{modules} modules, {boxes_in_words(plan)}, {plan.method}",
            f"{1e3 * plan.objective:.2f} mm off its goal at the end",
        ),
        time=time,
        caption=_captions(plan, kept),
        marks=np.unique(np.searchsorted(time, begins)).astype(np.int64),
        shapes=(*_solids(plan, lower, upper), *_anchors(plan)),
        paths=tuple(
            Path(
                f"box {b}" if plan.deliveries > 1 else "box",
                np.stack([boxes[:-1, b], boxes[1:, b]], axis=1),
                palette.TRACE,
            )
            for b in range(plan.deliveries)
        ),
        rods=Rods(
            links.reshape(len(kept), modules * each, 2, 3),
            np.full(modules * each, float(plan.module["radius"])),
            tuple(palette.limb_color(m) for m in range(modules) for _ in range(each)),
        ),
        boxes=_boxes(plan, boxes, motion.box_yaw[kept]),
        forces=_forces(plan, kept),
        lower=lower,
        upper=upper,
    )


def _captions(plan: LimmsPlan, kept: IntArray) -> tuple[str, ...]:
    motion, texts = plan.motion, []
    names = np.array([name for name, _, _ in plan.stages])
    begins = np.array([begin for _, begin, _ in plan.stages])
    for k in kept:
        stage = names[max(int(np.searchsorted(begins, motion.time[k], side="right")) - 1, 0)]
        modes = ", ".join(
            f"{name} {MODULE_MODES[int(mode)]}"
            for name, mode in zip(plan.module_names, motion.mode[k], strict=True)
        )
        own = motion.box_mode[k, : plan.deliveries]
        called = ["box"] if len(own) == 1 else [f"box {b}" for b in range(len(own))]
        boxes = ", ".join(f"{n} {BOX_MODES[int(m)]}" for n, m in zip(called, own, strict=True))
        texts.append(f"{stage}: {boxes}, {modes}")
    return tuple(texts)


def _solids(plan: LimmsPlan, lower: Array, upper: Array) -> list[Shape]:
    near, far = lower - _AROUND, upper + _AROUND
    obstacles, shapes = obstacles_of(plan), []
    for number, (low, high) in enumerate(plan.solids):
        a, b = np.maximum(low, near), np.minimum(high, far)
        if not (a < b).all():
            continue
        if (obstacles == np.stack([low, high])).all(axis=(1, 2)).any():
            shapes.append(block(f"obstacle {number}", a, b, palette.MUTED, 0.8))
        else:
            shapes.append(block(f"solid {number}", a, b, palette.SURFACE, 0.5))
    return shapes


def _anchors(plan: LimmsPlan) -> list[Shape]:
    """Anchors on walls and ground, and the goal; those of boxes move with them."""
    first = 4 * len(plan.box_size)
    half = _ANCHOR / 2
    places = zip(plan.anchor_names[first:], plan.motion.anchor_position[0, first:], strict=True)
    shapes = [block(name, at - half, at + half, palette.FORCE, 1.0) for name, at in places]
    for b, (goal, half) in enumerate(zip(plan.goal, plan.box_size / 2, strict=True)):
        if b < plan.deliveries:
            name = f"goal {b}" if plan.deliveries > 1 else "goal"
            turn = float(plan.goal_yaw[b])
            shapes.append(block(name, goal - half, goal + half, palette.LABELS[0], 0.2, turn))
    return shapes


def _boxes(plan: LimmsPlan, center: Array, yaw: Array) -> Boxes:
    count, boxes = center.shape[:2]
    return Boxes(
        center,
        rotation_about_vertical(yaw),
        np.broadcast_to(plan.box_size, (count, boxes, 3)),
        tuple(palette.OBSTACLE if b < plan.deliveries else palette.MUTED for b in range(boxes)),
        0.85,
    )


def _forces(plan: LimmsPlan, kept: IntArray) -> Forces:
    motion = plan.motion
    count, boxes = motion.force[kept].shape[:2]
    force = motion.force[kept].reshape(count, 4 * boxes, 3)
    return Forces(
        point=motion.anchor_position[kept][:, : 4 * boxes],
        force=force,
        normal=np.zeros_like(force),  # on a box a latch holds: there is no cone
        mu=np.zeros(force.shape[:2]),
    )
