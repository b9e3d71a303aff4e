"""Assembly: modules drive up, latch to walls or to each other, and reach for the box."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import BRANCHES, range_excess, solve_inverse_kinematics
from climbplan.limms.modules.limbs import (
    compute_anchor_pose,
    compute_side_pose,
    compute_standing_rotation,
)
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.reaching import drive, reach
from climbplan.limms.motion.straight_motion import APPROACH_LENGTHS, plan_straight_approach, retract
from climbplan.limms.motion.timeline import ARM, DRIVES, LEG, NOWHERE, PartialPlan
from climbplan.limms.scene.bounds import compute_ground_end_frame
from climbplan.limms.scene.limms_scene import FramePoses, ModuleScene
from climbplan.limms.scene.phases import SupportModule

_RINGS = (0.25, 0.35, 0.45, 0.55, 0.65)
_SPOKES = 16
_ROLL_MARGIN = 0.02  # [rad] of rolls from their ranges, for the motion after release


def build_initial_plan(scene: ModuleScene) -> PartialPlan:
    """Return the state at the start: modules straight, upright or along normals of anchors."""
    count = scene.num_modules
    position, rotation = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
    for module in range(count):
        if scene.start_anchor[module] >= 0:
            pose = compute_anchor_pose(
                scene, int(scene.start_anchor[module]) - scene.wall_offset, 0
            )
            position[module], rotation[module] = pose
        else:
            position[module] = scene.start_position[module]
    return PartialPlan.at_start(scene, (position, rotation), np.zeros((count, 6)))


def compute_end_pose(partial_plan: PartialPlan, module: int, end: int) -> FramePoses:
    """Return the pose of an end of a module now."""
    points = partial_plan.points(module)
    return FramePoses(points.position[7 * end], points.rotation[7 * end])


def list_standing_points(
    scene: ModuleScene, height: float, target: FramePoses, around: Array
) -> Iterator[Array]:
    """Yield points of ground at one height around a target, the nearest to `around` first."""
    points = []
    for ring in _RINGS:
        for angle in np.linspace(0, 2 * np.pi, _SPOKES, endpoint=False):
            position = target.position[:2] + ring * np.array([np.cos(angle), np.sin(angle)])
            point = np.array([*position, height])
            if any(
                abs(p.height - height) < 1e-6 and p.contains(point, 0.05) for p in scene.patches
            ):
                points.append(point)
    points.sort(key=lambda point: float(np.linalg.norm(point - around)))
    yield from points


def release_ground_anchor(partial_plan: PartialPlan, module: int) -> PartialPlan:
    """Return the plan after a module upright on a ground anchor starts to drive."""
    scene, anchor = partial_plan.scene, int(partial_plan.base_anchor[module])
    if anchor < scene.wall_offset or not compute_ground_end_frame(
        scene, anchor - scene.wall_offset
    ):
        return partial_plan
    released = partial_plan.copy()
    released.base_anchor[module] = NOWHERE
    released.mode[module] = DRIVES
    released.grounded[module] = 0
    return released


def latch_from_ground(
    partial_plan: PartialPlan,
    module: int,
    target: FramePoses,
    anchor: int,
    *,
    mode: int,
    name: str,
    rng: np.random.Generator,
    tries: int = 4,
) -> PartialPlan:
    """Drive to a point from which the last end reaches `target`, latch it, and lift the first end.

    Args:
        partial_plan: Where everything is.
        module: The module.
        target: Pose of the last end at the anchor.
        anchor: The anchor.
        mode: Mode of the module afterwards.
        name: Label of the motion.
        rng: Random generator.
        tries: Number of failed motions before giving up.

    Raises:
        Blocked: No such point was found.
    """
    scene = partial_plan.scene
    partial_plan = release_ground_anchor(partial_plan, module)
    position = partial_plan.base_position[module]
    failures = 0
    for point in list_standing_points(scene, float(position[2]), target, position):
        base = FramePoses(point, compute_standing_rotation(0))
        for angles in _iterate_reaching_angles(partial_plan, module, base, target):
            attempt = partial_plan.copy()
            try:
                drive(attempt, module, point, f"{name}: drive", rng)
                reach(
                    attempt,
                    module,
                    base,
                    0,
                    target=target,
                    ending=angles,
                    name=f"{name}: reach",
                    rng=rng,
                )
                attempt.mode[module] = mode
                attempt.tip_anchor[module] = anchor
                attempt.grounded[module] = NOWHERE
                retract(attempt, module, target, 1, f"{name}: lift off")
            except Blocked:
                failures += 1
                if failures >= tries:
                    raise
                break
            return attempt
    raise Blocked(
        f"{name}: no place to stand from which module {scene.module_names[module]} reaches"
    )


def _iterate_reaching_angles(
    partial_plan: PartialPlan, module: int, base: FramePoses, target: FramePoses
) -> Iterator[Array]:
    """Yield joint angles (6,) with which a module at `base` reaches a target straight [rad]."""
    scene, at_base = partial_plan.scene, partial_plan.copy()
    at_base.base_position[module] = base.position
    length = APPROACH_LENGTHS[-1]
    for branch in BRANCHES:
        solution = solve_inverse_kinematics(scene.module, base, target, branch)
        angles = solution.angles
        if solution.reach_error > 0 or range_excess(scene.module, angles) > 0:
            continue
        approach = plan_straight_approach(
            at_base, module, base, 0, target=target, ending=angles, length=length
        )
        if approach is not None:
            yield angles


def latch_arm(
    partial_plan: PartialPlan, module: int, wall_anchor: int, name: str, rng: np.random.Generator
) -> tuple[PartialPlan, int]:
    """Latch a module to a terrain anchor; return the plan and which of its ends is free."""
    anchor = partial_plan.scene.wall_offset + wall_anchor
    if partial_plan.base_anchor[module] == anchor:
        return partial_plan, 1
    if partial_plan.tip_anchor[module] == anchor:
        return partial_plan, 0
    target = compute_anchor_pose(partial_plan.scene, wall_anchor, 1)
    return latch_from_ground(partial_plan, module, target, anchor, mode=ARM, name=name, rng=rng), 0


def reach_box(
    partial_plan: PartialPlan,
    limb: SupportModule,
    box: Array,
    path: Array,
    name: str,
    rng: np.random.Generator,
) -> None:
    """Add a motion that brings an arm's free end to its side of the box at rest, not yet latched.

    Rolls start at those full turns that keep the whole path in range.

    Args:
        partial_plan: Where everything is.
        limb: The arm.
        box: Placement of the box (D,) [m, rad].
        path: Joint angles of the motion with the box, from latching on (n, 6) [rad].
        name: Label of the motion.
        rng: Random generator.

    Raises:
        Blocked: No free path was found.
    """
    target = compute_side_pose(partial_plan.scene, box, limb.side, limb.box_end)
    root = FramePoses(limb.fixed_position, limb.other_rotation)
    ending = _choose_turns(
        path, partial_plan.angles[limb.module], np.array(partial_plan.scene.module.joint_range)
    )
    reach(
        partial_plan,
        limb.module,
        root,
        1 - limb.box_end,
        target=target,
        ending=ending,
        name=name,
        rng=rng,
    )


def _choose_turns(path: Array, current: Array, limits: Array) -> Array:
    """Return the start (6,) of a path (n, 6) by full turns near to `current`, all in range."""
    unwrapped = np.unwrap(path, axis=0)
    turns = 2 * np.pi * np.arange(-2, 3)[:, None]
    starts = unwrapped[0] + turns  # (5, 6)
    excess = np.abs(unwrapped[:, None] + turns).max(axis=0) - limits + _ROLL_MARGIN
    # The nearest in range; without any, the one with the least excess
    rank = np.where(excess <= 0, np.abs(starts - current), 1e3 * (1 + excess))
    chosen: Array = np.take_along_axis(starts, rank.argmin(axis=0)[None], axis=0)[0]
    return chosen


def latch_box(partial_plan: PartialPlan, limbs: Sequence[SupportModule]) -> None:
    """Latch all limbs to the box at once."""
    for limb in limbs:
        anchors = partial_plan.base_anchor if limb.box_end == 0 else partial_plan.tip_anchor
        anchors[limb.module] = limb.side
        if limb.is_leg:
            partial_plan.mode[limb.module] = LEG


def stand_leg(
    partial_plan: PartialPlan,
    limb: SupportModule,
    foot: Array,
    angles: Array,
    rng: np.random.Generator,
) -> None:
    """Add motions that drive a module to a foothold and bring its last end to the box, not latched.

    Raises:
        Blocked: No free path was found.
    """
    scene, module = partial_plan.scene, limb.module
    name = scene.module_names[module]
    drive(partial_plan, module, foot, f"{name}: drive", rng)
    root = FramePoses(foot, compute_standing_rotation(0))
    target = compute_side_pose(scene, partial_plan.place, limb.side, limb.box_end)
    limits = np.array(scene.module.joint_range)
    current = partial_plan.angles[module]
    wrapped = angles + np.round((current - angles) / (2 * np.pi)) * 2 * np.pi
    ending = np.where(np.abs(wrapped) <= limits, wrapped, angles)
    reach(
        partial_plan, module, root, 0, target=target, ending=ending, name=f"{name}: reach", rng=rng
    )
