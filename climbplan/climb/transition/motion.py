"""Optimise poses and footholds of a fixed contact sequence by IPOPT, from the search's path."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.transition.motion_data import (
    JOINT_MARGIN,
    MARGIN,
    build_motion_data,
    build_shape,
    find_free_footholds,
    find_links_to_separate,
    get_toes,
)
from climbplan.climb.transition.motion_formulation import compile_motion_program
from climbplan.climb.transition.pose_paths import ContactSequence
from climbplan.climb.transition.stance_forces import SearchTables
from climbplan.program.staged_program import StagedProgram

ACCEPTANCE_TOLERANCE = (
    1e-5  # largest violation of a row; the force planner and the verification are stricter
)


@dataclass(frozen=True)
class TransitionMotion:
    """A solution of the motion program for one sequence, before forces and verification."""

    rounds: Rounds
    first_position: Array  # (3,) of the body at the first lift [m]
    violation: float  # of the worst row, by our own evaluation
    block: str  # of that row
    iterations: int
    seconds: float
    status: str  # IPOPT's return status
    safety_torque: float  # S_tau of this motion: smaller required values do not change it

    @property
    def is_accepted(self) -> bool:
        """Whether all constraints hold."""
        return self.violation <= ACCEPTANCE_TOLERANCE


def plan_motion(
    tables: SearchTables,
    sequence: ContactSequence,
    safety_torque: float | None = None,
    *,
    margin_fraction: float = 0.0,
    separate: bool = False,
    colliding_motion: Rounds | None = None,
    joint_margin: float = JOINT_MARGIN,
) -> TransitionMotion:
    """Find a locally optimal motion of a sequence near the path of the search.

    Args:
        tables: Footholds and poses of the search.
        sequence: The contact sequence.
        safety_torque: Required S_tau; None takes the spec's.
        margin_fraction: Fraction of the spec's margins that forces keep.
        separate: Whether limbs are constrained to stay clear of terrain, body and one another.
        colliding_motion: A motion without these constraints in which they came too close.
        joint_margin: Distance of angles from joint bounds [rad].
    """
    scene = tables.scene
    begin = time.perf_counter()
    rounds = len(sequence.states) - 1
    link_pairs = find_links_to_separate(tables, sequence, colliding_motion) if separate else ()
    program = compile_motion_program(build_shape(scene, rounds, separate, link_pairs))
    formulation = program.formulation
    min_safety_torque = scene.spec.force.safety_torque if safety_torque is None else safety_torque
    data = build_motion_data(
        tables,
        formulation,
        sequence,
        min_safety_torque,
        margin_fraction=margin_fraction,
        separate=separate,
        link_pairs=link_pairs,
        joint_margin=joint_margin,
    )
    bounds, p = data.bounds, formulation.theta(data.parameters)
    deadline = time.monotonic() + scene.spec.solver.time_limit
    point = program.solver.solve(data.start, p, bounds, deadline)
    v = np.clip(point.v, bounds.lower, bounds.upper)
    rows = program.solver.rows(v, p)
    residuals = formulation.residuals(rows, (bounds.row_lower, bounds.row_upper))
    worst = max(residuals, key=lambda block: block.residual)
    number = worst.index[0] // (formulation.sizes()[worst.name] // rounds) + 1
    return TransitionMotion(
        rounds=read_rounds(tables, formulation, sequence, v),
        first_position=read_first_position(formulation, v),
        violation=worst.residual,
        block=f"round {number}, {worst.name}",
        iterations=point.iterations,
        seconds=time.perf_counter() - begin,
        status=point.word,
        safety_torque=(1 - MARGIN) / max(float(v[formulation.place("s")].max()), 1e-12),
    )


def read_rounds(
    tables: SearchTables, formulation: StagedProgram, sequence: ContactSequence, v: Array
) -> Rounds:
    """Read the postures of a point of the program, with toes exactly on their surfaces.

    The first is the start; `read_first_position` returns the body's place at the first lift.
    """
    scene, limb = tables.scene, np.arange(tables.scene.robot.limb_count)
    states = np.array(sequence.states)
    toes, region = get_toes(tables, sequence), tables.footholds.region[limb, states]
    pose = np.vstack([v[formulation.place("pose")], np.append(scene.goal.com, scene.goal.rpy)])
    pose[0, :3] = scene.start.com
    toe_values = v[formulation.place("toe")].reshape(-1, len(limb), 3)
    for j, i in np.argwhere(find_free_footholds(sequence)):  # never in the start posture
        is_standing = states[j - 1, i] == states[j, i]
        surface = scene.terrain.surfaces[region[j, i]]
        toes[j, i] = toes[j - 1, i] if is_standing else surface.project(toe_values[j - 1, i])
    return Rounds(pose[:, :3], pose[:, 3:], toes, region)


def read_first_position(formulation: StagedProgram, v: Array) -> Array:
    """Read the position (3,) of the body at the first lift, at a point of the program [m]."""
    return np.asarray(v[formulation.place("pose")][0, :3])
