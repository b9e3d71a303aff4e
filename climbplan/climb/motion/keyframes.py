"""Build keyframes, between which a climb moves along straight lines: limb steps and their forces.

A step of one limb or several is: unload (the others take the load), lift along the normal, swing
clear of the terrain, lower, press (they take load again), push (the body moves on).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.swing_ways import compute_path_fractions, merge_paths
from climbplan.climb.forces.planner import compute_deflections, plan_forces
from climbplan.climb.forces.sole_margins import solve_with_sole_margins
from climbplan.climb.plan.climb_plan import InstantForces, Instants, Rounds
from climbplan.climb.plan.grips import GripForces
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import NoPlanFound, Unresolved
from climbplan.mechanics.equilibrium import weight_moment
from climbplan.mechanics.flat_contact import moment_of
from climbplan.mechanics.grip import Grippers
from climbplan.robots.kinematics import contact_points, rigid_motion, standing_inverse

# Share of a limb step's time by phase
_UNLOAD, _LIFT, _SWING, _LOWER, _PRESS, _PUSH = 0.15, 0.1, 0.25, 0.15, 0.15, 0.2
PACKED, HELD = 7, 10  # entries of packed grips, and with the moments at wrists, or on soles


@dataclass(frozen=True)
class KeyframeLoad:
    """The causes of joint deflection: forces, and toe displacement by the body's static sag."""

    force: Array  # (N, 3) [N]
    carried: Array  # (N, 3) toe displacement by the body's own deflection, zero in the air [m]
    contact_state: (
        Array  # (N, 10) grips as they are packed; moments at wrists, or on soles; else zeros
    )
    weight: Array  # (3,) moment of the weight about the body's origin, which they balance [N m]

    def interpolate(self, target: KeyframeLoad, fraction: float) -> KeyframeLoad:
        """Interpolate to another load by a fraction; equal loads return the same object."""
        if target is self:
            return self
        mixed = {n: (1 - fraction) * v + fraction * vars(target)[n] for n, v in vars(self).items()}
        return KeyframeLoad(**mixed)


@dataclass(frozen=True)
class Keyframes:
    """States between which everything moves along straight lines in the world."""

    com: Array  # (F, 3)
    rpy: Array  # (F, 3)
    toes: Array  # (F, N, 3) where the toes are, world
    force: Array  # (F, N, 3) on the toes [N]
    carried: Array  # (F, N, 3) as in Load
    normal: Array  # (F, N, 3) of the surfaces that toes stand on, or are on their way to
    contact_state: Array  # (F, N, 10) likewise
    weight: Array  # (F, 3) likewise
    contact: BoolArray  # (F-1, N) toes on their surface during each segment
    region: IntArray  # (F-1, N) of these surfaces
    duration_fraction: Array  # (F-1,) nominal part of one limb step's time
    label: tuple[str, ...]  # (F-1,) where each segment stands in the gait


def _solve_start_load(scene: MotionScene, rounds: Rounds, instants: Instants) -> KeyframeLoad:
    """Solve the forces of the start posture with all limbs in contact.

    Raises:
        Unresolved: The start posture has no admissible forces.
    """
    first = np.zeros(1, np.int64)
    start_instants = replace(instants, com=rounds.com[:1], rpy=rounds.rpy[:1])
    standing = _build_standing_instants(scene, start_instants, first, first, rounds.toes[:1])
    try:
        forces = plan_forces(scene, standing)
    except NoPlanFound as error:
        conflicts = [replace(c, where="start posture") for c in error.conflicts]
        raise Unresolved(
            "the start posture cannot hold itself",
            conflicts,
            because="toes and factors that the spec leaves out are our own",
            stage="trajectory",
        ) from error
    return _build_loads(
        scene, standing, _get_contact_forces(forces), forces.com_deflection, forces.grips
    )[0]


def _get_contact_forces(forces: InstantForces) -> Array:
    """Return forces (K, N, 3), or those at the corners of flat feet (K, N, 4, 3)."""
    return forces.force if forces.corner_force is None else forces.corner_force


def _solve_ready_load(scene: MotionScene, rounds: Rounds, instants: Instants) -> KeyframeLoad:
    """Solve the forces of all limbs where the body waits for the first lift."""
    first = np.zeros(1, np.int64)
    standing = _build_standing_instants(scene, instants, first, first, rounds.toes[:1])
    forces = plan_forces(scene, standing)
    return _build_loads(
        scene, standing, _get_contact_forces(forces), forces.com_deflection, forces.grips
    )[0]


def _solve_placing_loads(
    scene: MotionScene, instants: Instants, lifted: list[KeyframeLoad]
) -> list[KeyframeLoad]:
    """Solve the forces of all limbs before each push, with the body at the place of the lift.

    Without a solution those of the lift stay, with the placed limb unloaded.
    """
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    standing = _build_standing_instants(scene, instants, lift, push, instants.toes[push])
    return _solve_loads(scene, standing, lifted[::2])


