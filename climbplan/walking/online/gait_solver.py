"""Sequential quadratic programming for one fixed contact sequence (gait) within a tick.

The QPs have all integers fixed. A solution is validated by rolling out its forces with the
nonlinear dynamics in continuous time. It is feasible if the rollout stays within 0.05 m/s and 0.05
rad of the QP's prediction over the horizon, and toes stay in their workspace.
Friction needs no check
because the QP's pyramids are inside the friction cones.

Published methods, and equation numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.kernels.body import NUM_SUBSTEPS
from climbplan.walking.kernels.continuous_rollout import validate_by_rollout
from climbplan.walking.kernels.parameters import LinearisationPoint
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram, WalkIterate
from climbplan.walking.offline.sqp import guess_iterate
from climbplan.walking.published.program import PublishedProgram
from climbplan.walking.task.task import Gait, WalkTask, WalkTrajectory

VELOCITY_TOLERANCE, ANGLE_TOLERANCE = 0.05, 0.05  # [m/s], [rad] between rollout and prediction
REACH_TOLERANCE = 5e-3  # [m]
JOINT_SPEED_TOLERANCE = 0.01  # fraction by which joints may exceed their speed limits
STANCE_REACH_TOLERANCE = 0.015  # [m] of standing toes between knots
# Largest violation of body and toes, in tolerances, that a further QP can remove; 20 with intervals
# of 0.08 s. The linearisation error of an interval grows with the square of its length.
MAX_VIOLATION_GROWTH = 20.0 / 0.08**2  # [1/s^2]
ASSEMBLY_ITERATIONS = 60  # DAQP iterations that take as long as the assembly and validation of a QP
_MAX_ITERATIONS_PER_QP = 500  # DAQP iterations
_CACHE_SIZE = 256  # programs


@dataclass(frozen=True)
class GaitSolution:
    """The trajectory of a gait and its validation by the nonlinear rollout."""

    trajectory: WalkTrajectory
    violation: float  # in tolerances beyond the first; <= 0 if it is feasible
    cost: float  # eq. (8.30) of the rollout if it is feasible, else infinite
    is_hopeless: bool  # the violation is too large for a further QP to remove

    @property
    def is_feasible(self) -> bool:
        """True if the nonlinear rollout validates the trajectory."""
        return self.violation <= 0.0


@dataclass
class IterationBudget:
    """The QP-iteration budget of a tick, in DAQP iterations; assembling a QP counts, too."""

    max_iterations: int
    used_iterations: int = 0
    num_qps: int = 0

    @property
    def remaining(self) -> int:
        """Iterations left."""
        return self.max_iterations - self.used_iterations

    @property
    def is_exhausted(self) -> bool:
        """True if no further QP fits."""
        return self.remaining <= ASSEMBLY_ITERATIONS

    def record_qp(self, iterations: int) -> None:
        """Record a QP that took a number of iterations."""
        self.num_qps += 1
        self.used_iterations += iterations + ASSEMBLY_ITERATIONS


@dataclass
class SqpProgress:
    """The SQP iterations of one gait within a tick."""

    iterate: WalkIterate  # point of the next linearisation
    best: GaitSolution | None = None
    num_qps: int = 0  # that had a solution
    is_stuck: bool = False  # the last QP was infeasible
    left_workspace: bool = False  # the last solution needed slack in the workspace rows

    @property
    def is_feasible(self) -> bool:
        """True if the best solution is feasible."""
        return self.best is not None and self.best.is_feasible


class GaitSolver:
    """Solves fixed-gait programs; compiled programs are cached from tick to tick."""

    def __init__(
        self, task: WalkTask, margin: float, neighbour_region_fraction: float = 0.0
    ) -> None:
        """Create a solver with empty caches.

        Args:
            task: the walking task.
            margin: distance that toes yet to be placed keep from the sides of their workspace
                boxes [m].
            neighbour_region_fraction: fraction of neighbouring regions that the published form may
                choose.
        """
        self._margin, self._neighbour_region_fraction = margin, neighbour_region_fraction
        self._programs: OrderedDict[bytes, FixedContactProgram] = OrderedDict()
        self._published_programs: OrderedDict[bytes, PublishedProgram] = OrderedDict()

    def prepare_program(self, task: WalkTask, gait: Gait) -> FixedContactProgram:
        """Return the fixed-integer program of a gait from the task's start, cached if possible."""
        program = self._programs.get(gait.key)
        if program is None:
            program = FixedContactProgram(task, gait, self._margin)
            self._programs[gait.key] = program
            if len(self._programs) > _CACHE_SIZE:
                self._programs.popitem(last=False)
        else:
            self._programs.move_to_end(gait.key)
            program.restart(task)
        return program

    def initialise_progress(
        self, task: WalkTask, program: FixedContactProgram, initial_iterate: WalkIterate | None
    ) -> SqpProgress:
        """Start the SQP of a gait.

        Args:
            task: the walking task.
            program: the gait's program.
            initial_iterate: first point of linearisation; None for uniform motion to the
                reference.
        """
        return SqpProgress(
            guess_iterate(task, program.gait)
            if initial_iterate is None
            else fit_iterate(task, program, initial_iterate)
        )

    def solve(
        self,
        task: WalkTask,
        program: FixedContactProgram,
        progress: SqpProgress,
        max_qps: int,
        budget: IterationBudget,
        allow_elastic: bool = False,
    ) -> GaitSolution | None:
        """Continue the SQP of a gait until a solution is feasible or a limit is reached.

        Args:
            task: the walking task.
            program: the gait's program.
            progress: earlier iterations of this tick, which count and are not repeated.
            max_qps: QPs of the gait, earlier ones included.
            budget: iterations left in the tick.
            allow_elastic: relax infeasible workspace rows at a penalty (elastic mode). A solution
                far off is then given up only if it needs the relaxation.

        Returns:
            The solution of least violation; None if no QP had a solution.
        """
        if progress.is_stuck and not allow_elastic:
            return progress.best
        while progress.num_qps < max_qps and not progress.is_feasible:
            iteration_limit = min(_MAX_ITERATIONS_PER_QP, budget.remaining - ASSEMBLY_ITERATIONS)
            if iteration_limit <= 0:
                break
            solution = program.solve_qp(
                progress.iterate,
                allow_elastic,
                progress.is_stuck or progress.left_workspace,
                iteration_limit,
            )
            budget.record_qp(program.num_iterations)
            progress.is_stuck, progress.left_workspace = solution is None, program.is_elastic
            if solution is None:
                break
            progress.num_qps += 1
            progress.iterate = solution
            evaluated = self.validate(task, program, solution)
            incumbent = progress.best
            if evaluated is not None and (
                incumbent is None or evaluated.violation <= incumbent.violation
            ):
                progress.best = evaluated
            is_hopeless = evaluated is None or evaluated.is_hopeless
            if is_hopeless and (program.is_elastic or not allow_elastic):
                break
        return progress.best

    def solve_published(
        self,
        task: WalkTask,
        program: FixedContactProgram,
        initial_iterate: WalkIterate,
        budget: IterationBudget,
    ) -> GaitSolution | None:
        """Solve the published program in the regions of an iterate; return None if OSQP fails."""
        key = program.gait.key
        if key not in self._published_programs:
            self._published_programs[key] = PublishedProgram(
                program, self._neighbour_region_fraction
            )
            if len(self._published_programs) > _CACHE_SIZE:
                self._published_programs.popitem(last=False)
        self._published_programs.move_to_end(key)
        answer = self._published_programs[key].solve(fit_iterate(task, program, initial_iterate))
        budget.record_qp(0)
        return None if answer.iterate is None else self.validate(task, program, answer.iterate)

    def validate(
        self, task: WalkTask, program: FixedContactProgram, iterate: WalkIterate
    ) -> GaitSolution | None:
        """Validate an iterate: roll out its forces in continuous time and compare with its states.

        Returns:
            The rollout with its violation; None where it diverges.
        """
        program.find_heights(iterate.state)
        state, toes, velocity_error, angle_error, reach, stance_reach = validate_by_rollout(
            task.body.parameters,
            program.horizon,
            program.placement,
            LinearisationPoint(iterate.state, iterate.force, iterate.spots),
            NUM_SUBSTEPS,
        )
        if math.isinf(velocity_error):
            return None
        rigid_body_ratio = max(
            velocity_error / VELOCITY_TOLERANCE,
            angle_error / ANGLE_TOLERANCE,
            reach / REACH_TOLERANCE,
            stance_reach / STANCE_REACH_TOLERANCE,
        )
        joint_speed_ratio = (
            program.joints.compute_speed_excess(state, toes, iterate.spots, program.tilt)
            / JOINT_SPEED_TOLERANCE
        )
        worst_ratio = max(rigid_body_ratio, joint_speed_ratio)
        force = np.zeros((len(iterate.force) + 1, *iterate.force.shape[1:]))
        force[:-1] = iterate.force
        cost = program.compute_cost(state, iterate.force) if worst_ratio <= 1.0 else math.inf
        walk = WalkTrajectory(state, toes, force, program.gait)
        return GaitSolution(
            walk,
            worst_ratio - 1.0,
            cost,
            rigid_body_ratio - 1.0 > MAX_VIOLATION_GROWTH * task.dt**2,
        )


def fit_iterate(task: WalkTask, program: FixedContactProgram, iterate: WalkIterate) -> WalkIterate:
    """Return the iterate with forces and footholds of the program's standing legs only."""
    standing = program.gait.contact[:-1]
    force: Array = np.where(standing[..., None], iterate.force, 0.0)
    spots = iterate.spots
    if len(spots) != program.footing.count:
        spots = guess_iterate(task, program.gait).spots
    if not task.ground.is_flat_everywhere:
        spots = task.ground.project(program.footing.region, spots)
    return WalkIterate(iterate.state, force, spots)
