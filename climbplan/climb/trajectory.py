"""The playable motion between the planned instants.

A step of one limb or several is: unload (the others take the load), lift along the normal, swing
clear of the terrain, lower, press (they take load again), push (the body moves on). Joints are
commanded beyond the angles of the moving body by what the contact forces bend them. Forces go
straight from one
balanced set to the next while the body goes straight from pose to pose, so that they balance the
load all the way, and friction cones, being convex, hold them all the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import state_forces
from climbplan.climb.grips.planner import answers_of
from climbplan.climb.grips.solving import solve_grips
from climbplan.climb.grips.statement import state_grips
from climbplan.climb.scene import MotionScene
from climbplan.climb.swing import swing_paths, together
from climbplan.errors import Infeasible, ReachFailure, UsageError
from climbplan.mechanics.grip import Grippers
from climbplan.mechanics.stiffness import (
    deflections_for_forces,
    joint_softness,
    joint_turns,
    rigid_motion,
)
from climbplan.plans.climb_plan import Forces, Index, Instants, Mask, Rounds, Trajectory
from climbplan.plans.grip_plan import GripForces
from climbplan.robots.kinematics import (
    inverse,
    jacobian_world,
    require_reachable,
    to_body,
)
from climbplan.robots.last_link import joint_axes_body
from climbplan.robots.model import Robot
from climbplan.robots.rotations import Array, rotation_world_body

# Share of a limb step's time by phase
_UNLOAD, _LIFT, _SWING, _LOWER, _PRESS, _PUSH = 0.15, 0.1, 0.25, 0.15, 0.15, 0.2
_PROBES = 9  # samples of a segment from which its least duration is found
_SPEED_MARGIN = 1.1  # durations exceed what the sampled joint speeds need by this factor
_BOUND_SLACK = 1e-7  # [rad] by which solvers may have missed a joint bound
_PACKED, _HELD = 7, 10  # entries of packed grips, and with the moments at the wrists
_MOST_SAMPLES = 1_000_000  # a plan of more would take gigabytes to verify


@dataclass(frozen=True)
class _Load:
    """What commands add to the joint angles: forces, and toes carried along by a body that sags."""

    force: Array  # (N, 3) [N]
    carried: Array  # (N, 3) toe displacement by the body's own deflection, zero in the air [m]
    held: Array  # (N, 10) grips as they are packed, and their moments at the wrists; else zeros


@dataclass(frozen=True)
class _Keyframes:
    """States between which everything moves along straight lines in the world."""

    com: Array  # (F, 3)
    rpy: Array  # (F, 3)
    toes: Array  # (F, N, 3) where the toes are, world
    force: Array  # (F, N, 3) on the toes [N]
    carried: Array  # (F, N, 3) as in _Load
    held: Array  # (F, N, 10) likewise
    contact: Mask  # (F-1, N) toes on their surface during each segment
    share: Array  # (F-1,) nominal part of one limb step's time
    label: tuple[str, ...]  # (F-1,) where each segment stands in the gait


def _start_load(scene: MotionScene, rounds: Rounds, instants: Instants) -> _Load:
    """Forces of the start posture with all limbs on the surface.

    Raises Infeasible if the start posture cannot hold itself.
    """
    first = np.zeros(1, np.int64)
    standing = _all_standing(scene, instants, first, first, rounds.toes[:1])
    try:
        forces = plan_forces(scene, standing)
    except Infeasible as error:
        conflicts = [replace(c, where="start posture") for c in error.conflicts]
        raise Infeasible("the start posture cannot hold itself", conflicts) from error
    return _loads(scene, standing, forces.force, forces.com_deflection, forces.grips)[0]


def _placing_loads(scene: MotionScene, instants: Instants, lifted: list[_Load]) -> list[_Load]:
    """Forces of all limbs before each push, when the body is where the limb was lifted.

    Those of the lift would do, with the placed limb idle; they stay where nothing better is found.
    """
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    standing = _all_standing(scene, instants, lift, push, instants.toes[push])
    if scene.grippers is not None:
        return _placing_grips(scene, standing, scene.grippers, lifted)
    statement = state_forces(scene, standing)
    solved = solve_forces(statement, scene.spec.solver.force, scene.spec.force.facets)
    com = deflections_for_forces(
        statement.compliance,
        statement.arms,
        solved.force,
        standing.contact,
        scene.spec.force.sag == "compensated",
    ).com
    loads = _loads(scene, standing, solved.force, com)
    for place in np.concatenate([solved.missing, solved.unbalanced]):
        loads[place] = lifted[2 * int(place)]
    return loads


def _placing_grips(
    scene: MotionScene, standing: Instants, grippers: Grippers, lifted: list[_Load]
) -> list[_Load]:
    """The same for a robot with grippers."""
    statement = state_grips(scene, standing, grippers)
    solved = solve_grips(statement, scene.spec.solver.force, scene.spec.force.facets)
    found = answers_of(statement, solved)
    still = np.zeros((standing.count, 6))
    loads = _loads(scene, standing, found.force, still, found.grips)
    for place in solved.missing:
        loads[place] = lifted[2 * int(place)]
    return loads


def _all_standing(
    scene: MotionScene, instants: Instants, pose: Index, ground: Index, toes: Array
) -> Instants:
    """Instants with all limbs in contact: body poses of some, surfaces under the toes of others."""
    angles = inverse(scene.robot, to_body(instants.com[pose], instants.rpy[pose], toes)).best()
    rows = {name: value[pose] for name, value in vars(instants).items()}
    surface = {name: value[ground] for name, value in vars(instants).items()}
    return Instants(
        **rows
        | {name: surface[name] for name in ("normal", "mu", "region")}
        | {
            "lifted": np.zeros_like(rows["lifted"]),
            "contact": np.ones_like(rows["contact"]),
            "toes": toes,
            "joint_angles": angles,
        }
    )


def _loads(
    scene: MotionScene,
    instants: Instants,
    force: Array,
    com_deflection: Array,
    grips: GripForces | None = None,
) -> list[_Load]:
    held = np.zeros((*force.shape[:-1], _HELD))
    if grips is not None and scene.robot.gripper is not None:
        arm = -scene.robot.gripper.length * instants.normal
        held = np.concatenate([grips.packed, grips.moment + np.cross(arm, force)], axis=-1)
    motion = rigid_motion(instants.toes - instants.com[:, None]) * instants.contact[..., None, None]
    carried = np.einsum("kniv,kv->kni", motion, com_deflection)
    return [_Load(f, c, h) for f, c, h in zip(force, carried, held, strict=True)]


def plan_trajectory(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: Forces,
    swings: tuple[Array, ...] | None = None,
) -> Trajectory:
    """Body poses and joint commands at a fixed rate, within joint bounds and speeds.

    The mean speed of the body is the spec's unless joint speeds ask for more time. Every segment
    takes a whole number of samples, so that the samples meet every instant. swings: way points of
    every limb move, looked for if not given. Raises ReachFailure
    where a limb cannot follow or its command leaves the joint bounds, Infeasible where a swing is
    blocked, and UsageError for a motion of more samples than a plan holds.
    """
    robot = scene.robot
    paths = swing_paths(scene, rounds, instants) if swings is None else swings
    frames = _keyframes(scene, rounds, instants, forces, paths)
    travel = float(np.linalg.norm(np.diff(rounds.com, axis=0), axis=1).sum())
    steps = instants.count // 2
    nominal = travel / scene.spec.trajectory.speed / steps  # [s] one limb step
    rate = scene.spec.trajectory.rate
    least = np.ceil(_least_durations(robot, frames) * rate)
    count = np.maximum(np.rint(frames.share * nominal * rate), least)  # samples of each segment
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
    command = _joint_commands(robot, moving, [frames.label[s] for s in segment])
    motion = Trajectory(sample / rate, moving.com, moving.rpy, command, frames.contact[segment])
    if robot.gripper is None:
        return motion
    grips = GripForces.unpacked(moving.held[..., :_PACKED])
    return replace(motion, grips=grips, force=moving.force)


def _keyframes(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: Forces,
    paths: tuple[Array, ...],
) -> _Keyframes:
    names = scene.robot.limb_names
    held = _loads(scene, instants, forces.force, forces.com_deflection, forces.grips)
    placed = _placing_loads(scene, instants, held)
    com, rpy, toes = [rounds.com[0]], [rounds.rpy[0]], [rounds.toes[0]]
    load = [_start_load(scene, rounds, instants)]
    contact: list[Mask] = []
    share: list[float] = []
    label: list[str] = []
    ways_left = iter(paths)

    def to(where: Array, pressing: _Load, touching: Mask, part: float, name: str) -> None:
        com.append(com[-1])
        rpy.append(rpy[-1])
        toes.append(where)
        load.append(pressing)
        contact.append(touching)
        share.append(part)
        label.append(name)

    for k in range(0, instants.count, 2):
        limbs = np.flatnonzero(instants.lifted[k])
        name = instants.label(k, names)
        everyone = np.ones(len(names), bool)
        others = ~instants.lifted[k]
        old, new = toes[-1], instants.toes[k + 1]
        ways = together([next(ways_left) for _ in limbs])  # (P, limbs, 3)

        def swung(points: Array, standing: Array = old, limbs: Index = limbs) -> Array:
            out = standing.copy()
            out[limbs] = points
            return out

        to(old, held[k], everyone, _UNLOAD, name)
        to(swung(ways[0]), held[k], others, _LIFT, name)
        for points in ways[1:]:
            to(swung(points), held[k], others, _SWING / (len(ways) - 1), name)
        to(new, held[k], others, _LOWER, name)
        to(new, placed[k // 2], everyone, _PRESS, name)
        to(new, held[k + 1], everyone, _PUSH, instants.label(k + 1, names))
        com[-1], rpy[-1] = instants.com[k + 1], instants.rpy[k + 1]
    return _Keyframes(
        np.array(com),
        np.array(rpy),
        np.array(toes),
        np.array([one.force for one in load]),
        np.array([one.carried for one in load]),
        np.array([one.held for one in load]),
        np.array(contact),
        np.array(share),
        tuple(label),
    )


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
    held: Array  # (S, N, 10)


def _between(frames: _Keyframes, segment: Index, share: Array) -> _Moving:
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
        mix(frames.held),
    )


def _least_durations(robot: Robot, frames: _Keyframes) -> Array:
    """Time (F-1,) each segment needs for the joints to stay within their speeds [s]."""
    count = len(frames.share)
    segment = np.repeat(np.arange(count), _PROBES)
    share = np.tile(np.linspace(0.0, 1.0, _PROBES), count)
    moving = _between(frames, segment, _ease(share))
    angles = _joint_commands(robot, moving, [frames.label[s] for s in segment])
    turned = np.abs(np.diff(angles.reshape(count, _PROBES, *angles.shape[1:]), axis=1))
    fastest = (turned * (_PROBES - 1) / robot.max_joint_speed).max(axis=(1, 2, 3))
    return _SPEED_MARGIN * fastest + 1e-3


def _joint_commands(robot: Robot, moving: _Moving, where: list[str]) -> Array:
    """Joint commands (S, N, J) that hold toes and forces; raises ReachFailure."""
    toes_body = to_body(moving.com, moving.rpy, moving.toes)
    solution = inverse(robot, toes_body)
    for s in np.flatnonzero(~solution.valid.all(axis=1)):
        require_reachable(robot, toes_body[s], where[s])
    angles = solution.best()
    jacobian = jacobian_world(robot, moving.rpy, angles)
    torques = np.einsum("snij,sni->snj", jacobian, moving.force)
    if robot.gripper is not None:
        axes = joint_axes_body(robot, angles) @ np.swapaxes(
            rotation_world_body(moving.rpy)[:, None], -1, -2
        )
        torques += (axes @ moving.held[..., _PACKED:, None])[..., 0]
    command = angles - joint_softness(robot) * torques
    if moving.carried.any():
        command -= (joint_turns(robot, jacobian) @ moving.carried[..., None])[..., 0]
    beyond = np.maximum(robot.joint_lower - command, command - robot.joint_upper)
    if beyond.max() > _BOUND_SLACK:
        s, limb, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        over = f"{np.rad2deg(beyond.max()):.2g} deg past its bound"
        name = robot.joint_name(int(limb), int(joint))
        reason = f"toe with the planned force: commanded {name} {over}"
        raise ReachFailure(robot.limb_names[limb], reason, 0.0, where[s])
    return command
