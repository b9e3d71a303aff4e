"""Poses and footholds of a transition with its sequence fixed, by IPOPT from the search's way."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.climb.plan.climb_plan import Array, Rounds
from climbplan.climb.transition.motion_numbers import motion_numbers, open_footholds, toes_of
from climbplan.climb.transition.motion_statement import MotionProgram, Shape, motion_program
from climbplan.climb.transition.pose_ways import Sequence
from climbplan.climb.transition.stances import Laboratory
from climbplan.reformulations.nlp_form import Bounds
from climbplan.terrain.surfaces import Region

ACCEPTED = 1e-5  # largest violation of a row; the force planner and the verification are stricter


@dataclass(frozen=True)
class Motion:
    """What IPOPT found for one sequence; not yet checked by forces and verification."""

    rounds: Rounds
    violation: float  # of the worst row, by our own evaluation
    block: str  # of that row
    iterations: int
    seconds: float
    word: str  # IPOPT's return status

    @property
    def accepted(self) -> bool:
        """Whether every row holds."""
        return self.violation <= ACCEPTED


def plan_motion(lab: Laboratory, sequence: Sequence, safety_torque: float | None = None) -> Motion:
    """The motion of least cost near the search's way; safety_torque: S_tau asked for instead."""
    scene = lab.scene
    begin = time.perf_counter()
    shape = Shape(
        rounds=len(sequence.states) - 1,
        limbs=scene.robot.limb_count,
        solids=len(scene.terrain.solids),
        edges=max(len(s.b) for s in scene.terrain.surfaces if isinstance(s, Region)),
    )
    program = motion_program(shape)
    least = scene.spec.force.safety_torque if safety_torque is None else safety_torque
    numbers = motion_numbers(lab, program, sequence, least)
    bounds = Bounds(numbers.lower, numbers.upper, numbers.row_lower, numbers.row_upper)
    until = time.monotonic() + scene.spec.solver.time_limit
    point = program.solver.solve(numbers.start, numbers.parameters, bounds, until)
    v = np.clip(point.v, numbers.lower, numbers.upper)
    rows = np.array(program.rows(v, numbers.parameters)[0]).ravel()
    off = np.maximum(numbers.row_lower - rows, rows - numbers.row_upper)
    off = np.where(np.isnan(rows), np.inf, off)
    worst = int(np.argmax(off))
    return Motion(
        rounds=_rounds(lab, program, sequence, v),
        violation=float(off[worst]),
        block=_block(program, worst),
        iterations=point.iterations,
        seconds=time.perf_counter() - begin,
        word=point.word,
    )


def _block(program: MotionProgram, row: int) -> str:
    count = sum(size for _, size in program.blocks)
    number, row = divmod(row, count)
    for name, size in program.blocks:
        if row < size:
            return f"round {number + 1}, {name}"
        row -= size
    raise IndexError(row)


def _rounds(lab: Laboratory, program: MotionProgram, sequence: Sequence, v: Array) -> Rounds:
    """Postures of an answer, toes put exactly on their surfaces."""
    scene = lab.scene
    m, n = program.shape.rounds, program.shape.limbs
    limb = np.arange(n)
    states = np.array(sequence.states)
    toes, region = toes_of(lab, sequence), lab.footholds.region[limb, states]
    open_toes = open_footholds(sequence)
    com, rpy = np.empty((m + 1, 3)), np.empty((m + 1, 3))
    com[m], rpy[m] = scene.goal.com, scene.goal.rpy
    for j, own in enumerate(v.reshape(m, program.variables.size)):
        parts = program.variables.unpack(own)
        com[j], rpy[j] = parts["pose"][:3, 0], parts["pose"][3:, 0]
        for i in np.flatnonzero(open_toes[j + 1]):
            stays = states[j, i] == states[j + 1, i]
            surface = scene.terrain.surfaces[region[j + 1, i]]
            toes[j + 1, i] = toes[j, i] if stays else surface.project(parts["toe"][:, i])
    return Rounds(com, rpy, toes, region)
