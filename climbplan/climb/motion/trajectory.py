"""The playable motion between the planned instants.

Joints are commanded beyond the angles of the moving body by what the contact forces bend them.
Forces go straight from one balanced set to the next while the body goes straight from pose to pose,
so that they balance the load all the way, and friction cones, being convex, hold them all the way.
Where limbs have masses, their weight moves on curves: what it is off the straight way between two
sets is shared by the limbs that stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray, spans_of
from climbplan.climb.clearance.swing import plan_swing_paths
from climbplan.climb.motion.keyframes import PACKED, Keyframes, build_keyframes
from climbplan.climb.plan.climb_plan import Forces, Instants, Rounds, Trajectory
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
    inverse,
    require_reachable,
    sole_turns,
    to_body,
)
from climbplan.robots.last_link import joint_axes_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body

_PROBES = 9  # samples of a segment from which its least duration is found
_SPEED_MARGIN = 1.1  # durations exceed what the sampled joint speeds need by this factor
_IN_LINE = 1e-6  # of the largest singular value: no forces about a line of toes
SPEEDING_UP = 0.03  # of gravity, by which a body on toes does at most
_ROCKING = 0.25  # of a flat foot's half width, by which inertia may move the centre of pressure
_BOUND_SLACK = 1e-7  # [rad] by which solvers may have missed a joint bound
_MOST_SAMPLES = 1_000_000  # a plan of more would take gigabytes to verify


@dataclass(frozen=True)
class Played:
    """A motion, and the largest part of its limit that a motor's torque has at any sample."""

    trajectory: Trajectory
    torque_use: float


def plan_trajectory(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: Forces,
    swings: tuple[Array, ...] | None = None,
) -> Trajectory:
    """The motion of `play`."""
    return play(scene, rounds, instants, forces, swings).trajectory


def play(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: Forces,
    swings: tuple[Array, ...] | None = None,
) -> Played:
    """Body poses and joint commands at a fixed rate, within joint bounds and speeds.

    The mean speed of the body is the spec's unless joint speeds ask for more time. Every segment
    takes a whole number of samples, so that the samples meet every instant. swings: way points of
    every limb move, looked for if not given. Raises ReachFailure
    where a limb cannot follow or its command leaves the joint bounds, NotProved where a swing is
    blocked, and UsageError for a motion of more samples than a plan holds.
    """
    robot = scene.robot
    paths = plan_swing_paths(scene, rounds, instants) if swings is None else swings
    frames = build_keyframes(scene, rounds, instants, forces, paths)
    travel = float(np.linalg.norm(np.diff(rounds.com, axis=0), axis=1).sum())
    steps = instants.count // 2
    nominal = travel / scene.spec.trajectory.speed / steps  # [s] one limb step
    rate = scene.spec.trajectory.rate
    least = np.ceil(_least_durations(scene, frames) * rate)
    count = np.maximum(
        np.rint(frames.duration_fraction * nominal * rate), least
    )  # samples of each segment
    if count.sum() >= _MOST_SAMPLES:
        raise UsageError(
            f"the motion takes {count.sum() / rate:.3g} s, {count.sum():.3g} samples at {rate:g} "
            f"Hz; a plan holds {_MOST_SAMPLES}: raise trajectory.speed or lower trajectory.rate"
        )
    ends = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)

    sample = np.arange(ends[-1] + 1)
    segment = np.clip(np.searchsorted(ends, sample, side="right") - 1, 0, len(count) - 1)
    share = (sample - ends[segment]) / count[segment]
    moving = _between(frames, segment, _ease(share))
    driven = _driven(scene, moving, [frames.label[s] for s in segment])
    contact = frames.contact[segment]
    motion = Trajectory(sample / rate, moving.com, moving.rpy, driven.command, contact)
    torque_use = float((np.abs(driven.torque) / robot.max_torque).max())
    if robot.gripper is None:
        return Played(motion, torque_use)
    from climbplan.climb.forces.grips.plan import find_firm_limbs

    grips = GripForces.unpacked(driven.contact_state[..., :PACKED])
    assert scene.grippers is not None
    firm = _gripped_firmly(grips.grip, motion.contact, find_firm_limbs(scene.grippers, instants))
    return Played(replace(motion, grips=replace(grips, grip=firm), force=driven.force), torque_use)


