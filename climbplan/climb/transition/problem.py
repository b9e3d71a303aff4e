"""Transitions as problems for the common table of methods.

`build_motion_problem` has a fixed contact sequence and no integers, for nlp among others. In
`build_transition_problem` the sequence is free: a binary states whether a limb is in contact in a
round, and complementarity pairs are constraints. Method pinned keeps the contacts of its start,
mpcc does not. As in the planner, the motion is then planned again with the sequence fixed.

A solution has to lead to a plan that passes its verification, which is independent of the problem.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.climb.transition.complementarity import formulate_complementarity
from climbplan.climb.transition.complementarity_data import (
    ComplementarityData,
    build_complementarity_data,
    compute_dependent_variables,
)
from climbplan.climb.transition.following_climb import plan_following_climb
from climbplan.climb.transition.homotopy import extract_sequence, is_admissible
from climbplan.climb.transition.motion import read_first_position, read_rounds
from climbplan.climb.transition.motion_data import (
    build_motion_data,
    build_shape,
    compute_search_forces,
    get_toes,
)
from climbplan.climb.transition.motion_formulation import formulate_motion
from climbplan.climb.transition.planner import search_sequences
from climbplan.climb.transition.pose_paths import ContactSequence
from climbplan.climb.transition.scene import build_transition
from climbplan.climb.transition.sequence_planning import (
    TransitionRun,
    plan_and_verify_sequence,
    verify_motion,
)
from climbplan.climb.transition.stance_forces import SearchTables
from climbplan.errors import NoPlanFound
from climbplan.mechanics.friction import contact_frame
from climbplan.program.problem import Problem
from climbplan.program.staged_program import StagedProgram
from climbplan.reformulations.nlp_form import Bounds

ParametrisedProblem = tuple[Problem, dict[str, Array]]
Values = Mapping[str, Array]


def formulate_transition(loaded: LoadedTransition) -> ParametrisedProblem:
    """State the problem of a spec and its parameters, starting at the best sequence of the search.

    The sequence is free unless the spec names one. Raises what `plan_transition` raises if the
    search finds none.
    """
    scene = build_transition(loaded)
    clock = StageClock(lambda stage, fraction: None)
    run = TransitionRun(loaded, scene, clock, plan_following_climb(loaded, scene, clock))
    deadline = time.monotonic() + scene.spec.solver.time_limit
    search, sequences = search_sequences(scene, deadline)
    is_fixed = scene.spec.task.sequence is not None
    return (build_motion_problem if is_fixed else build_transition_problem)(
        run, search.tables, sequences[0]
    )


def build_motion_problem(
    run: TransitionRun, tables: SearchTables, sequence: ContactSequence
) -> ParametrisedProblem:
    """Build the motion problem of a sequence; `read_rounds` reads a solution."""
    scene = run.scene
    formulation = formulate_motion(build_shape(scene, len(sequence.states) - 1))
    data = build_motion_data(tables, formulation, sequence, scene.spec.force.safety_torque)

    def check(theta: object, values: Values) -> dict[str, float]:
        with run.clock.stage("motion"):
            v = np.concatenate(list(values.values()))
            rounds = read_rounds(tables, formulation, sequence, v)
        try:
            _, verification = verify_motion(
                run, rounds, sequence.moves, read_first_position(formulation, v)
            )
        except NoPlanFound as error:
            return {" ".join(str(error).split()): 1.0}
        return {c.name: 0.0 if c.passed else c.residual - c.limit for c in verification.checks}

    return _build_problem(formulation, data.parameters, data.start, data.bounds, check)


def build_transition_problem(
    run: TransitionRun, tables: SearchTables, sequence: ContactSequence
) -> ParametrisedProblem:
    """Build the problem with a free sequence, starting from one of the search.

    `extract_sequence` reads a solution. Raises TypeError for surfaces that are not flat.
    """
    data = build_complementarity_data(run.scene)
    formulation = formulate_complementarity(data.shape)
    start = np.clip(_build_start_point(data, tables, sequence), data.lower, data.upper)

    def check(theta: object, values: Values) -> dict[str, float]:
        found_tables, sequence_found = extract_sequence(data, np.concatenate(list(values.values())))
        if not is_admissible(run.scene, sequence_found.moves):
            return {"moving limbs": 1.0}
        attempt = plan_and_verify_sequence(run, found_tables, sequence_found)
        return {attempt.reason or "carried_through": float(attempt.motion is None)}

    return _build_problem(formulation, data.parameters, start, data.bounds(formulation), check)


def _build_problem(
    formulation: StagedProgram,
    parameters: dict[str, Array],
    start: Array,
    bounds: Bounds,
    check: Callable[[object, Values], dict[str, float]],
) -> ParametrisedProblem:
    program = formulation.program(
        (bounds.row_lower, bounds.row_upper), (bounds.lower, bounds.upper)
    )
    guess = {name: program.value(name, start) for name in program.variables}
    return Problem("transition", program, start=lambda theta: guess, check=check), parameters


def _build_start_point(
    data: ComplementarityData, tables: SearchTables, sequence: ContactSequence
) -> Array:
    """Build a start point with the poses, toes and forces of the search."""
    shape, scene = data.shape, tables.scene
    m, n = shape.rounds, shape.limbs
    poses, limb = np.array(sequence.poses)[:-1], np.arange(n)
    force, torque_use = compute_search_forces(tables, sequence)
    region = tables.footholds.region[limb, np.array(sequence.states)[:-1]]  # (M, N)
    axes = np.array([contact_frame(region.normal).axes for region in scene.terrain.regions])
    surface_slot = np.argmax(data.surfaces == region[:, :, None], axis=2)
    local = np.zeros((m, n, shape.surfaces, 3))
    local[np.arange(m)[:, None], limb, surface_slot] = np.einsum(
        "mnij,mnj->mni", axes[region], force
    )
    toe = get_toes(tables, sequence)[1:]
    rows = data.parameters["face_row"].reshape(shape.solids, shape.faces, 3)
    ends = data.parameters["face_end"].reshape(shape.solids, shape.faces)
    face_distance = np.einsum("bfk,mnk->mnbf", rows, toe) - ends
    active_faces = face_distance == face_distance.max(axis=-1, keepdims=True, initial=-np.inf)
    pose = np.concatenate([tables.poses.com[poses], tables.poses.rpy[poses]], axis=1)
    return data.program.formulation.point(
        {
            "pose": pose,
            **compute_dependent_variables(scene, pose, toe),
            "toe": toe.reshape(m, -1),
            "force": local.reshape(m, -1),
            "hold": ~sequence.moves,
            "face_weight": (active_faces / active_faces.sum(axis=-1, keepdims=True)).reshape(m, -1),
            "s": torque_use[:, None],
        }
    )
