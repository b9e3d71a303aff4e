"""Arms on arms: where a module on the wall holds the end that carries another module.

The first module of a chain (the carrier) is latched to the terrain and holds its free end still.
The second (the added arm, rules 9 to 11) moves the box; to it that end is an anchor like any other.
Poses of the end are sampled between anchor and box. A pose is feasible if the added arm follows the
whole path of the box from it in one branch, the carrier reaches it, and the added arm reaches it
from the ground.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.limms.modules.chain import BRANCHES, range_excess, solve_inverse_kinematics
from climbplan.limms.modules.limbs import compute_side_pose, compute_standing_rotation
from climbplan.limms.motion.moving import compute_gaps, compute_rooted_points
from climbplan.limms.motion.timeline import PartialPlan
from climbplan.limms.scene.limms_scene import FramePoses, ModuleScene

_NORMAL_OFFSETS = (0.3, 0.45, 0.6, 0.75)  # [m] from the anchor, along its normal
_LATERAL_OFFSETS = (-0.3, -0.15, 0.0, 0.15, 0.3)  # [m] across the normal
_RINGS = (0.25, 0.4, 0.55)  # [m] from the end to where a module may stand
_SPOKES = 8
_MARGIN = 0.01  # [m] of the carrier from everything


@dataclass(frozen=True)
class CarrierPose:
    """A pose of a carrier: its free end as the root of the added arm, and its joints."""

    root: FramePoses  # pose of the added arm's last end
    carrier: Array  # (6,) [rad]
    joint_travel: float  # [rad] of the added arm along the path of the box


def find_carrier_poses(
    partial_plan: PartialPlan,
    carrier: int,
    *,
    side: int,
    path: Array,
    ground: tuple[float, ...],
    max_poses: int = 6,
) -> list[CarrierPose]:
    """Return poses that hold an added arm, those of least joint travel first.

    Args:
        partial_plan: The carrier is latched to the terrain, all else is where it is then.
        carrier: The carrier.
        side: Side of the box that the added arm takes.
        path: Placements of the box (T, D) [m, rad].
        ground: Heights where modules stand [m].
        max_poses: Largest number of poses.
    """
    scene = partial_plan.scene
    wall_end = 1 if partial_plan.tip_anchor[carrier] >= 0 else 0
    points = partial_plan.points(carrier)
    anchored = FramePoses(points.position[7 * wall_end], points.rotation[7 * wall_end])
    normal = anchored.rotation[:, 2] * (1.0 if wall_end == 0 else -1.0)
    positions, frames = _sample_end_poses(anchored.position, normal)
    joint_travel = _compute_joint_travel(scene, side, positions, frames, path)
    is_candidate = np.isfinite(joint_travel)
    is_candidate[is_candidate] = _find_accessible(
        scene, positions[is_candidate], frames[is_candidate], ground
    )
    order = np.flatnonzero(is_candidate)[np.argsort(joint_travel[is_candidate])]
    poses: list[CarrierPose] = []
    for k in order:
        target = FramePoses(positions[k], frames[k])
        angles = _solve_carrier(partial_plan, carrier, wall_end, anchored, target)
        if angles is not None:
            poses.append(CarrierPose(target, angles, float(joint_travel[k])))
        if len(poses) >= max_poses:
            break
    return poses


def _sample_end_poses(anchor: Array, normal: Array) -> tuple[Array, Array]:
    """Return positions (N, 3) and frames (N, 3, 3) of the added arm's last end."""
    up = np.array([0.0, 0.0, 1.0])
    if abs(normal @ up) > 0.5:
        up = np.array([1.0, 0.0, 0.0])
    lateral = np.cross(normal, up)
    directions = [
        _normalise(-normal + a * up + b * lateral) for a, b in product((-1.0, 0.0, 1.0), repeat=2)
    ] + [up, -up, lateral, -lateral]
    positions, frames = [], []
    for distance, a, b in product(_NORMAL_OFFSETS, _LATERAL_OFFSETS, _LATERAL_OFFSETS):
        for z in directions:
            positions.append(anchor + distance * normal + a * up + b * lateral)
            frames.append(_build_frame(z))
    return np.array(positions), np.array(frames)


def _normalise(vector: Array) -> Array:
    """Return the unit vector."""
    unit: Array = vector / np.linalg.norm(vector)
    return unit


