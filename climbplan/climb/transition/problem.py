"""A transition as a problem that methods of the common table take, judged as the planner's motions.

`motion_problem` has its contact sequence fixed: no integers, by nlp among others.
`transition_problem` finds it: whether a limb holds in a round is a binary, and the pairs that
complement each other are rows. pinned keeps the holds of the sequence it starts from, mpcc does
not. As in the planner the motion of what it finds is then planned with that fixed.

An answer has to lead to a plan that passes its verification, which does not read the statement.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.climb.transition.carrying import Run, carry_through, verified
from climbplan.climb.transition.complementarity import complementarity_statement
from climbplan.climb.transition.complementarity_numbers import FreeMotion, found_at, free_motion
from climbplan.climb.transition.homotopy import admissible, sequence_at
from climbplan.climb.transition.mission import climb_after
from climbplan.climb.transition.motion import first_at, rounds_at
from climbplan.climb.transition.motion_numbers import (
    motion_numbers,
    searched_forces,
    shape_of,
    toes_of,
)
from climbplan.climb.transition.motion_statement import motion_statement
from climbplan.climb.transition.planner import searched
from climbplan.climb.transition.pose_ways import Sequence
from climbplan.climb.transition.scene import build_transition
from climbplan.climb.transition.stances import Laboratory
from climbplan.errors import NoPlanFound
from climbplan.mechanics.friction import contact_frame
from climbplan.program.problem import Problem
from climbplan.program.trajectory import Trajectory
from climbplan.reformulations.nlp_form import Bounds

Stated = tuple[Problem, dict[str, Array]]
Values = Mapping[str, Array]


def stated_transition(loaded: LoadedTransition) -> Stated:
    """The problem of a spec and its parameters, from the best sequence of the search.

    The sequence is free unless the spec names one. Raises what `plan_transition` raises where the
    search finds none.
    """
    scene = build_transition(loaded)
    clock = StageClock(lambda stage, fraction: None)
    run = Run(loaded, scene, clock, climb_after(loaded, scene, clock))
    deadline = time.monotonic() + scene.spec.solver.time_limit
    search, found = searched(scene, deadline)
    fixed = scene.spec.task.sequence is not None
    return (motion_problem if fixed else transition_problem)(run, search.lab, found[0])


def motion_problem(run: Run, lab: Laboratory, sequence: Sequence) -> Stated:
    """The motion of a sequence that was searched; `rounds_at` reads an answer."""
    scene = run.scene
    stated = motion_statement(shape_of(scene, len(sequence.states) - 1))
    numbers = motion_numbers(lab, stated, sequence, scene.spec.force.safety_torque)

    def check(theta: object, values: Values) -> dict[str, float]:
        with run.clock.stage("motion"):
            v = np.concatenate(list(values.values()))
            rounds = rounds_at(lab, stated, sequence, v)
        try:
            _, verification = verified(run, rounds, sequence.moved, first_at(stated, v))
        except NoPlanFound as error:
            return {" ".join(str(error).split()): 1.0}
        return {c.name: 0.0 if c.passed else c.residual - c.limit for c in verification.checks}

    return _problem(stated, numbers.parameters, numbers.start, numbers.bounds, check)


def transition_problem(run: Run, lab: Laboratory, sequence: Sequence) -> Stated:
    """A transition with its sequence free, starting from one that was searched.

    `sequence_at` reads an answer. Raises TypeError for surfaces that are not flat.
    """
    motion = free_motion(run.scene)
    stated = complementarity_statement(motion.shape)
    start = np.clip(_searched(motion, lab, sequence), motion.lower, motion.upper)

    def check(theta: object, values: Values) -> dict[str, float]:
        found_lab, found = sequence_at(motion, np.concatenate(list(values.values())))
        if not admissible(run.scene, found.moved):
            return {"moving limbs": 1.0}
        attempt = carry_through(run, found_lab, found)
        return {attempt.reason or "carried_through": float(attempt.complete is None)}

    return _problem(stated, motion.parameters, start, motion.bounds(stated), check)


def _problem(
    stated: Trajectory,
    parameters: dict[str, Array],
    start: Array,
    bounds: Bounds,
    check: Callable[[object, Values], dict[str, float]],
) -> Stated:
    program = stated.program((bounds.row_lower, bounds.row_upper), (bounds.lower, bounds.upper))
    guess = {name: program.value(name, start) for name in program.variables}
    return Problem("transition", program, start=lambda theta: guess, check=check), parameters


def _searched(motion: FreeMotion, lab: Laboratory, sequence: Sequence) -> Array:
    """A point with the poses, toes and forces that the search has."""
    shape, scene = motion.shape, lab.scene
    m, n = shape.rounds, shape.limbs
    poses, limb = np.array(sequence.poses)[:-1], np.arange(n)
    force, use = searched_forces(lab, sequence)
    region = lab.footholds.region[limb, np.array(sequence.states)[:-1]]  # (M, N)
    axes = np.array([contact_frame(region.normal).axes for region in scene.terrain.regions])
    first = np.argmax(motion.surfaces == region[:, :, None], axis=2)
    local = np.zeros((m, n, shape.surfaces, 3))
    local[np.arange(m)[:, None], limb, first] = np.einsum("mnij,mnj->mni", axes[region], force)
    toe = toes_of(lab, sequence)[1:]
    rows = motion.parameters["face_row"].reshape(shape.solids, shape.faces, 3)
    ends = motion.parameters["face_end"].reshape(shape.solids, shape.faces)
    out = np.einsum("bfk,mnk->mnbf", rows, toe) - ends
    side = out == out.max(axis=-1, keepdims=True, initial=-np.inf)
    pose = np.concatenate([lab.poses.com[poses], lab.poses.rpy[poses]], axis=1)
    return motion.program.stated.point(
        {
            "pose": pose,
            **found_at(scene, pose, toe),
            "toe": toe.reshape(m, -1),
            "force": local.reshape(m, -1),
            "hold": ~sequence.moved,
            "face_weight": (side / side.sum(axis=-1, keepdims=True)).reshape(m, -1),
            "s": use[:, None],
        }
    )