def _gripped_firmly(grip: Array, contact: BoolArray, may: BoolArray) -> Array:
    """(S, N) gripping force [N]: while limbs that may (N,) stand, the most that they are to grip.

    Fingers that close with no more than a hold asks for that bears nothing yet slip off it when
    they pull their gripper on to it.
    """
    out = grip.copy()
    for limb in np.flatnonzero(may):
        for first, after in spans_of(contact[:, limb]):
            out[first:after, limb] = grip[first:after, limb].max()
    return out


def _ease(share: Array) -> Array:
    """Smooth start and end: 0 and 1 with zero slope."""
    return share**2 * (3.0 - 2.0 * share)


@dataclass(frozen=True)
class _Moving:
    """S states of the motion."""

    com: Array  # (S, 3)
    rpy: Array  # (S, 3)
    toes: Array  # (S, N, 3)
    force: Array  # (S, N, 3)
    carried: Array  # (S, N, 3)
    normal: Array  # (S, N, 3) under toes that press
    held: Array  # (S, N, 10)
    contact: BoolArray  # (S, N)
    region: IntArray  # (S, N) that toes stand on
    weight: Array  # (S, 3) moment of the weight that the forces balance [N m]


def _between(frames: Keyframes, segment: IntArray, share: Array) -> _Moving:
    """States at shares (S,) of segments (S,)."""

    def mix(values: Array) -> Array:
        s = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.asarray((1 - s) * values[segment] + s * values[segment + 1])

    return _Moving(
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


def _least_durations(scene: MotionScene, frames: Keyframes) -> Array:
    """Time (F-1,) each segment needs for the joints to stay within their speeds [s]."""
    robot, count = scene.robot, len(frames.duration_fraction)
    segment = np.repeat(np.arange(count), _PROBES)
    share = np.tile(np.linspace(0.0, 1.0, _PROBES), count)
    moving = _between(frames, segment, _ease(share))
    angles = _driven(scene, moving, [frames.label[s] for s in segment]).command
    turned = np.abs(np.diff(angles.reshape(count, _PROBES, *angles.shape[1:]), axis=1))
    fastest = (turned * (_PROBES - 1) / robot.max_joint_speed).max(axis=(1, 2, 3))
    return np.maximum(_SPEED_MARGIN * fastest + 1e-3, _balanced_durations(robot, frames))


def _balanced_durations(robot: Robot, frames: Keyframes) -> Array:
    """Time (F-1,) in which the body goes each way without more inertia than contacts bear [s].

    Plans are statics: a body that speeds up by a asks toes for m a beside what is planned. That is
    to be less than half of the pressure that margins let a toe miss. On flat feet it moves the
    centre of pressure by a h / g, with h the body's height over the sole, which is to be a small
    part of the sole. Grippers hold the body from all sides.
    """
    way = np.linalg.norm(np.diff(frames.com, axis=0), axis=1)
    if robot.gripper is not None:
        return np.zeros(len(way))
    # `_ease` has its largest second derivative, 6, at both ends
    if robot.sole is None:
        return np.asarray(np.sqrt(6.0 * way / (SPEEDING_UP * robot.gravity)))
    toes = np.minimum(frames.toes[:-1], frames.toes[1:])
    height = np.maximum(frames.com[1:, 2] - toes[..., 2].min(axis=1), 0.0)
    moved = _ROCKING * float(robot.sole.half_size.min())
    return np.asarray(np.sqrt(6.0 * way * height / (robot.gravity * moved)))


def _weighed(scene: MotionScene, moving: _Moving, angles: Array) -> _Moving:
    """Forces that balance the weight where it acts at angles (S, N, J).

    The moment that is missing is brought by what stands, the more the harder it presses: by moments
    on soles, by forces of palms and fingers, or else of toes.
    """
    robot = scene.robot
    if robot.links is None:
        return moving
    off = moving.weight - weight_moment(robot, moving.rpy, angles)
    if scene.grippers is not None:
        return _weighed_by_grips(scene.grippers, moving, off)
    pressure = np.maximum((moving.force * moving.normal).sum(axis=-1), 0.0) * moving.contact
    if robot.sole is not None:
        held = moving.contact_state.copy()
        part = pressure / np.maximum(pressure.sum(axis=1, keepdims=True), 1e-300)
        held[..., PACKED:] += part[..., None] * off[:, None]
        return replace(moving, contact_state=held)
    arms = contact_points(robot, moving.toes, moving.normal) - moving.com[:, None]
    root = np.repeat(np.sqrt(pressure), 3, axis=1)  # (S, 3 N)
    grasp = grasp_matrix(arms) * root[:, None]
    wrench = np.concatenate([np.zeros_like(off), off], axis=1)
    more = root * (np.linalg.pinv(grasp, rcond=_IN_LINE) @ wrench[..., None])[..., 0]
    return replace(moving, force=moving.force + more.reshape(moving.force.shape))


def _weighed_by_grips(grippers: Grippers, moving: _Moving, off: Array) -> _Moving:
    """Grips that bring a moment off (S, 3) too, and the moments at wrists that go with them."""
    from climbplan.climb.forces.grips.moment_distribution import distribute_moment

    arm = -grippers.gripper.length * moving.normal
    force, grips = distribute_moment(
        grippers,
        moving.normal,
        moving.region,
        moving.contact,
        moving.toes + arm - moving.com[:, None],
        moving.force,
        GripForces.unpacked(moving.contact_state[..., :PACKED]),
        off,
        _IN_LINE,
    )
    held = np.concatenate([grips.packed, grips.moment + np.cross(arm, force)], axis=-1)
    return replace(moving, force=force, contact_state=held)


@dataclass(frozen=True)
class _Driven:
    """What joints do at S states."""

    command: Array  # (S, N, J)
    torque: Array  # (S, N, J) of motors, which hold the links' own weight too
    force: Array  # (S, N, 3) that balance the weight
    held: Array  # (S, N, 10) likewise


def _driven(scene: MotionScene, moving: _Moving, where: list[str]) -> _Driven:
    """Joint commands that hold toes and forces; raises ReachFailure."""
    robot = scene.robot
    toes_body = to_body(moving.com, moving.rpy, moving.toes)
    turns = sole_turns(robot, moving.rpy, moving.normal)
    solution = inverse(robot, toes_body, turns)
    for s in np.flatnonzero(~solution.valid.all(axis=1)):
        require_reachable(robot, toes_body[s], where[s], None if turns is None else turns[s])
    angles = solution.best()
    moving = _weighed(scene, moving, angles)
    jacobian = contact_jacobian(robot, moving.rpy, angles, moving.normal)
    torques = np.einsum("snij,sni->snj", jacobian, moving.force)
    if robot.gripper is not None or robot.sole is not None:
        axes = joint_axes_body(robot, angles) @ np.swapaxes(
            rotation_world_body(moving.rpy)[:, None], -1, -2
        )
        torques += (axes @ moving.contact_state[..., PACKED:, None])[..., 0]
    command = angles - joint_softness(robot) * torques
    if moving.carried.any():
        command -= (joint_turns(robot, jacobian) @ moving.carried[..., None])[..., 0]
    beyond = np.maximum(robot.joint_lower - command, command - robot.joint_upper)
    if beyond.max() > _BOUND_SLACK:
        s, limb, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        amount = format_joint_position(robot, int(limb), int(joint), float(beyond.max()), ".2g")
        over = f"{amount} past its bound"
        name = robot.joint_name(int(limb), int(joint))
        reason = f"toe with the planned force: commanded {name} {over}"
        raise ReachFailure(robot.limb_names[limb], reason, 0.0, where[s])
    return _Driven(
        command,
        torques + link_torques(robot, moving.rpy, angles),
        moving.force,
        moving.contact_state,
    )
