"""Build the timed motion between the planned instants, with joint commands at a fixed rate.

Commands exceed the angles of the moving body by the joint deflection that contact forces cause.
Forces and body poses are interpolated linearly between balanced sets. Forces therefore balance the
load and stay in their convex friction cones all the way. If limbs have masses their weight moves on
curves; its deviation from the linear path is distributed to the standing limbs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray, spans_of
from climbplan.climb.clearance.swing import plan_swing_paths
from climbplan.climb.motion.keyframes import PACKED, Keyframes, build_keyframes
from climbplan.climb.plan.climb_plan import InstantForces, Instants, Rounds, Trajectory
from climbplan.climb.plan.grips import GripForces
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import ReachFailure, UsageError
from climbplan.mechanics.equilibrium import grasp_matrix, link_torques, weight_moment
from climbplan.mechanics.grip import Grippers
from climbplan.mechanics.stiffness import joint_softness, joint_turns
from climbplan.robots.joint_units import format_joint_position
from climbplan.robots.kinematics import (
    contact_jacobian,
    contact_points,
    require_reachable,
    sole_turns,
    solve_inverse_kinematics,
    to_body,
)
from climbplan.robots.last_link import joint_axes_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body

_NUM_PROBES = 9  # samples of a segment, for its shortest duration
_SPEED_MARGIN = 1.1  # factor on durations that sampled joint speeds need
_RANK_TOLERANCE = 1e-6  # of the largest singular value: no forces about a line of toes
MAX_ACCELERATION = 0.03  # by gravity, of a body on toes
_PRESSURE_OFFSET_FRACTION = (
    0.25  # of a flat foot's half width, for the shift of the centre of pressure by inertia
)
BOUND_TOLERANCE = 1e-7  # [rad] of solvers
_MAX_SAMPLES = 1_000_000  # larger plans would take gigabytes to verify


@dataclass(frozen=True)
class TimedMotion:
    """A motion, and the largest motor torque at any sample by its limit."""

    trajectory: Trajectory
    torque_use: float
    frames: Keyframes  # between which it moves


def plan_trajectory(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: InstantForces,
    swings: tuple[Array, ...] | None = None,
) -> Trajectory:
    """Plan the trajectory of a motion; see `build_timed_motion`."""
    return build_timed_motion(scene, rounds, instants, forces, swings).trajectory


def build_timed_motion(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: InstantForces,
    swings: tuple[Array, ...] | None = None,
) -> TimedMotion:
    """Build body poses and joint commands at a fixed rate, within joint bounds and speeds.

    The mean speed of the body is the spec's unless joint speeds need more time. Every segment takes
    a whole number of samples, so that every instant is sampled.

    Args:
        scene: The scene.
        rounds: The postures.
        instants: The instants.
        forces: Forces at the instants.
        swings: Way points of every swing; None plans them.

    Raises:
        ReachFailure: A limb cannot follow, or its command leaves the joint bounds.
        Unresolved: A swing is blocked.
        UsageError: The motion has more samples than a plan can hold.
    """
    robot = scene.robot
    paths = plan_swing_paths(scene, rounds, instants) if swings is None else swings
    frames = build_keyframes(scene, rounds, instants, forces, paths)
    travel = float(np.linalg.norm(np.diff(rounds.com, axis=0), axis=1).sum())
    steps = instants.count // 2
    nominal = travel / scene.spec.trajectory.speed / steps  # [s] one limb step
    rate = scene.spec.trajectory.rate
    min_samples = np.ceil(_compute_min_durations(scene, frames) * rate)
    count = np.maximum(
        np.rint(frames.duration_fraction * nominal * rate), min_samples
    )  # samples of each segment
    segment, fraction = split_samples(count, rate)
    states = interpolate_states(frames, segment, _ease(fraction))
    joints = compute_joint_motion(scene, states, [frames.label[s] for s in segment])
    time = np.arange(len(segment)) / rate
    motion = Trajectory(time, states.com, states.rpy, joints.command, states.contact)
    torque_use = float((np.abs(joints.torque) / robot.max_torque).max())
    if robot.gripper is None:
        return TimedMotion(motion, torque_use, frames)
    from climbplan.climb.forces.grips.plan import find_firm_limbs

    grips = GripForces.unpack(joints.contact_state[..., :PACKED])
    assert scene.grippers is not None
    firm = _apply_firm_grips(grips.grip, motion.contact, find_firm_limbs(scene.grippers, instants))
    return TimedMotion(
        replace(motion, grips=replace(grips, grip=firm), force=joints.force), torque_use, frames
    )


def split_samples(count: Array, rate: float) -> tuple[IntArray, Array]:
    """Return segments (S,) of samples, and fractions (S,) of their time, for numbers of samples.

    Args:
        count: (F-1,) samples of each segment.
        rate: Sample rate [Hz].

    Raises:
        UsageError: A plan cannot hold so many.
    """
    if count.sum() >= _MAX_SAMPLES:
        raise UsageError(
            f"the motion takes {count.sum() / rate:.3g} s, {count.sum():.3g} samples at {rate:g} "
            f"Hz; a plan holds {_MAX_SAMPLES}: raise trajectory.speed or lower trajectory.rate"
        )
    segment_ends = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    sample = np.arange(segment_ends[-1] + 1)
    segment = np.clip(np.searchsorted(segment_ends, sample, side="right") - 1, 0, len(count) - 1)
    return segment, (sample - segment_ends[segment]) / count[segment]


def _apply_firm_grips(grip: Array, contact: BoolArray, is_firm_limb: BoolArray) -> Array:
    """Raise gripping forces (S, N) to their maximum over each contact of firm limbs (N,) [N].

    Fingers that close with the small force of an unloaded hold slip off when they pull the gripper
    to it.
    """
    firm = grip.copy()
    for limb in np.flatnonzero(is_firm_limb):
        for first, after in spans_of(contact[:, limb]):
            firm[first:after, limb] = grip[first:after, limb].max()
    return firm


def _ease(fraction: Array) -> Array:
    """Ease a fraction in and out: from 0 to 1 with zero slope at both ends."""
    return fraction**2 * (3.0 - 2.0 * fraction)


@dataclass(frozen=True)
class MotionStates:
    """S states of the motion."""

    com: Array  # (S, 3)
    rpy: Array  # (S, 3)
    toes: Array  # (S, N, 3)
    force: Array  # (S, N, 3)
    carried: Array  # (S, N, 3)
    normal: Array  # (S, N, 3) under toes that press
    contact_state: Array  # (S, N, 10)
    contact: BoolArray  # (S, N)
    region: IntArray  # (S, N) that toes stand on
    weight: Array  # (S, 3) moment of the weight that the forces balance [N m]


def interpolate_states(frames: Keyframes, segment: IntArray, fraction: Array) -> MotionStates:
    """Interpolate states at fractions (S,) of segments (S,)."""

    def mix(values: Array) -> Array:
        s = fraction.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1 - s) * values[segment] + s * values[segment + 1])

    return MotionStates(
        mix(frames.com),
        mix(frames.rpy),
        mix(frames.toes),
        mix(frames.force),
        mix(frames.carried),
        mix(frames.normal),
        mix(frames.contact_state),
        frames.contact[segment],
        frames.region[segment],
        mix(frames.weight),
    )


def _compute_min_durations(scene: MotionScene, frames: Keyframes) -> Array:
    """Compute durations (F-1,) of segments by joint speeds and inertia [s]."""
    return np.maximum(
        compute_speed_durations(scene, frames, _ease),
        _compute_inertial_durations(scene.robot, frames),
    )


def compute_speed_durations(
    scene: MotionScene, frames: Keyframes, ease: Callable[[Array], Array]
) -> Array:
    """Compute durations (F-1,) of segments by joint speeds [s], for a path fraction of time."""
    robot, count = scene.robot, len(frames.duration_fraction)
    segment = np.repeat(np.arange(count), _NUM_PROBES)
    fraction = np.tile(np.linspace(0.0, 1.0, _NUM_PROBES), count)
    states = interpolate_states(frames, segment, ease(fraction))
    angles = compute_joint_motion(scene, states, [frames.label[s] for s in segment]).command
    joint_steps = np.abs(np.diff(angles.reshape(count, _NUM_PROBES, *angles.shape[1:]), axis=1))
    largest_ratio = (joint_steps * (_NUM_PROBES - 1) / robot.max_joint_speed).max(axis=(1, 2, 3))
    return np.asarray(_SPEED_MARGIN * largest_ratio + 1e-3)


def _compute_inertial_durations(robot: Robot, frames: Keyframes) -> Array:
    """Compute durations (F-1,) of segments for which contacts can bear the body's inertia [s].

    Plans are quasi-static: an acceleration a adds m a to the planned forces. It is bounded to half
    of the pressure margin of toes. On flat feet it moves the centre of pressure by a h / g, with
    body height h over the sole, which is bounded to a small part of the sole. Grippers support the
    body in all directions.
    """
    distance = np.linalg.norm(np.diff(frames.com, axis=0), axis=1)
    if robot.gripper is not None:
        return np.zeros(len(distance))
    # `_ease` has its largest second derivative, 6, at both ends
    if robot.sole is None:
        return np.asarray(np.sqrt(6.0 * distance / (MAX_ACCELERATION * robot.gravity)))
    toes = np.minimum(frames.toes[:-1], frames.toes[1:])
    height = np.maximum(frames.com[1:, 2] - toes[..., 2].min(axis=1), 0.0)
    pressure_offset = _PRESSURE_OFFSET_FRACTION * float(robot.sole.half_size.min())
    return np.asarray(np.sqrt(6.0 * distance * height / (robot.gravity * pressure_offset)))


def _balance_weight(scene: MotionScene, states: MotionStates, angles: Array) -> MotionStates:
    """Correct forces to balance the weight where it acts at angles (S, N, J).

    The missing moment is distributed to standing limbs by their pressure: as moments on soles, as
    forces of palms and fingers, or as forces on toes.
    """
    robot = scene.robot
    if robot.links is None:
        return states
    missing_moment = states.weight - weight_moment(robot, states.rpy, angles)
    if scene.grippers is not None:
        return _balance_weight_by_grips(scene.grippers, states, missing_moment)
    pressure = np.maximum((states.force * states.normal).sum(axis=-1), 0.0) * states.contact
    if robot.sole is not None:
        contact_state = states.contact_state.copy()
        load_fraction = pressure / np.maximum(pressure.sum(axis=1, keepdims=True), 1e-300)
        contact_state[..., PACKED:] += load_fraction[..., None] * missing_moment[:, None]
        return replace(states, contact_state=contact_state)
    arms = contact_points(robot, states.toes, states.normal) - states.com[:, None]
    root = np.repeat(np.sqrt(pressure), 3, axis=1)  # (S, 3 N)
    grasp = grasp_matrix(arms) * root[:, None]
    wrench = np.concatenate([np.zeros_like(missing_moment), missing_moment], axis=1)
    added_force = root * (np.linalg.pinv(grasp, rcond=_RANK_TOLERANCE) @ wrench[..., None])[..., 0]
    return replace(states, force=states.force + added_force.reshape(states.force.shape))


def _balance_weight_by_grips(
    grippers: Grippers, states: MotionStates, missing_moment: Array
) -> MotionStates:
    """Correct grips to add a missing moment (S, 3), with the corresponding wrist moments."""
    from climbplan.climb.forces.grips.moment_distribution import distribute_moment

    arm = -grippers.gripper.length * states.normal
    force, grips = distribute_moment(
        grippers,
        states.normal,
        states.region,
        states.contact,
        arms=states.toes + arm - states.com[:, None],
        force=states.force,
        grips=GripForces.unpack(states.contact_state[..., :PACKED]),
        missing_moment=missing_moment,
        in_line=_RANK_TOLERANCE,
    )
    contact_state = np.concatenate(
        [grips.packed_array, grips.moment + np.cross(arm, force)], axis=-1
    )
    return replace(states, force=force, contact_state=contact_state)


@dataclass(frozen=True)
class JointMotion:
    """Joint commands and torques at S states."""

    angles: Array  # (S, N, J) of the robot, which commands exceed
    command: Array  # (S, N, J)
    torque: Array  # (S, N, J) of motors, which hold the links' own weight too
    force: Array  # (S, N, 3) that balance the weight
    contact_state: Array  # (S, N, 10) likewise


def compute_joint_motion(scene: MotionScene, states: MotionStates, where: list[str]) -> JointMotion:
    """Compute joint commands that realise toes and forces; raise ReachFailure if impossible."""
    robot = scene.robot
    toes_body = to_body(states.com, states.rpy, states.toes)
    turns = sole_turns(robot, states.rpy, states.normal)
    solution = solve_inverse_kinematics(robot, toes_body, turns)
    for s in np.flatnonzero(~solution.valid.all(axis=1)):
        require_reachable(robot, toes_body[s], where[s], None if turns is None else turns[s])
    angles = solution.best()
    states = _balance_weight(scene, states, angles)
    jacobian = contact_jacobian(robot, states.rpy, angles, states.normal)
    torques = np.einsum("snij,sni->snj", jacobian, states.force)
    if robot.gripper is not None or robot.sole is not None:
        axes = joint_axes_body(robot, angles) @ np.swapaxes(
            rotation_world_body(states.rpy)[:, None], -1, -2
        )
        torques += (axes @ states.contact_state[..., PACKED:, None])[..., 0]
    command = angles - joint_softness(robot) * torques
    if states.carried.any():
        command -= (joint_turns(robot, jacobian) @ states.carried[..., None])[..., 0]
    excess = np.maximum(robot.joint_lower - command, command - robot.joint_upper)
    if excess.max() > BOUND_TOLERANCE:
        s, limb, joint = np.unravel_index(int(np.argmax(excess)), excess.shape)
        amount = format_joint_position(robot, int(limb), int(joint), float(excess.max()), ".2g")
        excess_text = f"{amount} past its bound"
        name = robot.joint_name(int(limb), int(joint))
        reason = f"toe with the planned force: commanded {name} {excess_text}"
        raise ReachFailure(robot.limb_names[limb], reason, 0.0, where[s])
    return JointMotion(
        angles,
        command,
        torques + link_torques(robot, states.rpy, angles),
        states.force,
        states.contact_state,
    )
