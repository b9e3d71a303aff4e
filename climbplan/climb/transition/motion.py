"""Poses and footholds of a transition with its sequence fixed, by IPOPT from the search's way."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.transition.motion_numbers import (
    JOINT_ROOM,
    MARGIN,
    links_beside,
    motion_numbers,
    open_footholds,
    shape_of,
    toes_of,
)
from climbplan.climb.transition.motion_statement import motion_program
from climbplan.climb.transition.pose_ways import Sequence
from climbplan.climb.transition.stances import Laboratory
from climbplan.program.trajectory import Trajectory

ACCEPTED = 1e-5  # largest violation of a row; the force planner and the verification are stricter


@dataclass(frozen=True)
class Motion:
    """What IPOPT found for one sequence; not yet checked by forces and verification."""

    rounds: Rounds
    first: Array  # (3,) where the body waits at the first lift [m]
    violation: float  # of the worst row, by our own evaluation
    block: str  # of that row
    iterations: int
    seconds: float
    word: str  # IPOPT's return status
    safety_torque: float  # S_tau up to which the program has this motion whatever is asked

    @property
    def accepted(self) -> bool:
        """Whether every row holds."""
        return self.violation <= ACCEPTED


def plan_motion(
    lab: Laboratory,
    sequence: Sequence,
    safety_torque: float | None = None,
    share: float = 0.0,
    parted: bool = False,
    met: Rounds | None = None,
    joint_room: float = JOINT_ROOM,
) -> Motion:
    """The motion of least cost near the search's way.

    safety_torque: S_tau asked for instead of the spec's; share: of its margins that forces keep.
    parted: with rows that keep limbs off the terrain, the body and one another; met: a motion
    without these in which they came too close. joint_room: off joint bounds [rad].
    """
    scene = lab.scene
    begin = time.perf_counter()
    rounds = len(sequence.states) - 1
    beside = links_beside(lab, sequence, met) if parted else ()
    program = motion_program(shape_of(scene, rounds, parted, beside))
    stated = program.stated
    least = scene.spec.force.safety_torque if safety_torque is None else safety_torque
    numbers = motion_numbers(lab, stated, sequence, least, share, parted, beside, joint_room)
    bounds, p = numbers.bounds, stated.theta(numbers.parameters)
    until = time.monotonic() + scene.spec.solver.time_limit
    point = program.solver.solve(numbers.start, p, bounds, until)
    v = np.clip(point.v, bounds.lower, bounds.upper)
    rows = program.solver.rows(v, p)
    found = stated.residuals(rows, (bounds.row_lower, bounds.row_upper))
    worst = max(found, key=lambda block: block.residual)
    number = worst.index[0] // (stated.sizes()[worst.name] // rounds) + 1
    return Motion(
        rounds=rounds_at(lab, stated, sequence, v),
        first=first_at(stated, v),
        violation=worst.residual,
        block=f"round {number}, {worst.name}",
        iterations=point.iterations,
        seconds=time.perf_counter() - begin,
        word=point.word,
        safety_torque=(1 - MARGIN) / max(float(v[stated.place("s")].max()), 1e-12),
    )


def rounds_at(lab: Laboratory, stated: Trajectory, sequence: Sequence, v: Array) -> Rounds:
    """Postures of a point of the program, toes put exactly on their surfaces.

    The first is the start; where the body waits at the first lift tells `first_at`.
    """
    scene, limb = lab.scene, np.arange(lab.scene.robot.limb_count)
    states = np.array(sequence.states)
    toes, region = toes_of(lab, sequence), lab.footholds.region[limb, states]
    pose = np.vstack([v[stated.place("pose")], np.append(scene.goal.com, scene.goal.rpy)])
    pose[0, :3] = scene.start.com
    found = v[stated.place("toe")].reshape(-1, len(limb), 3)
    for j, i in np.argwhere(open_footholds(sequence)):  # never in the start posture
        stays = states[j - 1, i] == states[j, i]
        surface = scene.terrain.surfaces[region[j, i]]
        toes[j, i] = toes[j - 1, i] if stays else surface.project(found[j - 1, i])
    return Rounds(pose[:, :3], pose[:, 3:], toes, region)


def first_at(stated: Trajectory, v: Array) -> Array:
    """(3,) where the body waits at the first lift, at a point of the program."""
    return np.asarray(v[stated.place("pose")][0, :3])