def _solve_arriving_loads(
    scene: MotionScene, instants: Instants, lifted: list[KeyframeLoad]
) -> list[KeyframeLoad]:
    """Solve the forces at the end of each lift, with lifted limbs unloaded at their new places.

    They differ from those at its start by the weight of the moved limbs, and stay without a
    solution.
    """
    if scene.robot.links is None:
        return lifted[::2]
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    toes = np.where(instants.lifted[lift][..., None], instants.toes[push], instants.toes[lift])
    arriving = _build_standing_instants(scene, instants, lift, push, toes)
    arriving = replace(
        arriving, lifted=instants.lifted[lift], contact=instants.contact[lift], toes=toes
    )
    return _solve_loads(scene, arriving, lifted[::2])


def _solve_loads(
    scene: MotionScene, instants: Instants, otherwise: list[KeyframeLoad]
) -> list[KeyframeLoad]:
    """Solve the loads at instants; those without a solution are taken from `otherwise`."""
    if scene.grippers is not None:
        return _solve_grip_loads(scene, instants, scene.grippers, otherwise)
    statement, solution = solve_with_sole_margins(scene, instants, scene.spec.solver.force_solver)
    solved = solution.solved
    com = compute_deflections(
        statement, solved.force, scene.spec.force.deflection_compensation == "compensated"
    ).com
    force = solved.force
    if statement.points > 1:
        force = force.reshape(*instants.contact.shape, statement.points, 3)
    loads = _build_loads(scene, instants, force, com)
    for place in np.concatenate([solved.missing, solved.unbalanced]):
        loads[place] = otherwise[int(place)]
    return loads


def _solve_grip_loads(
    scene: MotionScene, instants: Instants, grippers: Grippers, otherwise: list[KeyframeLoad]
) -> list[KeyframeLoad]:
    """Solve the loads of a robot with grippers; as `_solve_loads`."""
    from climbplan.climb.forces.grips.planner import assemble_grip_answers
    from climbplan.climb.forces.grips.solving import solve_grips
    from climbplan.climb.forces.grips.statement import build_grip_statement

    statement = build_grip_statement(scene, instants, grippers)
    solved = solve_grips(statement, scene.spec.solver.force_solver, scene.spec.force.facets)
    answers = assemble_grip_answers(statement, solved)
    no_deflection = np.zeros((instants.count, 6))
    loads = _build_loads(scene, instants, answers.force, no_deflection, answers.grips)
    for place in solved.missing:
        loads[place] = otherwise[int(place)]
    return loads


def _build_standing_instants(
    scene: MotionScene, instants: Instants, pose: IntArray, ground: IntArray, toes: Array
) -> Instants:
    """Build instants with all limbs in contact: poses of instants `pose`, surfaces of `ground`."""
    angles = standing_inverse(
        scene.robot, instants.com[pose], instants.rpy[pose], toes, instants.normal[ground]
    ).best()
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


def _build_loads(
    scene: MotionScene,
    instants: Instants,
    force: Array,
    com_deflection: Array,
    grips: GripForces | None = None,
) -> list[KeyframeLoad]:
    """Build the load of each instant; force: (K, N, 3), or (K, N, 4, 3) at corners of flat feet."""
    contact_state = np.zeros((*instants.contact.shape, HELD))
    if scene.robot.sole is not None:
        contact_state[..., PACKED:] = moment_of(scene.robot.sole, instants.normal, force)
        force = force.sum(axis=-2)
    if grips is not None and scene.robot.gripper is not None:
        arm = -scene.robot.gripper.length * instants.normal
        contact_state = np.concatenate(
            [grips.packed_array, grips.moment + np.cross(arm, force)], axis=-1
        )
    touching = contact_points(scene.robot, instants.toes, instants.normal)
    motion = rigid_motion(touching - instants.com[:, None]) * instants.contact[..., None, None]
    carried = np.einsum("kniv,kv->kni", motion, com_deflection)
    weight = weight_moment(scene.robot, instants.rpy, instants.joint_angles)
    return [
        KeyframeLoad(*values) for values in zip(force, carried, contact_state, weight, strict=True)
    ]


