"""The numbers of one transition for the program of its motion: parameters, start, bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climbplan.climb.plan.climb_plan import Array, Mask
from climbplan.climb.scene import load_wrench
from climbplan.climb.transition.footholds import GOAL, START
from climbplan.climb.transition.motion_statement import MotionProgram
from climbplan.climb.transition.pose_ways import Sequence, stance_of_move
from climbplan.climb.transition.scene import TransitionScene
from climbplan.climb.transition.search import toe_step_limits
from climbplan.climb.transition.stances import Laboratory, stance_forces
from climbplan.mechanics.stiffness import joint_softness
from climbplan.robots.kinematics import inverse, to_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.surfaces import Region

_JOINT_ROOM = 2e-3  # [rad] off joint bounds, so that motions between instants have room
_STRETCH_ROOM = 1e-4  # off full stretch, of the cosine of the knee's angle
_MARGIN = 1e-3  # of friction and torque, taken by the pyramids of the force planner
_EDGE_ROOM = 5e-3  # [m] off the edges of surfaces


@dataclass(frozen=True)
class MotionNumbers:
    """One run's data."""

    parameters: Array
    start: Array
    lower: Array
    upper: Array
    row_lower: Array
    row_upper: Array


def toes_of(lab: Laboratory, sequence: Sequence) -> Array:
    """(M + 1, N, 3) as the search has them."""
    limb = np.arange(lab.scene.robot.limb_count)
    return lab.footholds.toe[limb, np.array(sequence.states)]


def open_footholds(sequence: Sequence) -> Mask:
    """(M + 1, N) toes on footholds between, whose place is open."""
    states = np.array(sequence.states)
    return (states != START) & (states != GOAL)


def motion_numbers(
    lab: Laboratory, program: MotionProgram, sequence: Sequence, safety_torque: float
) -> MotionNumbers:
    """Numbers of a sequence; safety_torque: least S_tau."""
    scene, robot = lab.scene, lab.scene.robot
    m = program.shape.rounds
    poses = np.array(sequence.poses)
    com, rpy = lab.poses.com[poses], lab.poses.rpy[poses]
    toes, open_toes = toes_of(lab, sequence), open_footholds(sequence)
    stances = np.array(
        [stance_of_move(a, b) for a, b in zip(sequence.states, sequence.states[1:], strict=False)]
    )
    found = stance_forces(lab, stances, poses[:-1])
    moved = sequence.moved
    limit = scene.spec.posture.rotation_limit_deg
    box = np.stack([scene.start.com, scene.goal.com])
    span = scene.spec.posture.steps.com_max
    pose_lower = np.concatenate([box.min(axis=0) - span, np.full(3, -np.deg2rad(limit))])
    pose_upper = np.concatenate([box.max(axis=0) + span, np.full(3, np.deg2rad(limit))])

    parameters = [_common(scene, toes[0])]
    start, lower, upper, row_lower, row_upper = [], [], [], [], []
    for j in range(m):
        pose = np.concatenate([com[j], rpy[j]])
        force = found.force[j] / robot.weight
        held = ~moved[j]
        s = float(found.use[j]) if np.isfinite(found.use[j]) else 1 / safety_torque
        start.append(np.concatenate([pose, toes[j + 1].ravel(), force.ravel(), [s]]))
        loose = np.repeat(open_toes[j + 1], 3)
        room = np.where(loose, np.inf, 0.0)
        most = np.repeat(np.where(held, 10.0, 0.0), 3)
        fixed = j == 0
        lower.append(
            np.concatenate(
                [pose if fixed else pose_lower, toes[j + 1].ravel() - room, -most, [0.0]]
            )
        )
        largest = (1 - _MARGIN) / safety_torque
        upper.append(
            np.concatenate(
                [pose if fixed else pose_upper, toes[j + 1].ravel() + room, most, [largest]]
            )
        )
        parameters.append(_round_numbers(lab, program, sequence, j))
        bounds = _row_bounds(scene, program, moved[j], open_toes[j : j + 2], j, m)
        row_lower.append(bounds[0])
        row_upper.append(bounds[1])
    return MotionNumbers(
        np.concatenate(parameters),
        np.concatenate(start),
        np.concatenate(lower),
        np.concatenate(upper),
        np.concatenate(row_lower),
        np.concatenate(row_upper),
    )


def _common(scene: TransitionScene, first_toe: Array) -> Array:
    robot, weights = scene.robot, scene.spec.posture.weights
    middle = (robot.joint_lower[:, 0] + robot.joint_upper[:, 0]) / 2
    return np.concatenate(
        [
            first_toe.ravel(),
            scene.goal.com,
            scene.goal.rpy,
            robot.shoulder_body.ravel(),
            robot.link_lengths.ravel(),
            robot.mount_yaw,
            middle,
            (robot.max_torque / robot.weight).ravel(),
            (joint_softness(robot) * robot.weight).ravel(),
            robot.body_hull.ravel(),
            [scene.spec.trajectory.lift, scene.spec.search.least_load],
            [scene.spec.force.least_depth or 0.0],
            [weights.com, weights.rotation, weights.toe, weights.effort],
        ]
    )