def _build_frame(z: Array) -> Array:
    """Return a rotation (3, 3) with this z axis; its roll is free, as the next joint is a roll."""
    x = _normalise(np.cross([0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [1.0, 0.0, 0.0], z))
    return np.column_stack([x, np.cross(z, x), z])


def _compute_joint_travel(
    scene: ModuleScene, side: int, positions: Array, frames: Array, path: Array
) -> Array:
    """Return the joint travel (N,) of the added arm along the path [rad]; inf if infeasible."""
    on_box = compute_side_pose(scene, path[:, None], side, 0)  # (T, 1, 3)
    count = (len(path), len(positions), 3)
    first = FramePoses(
        np.broadcast_to(on_box.position, count), np.broadcast_to(on_box.rotation, (*count, 3))
    )
    last = FramePoses(np.broadcast_to(positions, count), np.broadcast_to(frames, (*count, 3)))
    travel = np.full(len(positions), np.inf)
    for branch in BRANCHES:
        solution = solve_inverse_kinematics(scene.module, first, last, branch)
        angles = np.unwrap(solution.angles, axis=0)
        full_turns = np.round((angles.max(axis=0) + angles.min(axis=0)) / 2 / (2 * np.pi))
        angles = angles - full_turns * 2 * np.pi * (np.array(scene.module.joint_range) > np.pi)
        is_infeasible = (solution.reach_error > 0).any(axis=0)
        is_infeasible |= (range_excess(scene.module, angles, 0.15) > 0).any(axis=0)
        length = np.abs(np.diff(angles, axis=0)).max(axis=-1).sum(axis=0)
        travel = np.minimum(travel, np.where(is_infeasible, np.inf, length))
    return travel


def _find_accessible(
    scene: ModuleScene, positions: Array, frames: Array, ground: tuple[float, ...]
) -> BoolArray:
    """Return which ends a module that stands on the ground reaches with its last end, bool (N,)."""
    is_accessible = np.zeros(len(positions), bool)
    for height, ring in product(ground, _RINGS):
        for angle in np.linspace(0, 2 * np.pi, _SPOKES, endpoint=False):
            standing = positions[:, :2] + ring * np.array([np.cos(angle), np.sin(angle)])
            bases = np.column_stack([standing, np.full(len(standing), height)])
            is_on_ground = np.zeros(len(positions), bool)
            for patch in scene.patches:
                if abs(patch.height - height) < 1e-6:
                    is_on_ground |= patch.contains(bases, 0.05)
            base = FramePoses(
                bases, np.broadcast_to(compute_standing_rotation(0), (len(bases), 3, 3))
            )
            for branch in BRANCHES if is_on_ground.any() else ():
                solution = solve_inverse_kinematics(
                    scene.module, base, FramePoses(positions, frames), branch
                )
                fits = (solution.reach_error <= 0) & (
                    range_excess(scene.module, solution.angles) <= 0
                )
                is_accessible |= is_on_ground & fits
    return is_accessible


def _solve_carrier(
    partial_plan: PartialPlan, carrier: int, wall_end: int, anchored: FramePoses, target: FramePoses
) -> Array | None:
    """Return joints (6,) of the carrier that hold its free end at the target, or None."""
    scene = partial_plan.scene
    if wall_end == 1:
        first, last = target, anchored
    else:
        first, last = (
            anchored,
            FramePoses(target.position, target.rotation @ np.diag([1.0, -1, -1])),
        )
    options: list[tuple[float, Array]] = []
    for branch in BRANCHES:
        solution = solve_inverse_kinematics(scene.module, first, last, branch)
        angles = solution.angles
        if solution.reach_error > 0 or range_excess(scene.module, angles, 0.05) > 0:
            continue
        gap = float(
            compute_gaps(
                partial_plan,
                carrier,
                compute_rooted_points(partial_plan, anchored, wall_end, angles[None]),
                wall_end,
            )[0]
        )
        if gap >= _MARGIN:
            options.append((float(np.abs(angles - partial_plan.angles[carrier]).max()), angles))
    return min(options, key=lambda option: option[0])[1] if options else None


def find_ground_heights(scene: ModuleScene) -> tuple[float, ...]:
    """Return the heights of the ground that modules stand on at the start [m]."""
    return tuple(
        sorted({float(stand[2]) for stand in scene.start_position if not np.isnan(stand).any()})
    )


def combine_carrier_poses(
    choices: list[list[CarrierPose]], max_combinations: int = 6
) -> Iterator[tuple[CarrierPose, ...]]:
    """Yield a pose for each chain, those of least joint travel in total first."""
    combinations = sorted(
        product(*choices), key=lambda poses: sum(pose.joint_travel for pose in poses)
    )
    yield from combinations[:max_combinations]
