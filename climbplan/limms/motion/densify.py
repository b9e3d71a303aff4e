"""From knots to dense samples: exact cubics, inverse kinematics at each sample, exact forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.modules.chain import solve_inverse_kinematics
from climbplan.limms.modules.limbs import compute_limb_frames, compute_side_pose
from climbplan.limms.motion.cubics import evaluate_box_path, sample_knots
from climbplan.limms.motion.straight_motion import compute_rates, select_branch
from climbplan.limms.motion.timeline import (
    FREE,
    MANIPULATED,
    NOWHERE,
    PartialPlan,
    Stretch,
    sample_times,
)
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS, FramePoses, ModuleScene
from climbplan.limms.scene.phases import PhaseTrajectory, SupportModule, compute_load_sharing
from climbplan.limms.scene.placement import (
    centre_of,
    inertia_about_vertical,
    rotate_to_world,
    yaw_of,
)

_RETREATS = ((12.0, 0.05), (25.0, 0.03), (50.0, 0.02), (100.0, 0.01))  # [m/s^2], [s]


class CannotFollow(Exception):
    """A module cannot follow the box after releasing it."""


def add_trajectories(
    partial_plan: PartialPlan,
    limbs: Sequence[SupportModule],
    trajectories: Sequence[PhaseTrajectory],
) -> None:
    """Add the stretches of solved phases to a plan.

    Raises:
        CannotFollow: A module that threw the box cannot get out of its way.
    """
    for trajectory in trajectories:
        if trajectory.phase.kind == "flight":
            _add_flight(partial_plan, limbs, trajectory)
        else:
            _add_held(partial_plan, limbs, trajectory)


def _add_held(
    partial_plan: PartialPlan, limbs: Sequence[SupportModule], trajectory: PhaseTrajectory
) -> None:
    """Add a phase in which arms hold the box."""
    scene, phase = partial_plan.scene, trajectory.phase
    time = sample_knots(trajectory.duration, phase.intervals)
    position, velocity, acceleration = evaluate_box_path(
        trajectory.duration, trajectory.position, trajectory.velocity, trajectory.acceleration, time
    )
    partial_plan.box_mode = MANIPULATED
    stretch = partial_plan.build_rest(phase.kind, time)
    _move_box(stretch, position, velocity, acceleration)
    roots = np.tile(trajectory.feet[0], (len(time), 1, 1))
    for i, limb in enumerate(limbs):
        first, last = compute_limb_frames(scene, limb, position, roots[:, i])
        shape = (len(time), 3, 3)
        first = FramePoses(first.position, np.broadcast_to(first.rotation, shape))
        last = FramePoses(last.position, np.broadcast_to(last.rotation, shape))
        angles = select_branch(
            scene.module, first, last, trajectory.angles[0, i], trajectory.angles[-1, i]
        )
        # Full turns of rolls continue from the current ones
        full_turns = (
            np.round((partial_plan.angles[limb.module] - angles[0]) / (2 * np.pi)) * 2 * np.pi
        )
        stretch.place(limb.module, first, angles + full_turns, compute_rates(time, angles))
    force = _compute_latch_forces(scene, limbs, position, acceleration)
    for i, limb in enumerate(limbs):
        stretch.force[:, limb.side] = force[:, i]
    partial_plan.add(stretch)


def _move_box(stretch: Stretch, position: Array, velocity: Array, acceleration: Array) -> None:
    """Write placements (n, D) and their rates into a stretch."""
    for k, (values, target) in enumerate(
        (
            (position, stretch.box),
            (velocity, stretch.velocity),
            (acceleration, stretch.acceleration),
        )
    ):
        target[:] = centre_of(values)
        stretch.turning[:, k] = yaw_of(values)


def _compute_latch_forces(
    scene: ModuleScene, limbs: Sequence[SupportModule], position: Array, acceleration: Array
) -> Array:
    """Return the forces (n, limbs, 3) of latches on the box in the world frame [N]."""
    offsets = np.array([scene.side_offset(0, limb.side) for limb in limbs])
    load_sharing = compute_load_sharing(offsets, scene.module.max_force, scene.module.latch_moment)
    mass, yaw = float(scene.box_mass[0]), yaw_of(position)
    wrench = np.empty((len(position), 4))
    wrench[:, :3] = rotate_to_world(
        -yaw, mass * (centre_of(acceleration) + np.array([0, 0, GRAVITY]))
    )
    wrench[:, 3] = inertia_about_vertical(mass, scene.box_size[0]) * yaw_of(acceleration)
    forces = wrench @ load_sharing[: 3 * len(limbs)].T
    return rotate_to_world(yaw[:, None], forces.reshape(len(wrench), len(limbs), 3))


def _add_flight(
    partial_plan: PartialPlan, limbs: Sequence[SupportModule], trajectory: PhaseTrajectory
) -> None:
    """Add a phase in which the box flies, and modules that threw it stop next to its path."""
    scene = partial_plan.scene
    time = sample_times(trajectory.duration)
    position, velocity, acceleration = evaluate_box_path(
        trajectory.duration, trajectory.position, trajectory.velocity, trajectory.acceleration, time
    )
    partial_plan.box_mode = FREE
    for limb in limbs:
        anchors = partial_plan.base_anchor if limb.box_end == 0 else partial_plan.tip_anchor
        anchors[limb.module] = NOWHERE
    stretch = partial_plan.build_rest("flight", time)
    _move_box(stretch, position, velocity, acceleration)
    for limb in limbs:
        start, rotation = compute_side_pose(scene, position[0], limb.side, limb.box_end)
        normal = rotate_to_world(yaw_of(position[0]), SIDE_NORMALS[limb.side])
        # Velocity of the latch at its release, with the rotation of the box
        release_velocity = centre_of(velocity[0]) + np.cross(
            [0, 0, yaw_of(velocity[0])], start - position[0, :3]
        )
        for brake, hurry in _RETREATS:
            ends = _plan_retreat(start, release_velocity, normal, time, brake, hurry)
            on_box = FramePoses(ends, np.broadcast_to(rotation, (len(time), 3, 3)))
            far_pose = FramePoses(
                np.tile(limb.fixed_position, (len(time), 1)),
                np.broadcast_to(limb.other_rotation, (len(time), 3, 3)),
            )
            first, last = (on_box, far_pose) if limb.box_end == 0 else (far_pose, on_box)
            current = partial_plan.angles[limb.module]
            angles = _follow_branch(scene, first, last, current)
            if angles is None:
                continue
            rates = compute_rates(time, angles)
            if np.abs(rates).max() <= scene.module.max_joint_speed:
                break
        else:
            raise CannotFollow(
                f"module {scene.module_names[limb.module]} cannot stop after the throw"
            )
        stretch.place(limb.module, first, angles, rates)
    partial_plan.add(stretch)


def _plan_retreat(
    start: Array, velocity: Array, normal: Array, time: Array, deceleration: float, hurry: float
) -> Array:
    """Return the path (n, 3) of a latch that releases a moving box and stops away from its face
    [m].
    """
    normal_speed = float(velocity @ normal)
    tangential = velocity - normal_speed * normal
    speed = float(np.linalg.norm(tangential))
    stop = speed / deceleration
    t = np.minimum(time, stop)[:, None]
    direction = tangential / speed if speed > 0 else np.zeros(3)
    positions = start + tangential * t - deceleration * direction * t**2 / 2
    # Along the normal: accelerate briefly, then move at least as fast as the box follows
    gain = 0.15 / hurry
    u = np.minimum(time, hurry)
    path = normal_speed * time + gain * u**2 / 2 + gain * hurry * np.maximum(time - hurry, 0)
    if normal_speed < 0:  # the box moves away: stop
        stop_time = min(-normal_speed / deceleration, time[-1])
        v = np.minimum(time, stop_time)
        path = path - normal_speed * time + normal_speed * v + deceleration * v**2 / 2
    return np.asarray(positions + path[:, None] * normal)


def _follow_branch(
    scene: ModuleScene, first: FramePoses, last: FramePoses, current: Array
) -> Array | None:
    """Return angles (n, 6) that continue from the current ones; None where out of reach."""
    from climbplan.limms.modules.chain import BRANCHES, range_excess

    for branch in BRANCHES:
        solution = solve_inverse_kinematics(scene.module, first, last, branch)
        angles = np.unwrap(solution.angles, axis=0)
        angles = angles + np.round((current - angles[0]) / (2 * np.pi)) * 2 * np.pi
        if solution.reach_error.max() > 0 or range_excess(scene.module, angles).max() > 0:
            continue
        if np.abs(angles[0] - current).max() < 1e-3:
            return angles
    return None