def _round_numbers(lab: Laboratory, program: MotionProgram, sequence: Sequence, j: int) -> Array:
    """The numbers of round j + 1, in the order of `per_round_numbers`."""
    scene, robot, holds = lab.scene, lab.scene.robot, lab.footholds
    shape = program.shape
    limb = np.arange(shape.limbs)
    old, new = np.array(sequence.states[j]), np.array(sequence.states[j + 1])
    pose = sequence.poses[j]
    com, rpy = lab.poses.com[pose], lab.poses.rpy[pose]
    mu = holds.mu[limb, old] / scene.spec.force.safety_friction * (1 - _MARGIN)
    mu = np.where(old == new, mu, 0.0)

    lift = scene.spec.trajectory.lift
    points = [holds.toe[limb, old], holds.toe[limb, new]]
    points += [p + lift * holds.normal[limb, s] for p, s in zip(points, (old, new), strict=True)]
    branch = np.stack([_branch(scene, com, rpy, p) for p in points], axis=1)  # (N, 4)

    rows = np.zeros((shape.limbs, shape.edges, 3))
    ends = np.ones((shape.limbs, shape.edges))
    plane = np.empty(shape.limbs)
    for i in limb:
        surface = scene.terrain.surfaces[holds.region[i, new[i]]]
        if not isinstance(surface, Region):
            raise TypeError("transitions stand on flat surfaces")
        rows[i, : len(surface.b)], ends[i, : len(surface.b)] = surface.A, surface.b
        plane[i] = surface.offset

    hull = com + robot.body_hull @ rotation_world_body(rpy).T
    faces, offsets = np.empty((shape.solids, 3)), np.empty(shape.solids)
    for s, solid in enumerate(scene.terrain.solids):
        best = int((hull @ solid.A.T - solid.b).min(axis=0).argmax())
        faces[s], offsets[s] = solid.A[best], solid.b[best]
    load = load_wrench(scene.spec, robot, rpy) / robot.weight
    return np.concatenate(
        [
            holds.normal[limb, old].ravel(),
            holds.normal[limb, new].ravel(),
            mu,
            branch.ravel(),
            rows.ravel(),
            ends.ravel(),
            plane,
            faces.ravel(),
            offsets,
            load,
        ]
    )


def _branch(scene: TransitionScene, com: Array, rpy: Array, toes: Array) -> Array:
    """(N,) knee branch in use: -1 up, 1 down."""
    solution = inverse(scene.robot, to_body(com, rpy, toes))
    up, down = solution.within_bounds[0], solution.within_bounds[1]
    return np.where(~up & down, 1.0, -1.0)


def _row_bounds(
    scene: TransitionScene,
    program: MotionProgram,
    moved: Mask,
    open_toes: Mask,
    j: int,
    rounds: int,
) -> tuple[Array, Array]:
    """Bounds of one round's rows; rows of what is fixed are free, the search has checked them."""
    robot, spec, shape = scene.robot, scene.spec, program.shape
    n = shape.limbs
    held = ~moved
    pose_open = j > 0
    was_open, is_open = open_toes
    # Which of the toes old, new, hovering over old, hovering over new are to be checked
    check = np.empty((n, 4), bool)
    check[:, 0] = pose_open | was_open
    check[:, 2] = moved & (pose_open | was_open)
    check[:, [1, 3]] = (moved & (pose_open | is_open))[:, None]

    def where(mask: Mask, value: Array | float, size: int = 1) -> Array:
        """`value` on rows of the mask, infinite elsewhere."""
        wide = np.repeat(np.asarray(mask).ravel(), size)
        return np.where(wide, np.broadcast_to(np.asarray(value, float), wide.shape), np.inf)

    low = np.repeat(robot.joint_lower[:, None] + _JOINT_ROOM, 4, axis=1).ravel()
    high = np.repeat(robot.joint_upper[:, None] - _JOINT_ROOM, 4, axis=1).ravel()
    steps = spec.posture.steps
    turn = np.deg2rad(steps.rotation_max_deg)
    either = np.array([pose_open or j + 1 < rounds])
    stays = held & is_open
    clearance = spec.posture.body_clearance
    bounds: dict[str, tuple[Array, Array]] = {
        "transition.reach": (
            -where(check, 1 - _STRETCH_ROOM),
            where(check, 1 - _STRETCH_ROOM),
        ),
        "transition.joints": (-where(check, -low, 3), where(check, high, 3)),
        "force.friction": (np.full(n, -np.inf), where(held, 0.0)),
        "force.contact": (np.full(n, -np.inf), where(held, 0.0)),
        "force.torque": (np.full(6 * n, -np.inf), where(held, 0.0, 6)),
        "force.inward": (
            np.full(n, -np.inf),
            where(held & (spec.force.least_depth is not None), 0.0),
        ),
        "force.command": (
            -where(held, -(robot.joint_lower + _JOINT_ROOM).ravel(), 3),
            where(held, (robot.joint_upper - _JOINT_ROOM).ravel(), 3),
        ),
        "foothold.inside": (
            np.full(n * shape.edges, -np.inf),
            where(moved & is_open, -_EDGE_ROOM, shape.edges),
        ),
        "steps.toe": (
            np.full(n, -np.inf),
            where(moved & (was_open | is_open), (toe_step_limits(scene) - 1e-6) ** 2),
        ),
        "foothold.stays": (-where(stays, 0.0, 3), where(stays, 0.0, 3)),
        "foothold.plane": (-where(moved & is_open, 0.0), where(moved & is_open, 0.0)),
        "force.equilibrium": (np.zeros(6), np.zeros(6)),
        "steps.com": (np.full(1, -np.inf), where(either, (steps.com_max - 1e-6) ** 2)),
        "steps.rotation": (-where(either, turn, 3), where(either, turn, 3)),
        "body.clearance": (
            -where(np.array([pose_open]), -clearance - 1e-6, 8 * shape.solids),
            np.full(8 * shape.solids, np.inf),
        ),
    }
    lower = np.concatenate([bounds[name][0] for name, _ in program.blocks])
    upper = np.concatenate([bounds[name][1] for name, _ in program.blocks])
    return lower, upper