def build_keyframes(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: InstantForces,
    paths: tuple[Array, ...],
) -> Keyframes:
    """Build the keyframes of a motion; `paths` are the way points of each limb's swings."""
    loads = _build_loads(
        scene, instants, _get_contact_forces(forces), forces.com_deflection, forces.grips
    )
    arrival_loads = _solve_arriving_loads(scene, instants, loads)
    placing_loads = _solve_placing_loads(scene, instants, loads)
    start_load = _solve_start_load(scene, rounds, instants)
    start = _Frame(rounds.com[0], rounds.rpy[0], rounds.toes[0], instants.normal[0], start_load)
    sequence = _FrameSequence(instants, [start])
    if (instants.com[0] != rounds.com[0]).any():  # over the limbs that stay at the first lift
        sequence.add(
            start.toes,
            start.normal,
            _solve_ready_load(scene, rounds, instants),
            contact=np.ones(scene.robot.limb_count, bool),
            fraction=_PUSH,
            label="first shift",
            surface_instant=0,
            pose_instant=0,
        )
    remaining_paths = iter(paths)
    for k in range(0, instants.count, 2):
        path = merge_paths([next(remaining_paths) for _ in np.flatnonzero(instants.lifted[k])])
        step_loads = _StepLoads(
            loads[k], arrival_loads[k // 2], placing_loads[k // 2], loads[k + 1]
        )
        _add_limb_step(sequence, scene, k, path, step_loads)
    return sequence.build_keyframes()


class _Frame(NamedTuple):
    """The state at the end of a segment."""

    com: Array  # (3,)
    rpy: Array  # (3,)
    toes: Array  # (N, 3)
    normal: Array  # (N, 3)
    load: KeyframeLoad


class _Segment(NamedTuple):
    """What holds between two frames."""

    contact: BoolArray  # (N,) toes on their surface
    region: IntArray  # (N,) of these surfaces
    duration_fraction: float  # nominal part of one limb step's time
    label: str


class _StepLoads(NamedTuple):
    """The loads of one limb step."""

    lift: KeyframeLoad  # of the limbs that stay in contact
    arrival: KeyframeLoad  # the same at the end of the swing
    placing: KeyframeLoad  # of all limbs, before the body moves on
    push: KeyframeLoad  # of all limbs, after it moved on


@dataclass
class _FrameSequence:
    """Frames in the order of motion, and the segments that lead from each to the next."""

    instants: Instants
    frames: list[_Frame]
    segments: list[_Segment] = field(default_factory=list)

    def add(
        self,
        toes: Array,
        normal: Array,
        load: KeyframeLoad,
        *,
        contact: BoolArray,
        fraction: float,
        label: str,
        surface_instant: int,
        pose_instant: int | None = None,
    ) -> None:
        """Add a frame and the segment to it.

        Args:
            toes: (N, 3) toes at the frame.
            normal: (N, 3) normals of their surfaces.
            load: The load at the frame.
            contact: (N,) toes on their surface during the segment.
            fraction: Nominal part of one limb step's time.
            label: Place of the segment in the gait.
            surface_instant: Instant whose surfaces the toes are on.
            pose_instant: Instant whose body pose the frame has; None keeps the last frame's.
        """
        instants, last = self.instants, self.frames[-1]
        pose = last.com, last.rpy
        if pose_instant is not None:
            pose = instants.com[pose_instant], instants.rpy[pose_instant]
        self.frames.append(_Frame(*pose, toes, normal, load))
        region = instants.region[surface_instant]
        self.segments.append(_Segment(contact, region, fraction, label))

    def build_keyframes(self) -> Keyframes:
        """Stack all frames and segments."""
        com, rpy, toes, normal, loads = zip(*self.frames, strict=True)
        contact, region, fractions, labels = zip(*self.segments, strict=True)
        return Keyframes(
            np.array(com),
            np.array(rpy),
            np.array(toes),
            np.array([load.force for load in loads]),
            np.array([load.carried for load in loads]),
            np.array(normal),
            np.array([load.contact_state for load in loads]),
            np.array([load.weight for load in loads]),
            np.array(contact),
            np.array(region),
            np.array(fractions),
            labels,
        )


def _add_limb_step(
    sequence: _FrameSequence, scene: MotionScene, k: int, path: Array, loads: _StepLoads
) -> None:
    """Add the frames of the limb step that instant k begins: unload to push.

    path: (P, limbs, 3) way points of the limbs that are lifted.
    """
    instants, names = sequence.instants, scene.robot.limb_names
    is_lifted, everyone = instants.lifted[k], np.ones(len(names), bool)
    old, new = sequence.frames[-1].toes, instants.toes[k + 1]
    old_normal, new_normal = instants.normal[k], instants.normal[k + 1]

    def move_toes(points: Array) -> Array:
        toes = old.copy()
        toes[is_lifted] = points
        return toes

    add = partial(sequence.add, label=instants.label(k, names), surface_instant=k)
    add(old, old_normal, loads.lift, contact=everyone, fraction=_UNLOAD)
    add = partial(add, contact=~is_lifted)
    normals = _interpolate_normals(scene, old_normal, new_normal, len(path))
    add(move_toes(path[0]), normals[0], loads.lift, fraction=_LIFT)
    swing_fractions = compute_path_fractions(len(path)).tolist()
    for i in range(1, len(path)):
        load = loads.lift.interpolate(loads.arrival, swing_fractions[i])
        add(move_toes(path[i]), normals[i], load, fraction=_SWING / (len(path) - 1))
    add(new, new_normal, loads.arrival, fraction=_LOWER)
    add = partial(sequence.add, new, new_normal, contact=everyone, surface_instant=k + 1)
    add(loads.placing, fraction=_PRESS, label=instants.label(k, names))
    add(loads.push, fraction=_PUSH, label=instants.label(k + 1, names), pose_instant=k + 1)


def _interpolate_normals(scene: MotionScene, was: Array, under: Array, count: int) -> Array:
    """Interpolate normals (P, N, 3) by way point, with which soles rotate during a swing."""
    if scene.robot.sole is None:
        return np.broadcast_to(under, (count, *under.shape))
    return was + compute_path_fractions(count)[:, None, None] * (under - was)
