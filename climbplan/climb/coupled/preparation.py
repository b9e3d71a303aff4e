"""Prepare the data of all coupled methods: problem P, and the solution of its postures alone.

Postures alone, on regions that hold the least load, are a relaxation of P: their bound holds for P,
and where forces balance at them they solve P if its cost counts no forces.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.climb.coupled.statement import formulate_coupled_program, remove_unloadable_regions
from climbplan.climb.postures.explanation import explain_infeasible
from climbplan.climb.postures.statement import PostureMargins, build_posture_program
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import LimitReached
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.reformulations.fixed_integers import FixedIntegerForm
from climbplan.solvers.registry import solve

_MIN_TIME = 0.05  # [s]


@dataclass(frozen=True)
class CoupledProblem:
    """A coupled problem with the solution of its postures alone."""

    scene: ClimbScene  # without regions that hold no load
    program: Program
    instance: Instance  # P
    origin: Array  # (M, 3) points about which moments are taken: the bodies of postures alone
    guess: Array  # (n,) postures alone, forces at their least values
    assignment: IntArray  # regions and free spaces of the postures alone
    bound: float  # of postures alone, valid for P
    nodes: int
    solver: str
    deadline: float = np.inf  # [s] time.monotonic, for all that follows

    @property
    def remaining_time(self) -> float:
        """Remaining time [s], at least the minimum of a solver."""
        return max(self.deadline - time.monotonic(), _MIN_TIME)

    def fix_choices(self, x: Array, assignment: IntArray) -> Instance:
        """Fix all choices of P: a continuous problem with products."""
        return FixedIntegerForm.of(self.instance).at(x, assignment, compact=True)


def prepare_problem(scene: ClimbScene, margins: PostureMargins) -> CoupledProblem:
    """State P and solve the postures alone.

    Raises NotProved where they have no solution, naming what conflicts, and LimitReached.
    """
    options = scene.spec.solver
    deadline = time.monotonic() + options.time_limit
    scene = remove_unloadable_regions(scene)
    postures = build_posture_program(scene, margins)
    alone = postures.instantiate()
    left = max(deadline - time.monotonic(), 0.0)
    first = solve(alone, options.posture_solver, gap=options.gap, time_limit=left)
    if first.status == "infeasible":
        raise explain_infeasible(scene, postures, alone)
    if first.x is None or first.assignment is None:
        raise LimitReached(
            f"no postures found within {options.time_limit:g} s (solver.time_limit) before forces "
            "are planned; a larger limit or fewer rounds may help",
            stage="posture",
        )
    origin = postures.value("com", first.x)
    program = formulate_coupled_program(scene, margins, origin)
    instance = program.instantiate()
    guess = np.clip(np.zeros(instance.size), instance.lower, instance.upper)
    guess[: alone.size] = first.x  # forces come behind the posture program's variables
    return CoupledProblem(
        scene=scene,
        program=program,
        instance=instance,
        origin=origin,
        guess=guess,
        assignment=first.assignment,
        bound=first.bound,
        nodes=first.nodes,
        solver=first.solver,
        deadline=deadline,
    )
