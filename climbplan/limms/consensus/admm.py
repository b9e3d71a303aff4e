"""Algorithm 3: ADMM with growing penalties between both blocks, with residuals of eq. (6.13).

The blocks alternate on an augmented Lagrangian in scaled form (Boyd et al., Distributed
Optimization and Statistical Learning via ADMM, 2011).

Published methods, and equation and algorithm numbers, are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.consensus.block_solution import BlockSolution, LocalCopy, Modes
from climbplan.limms.consensus.mixed_integer import GOAL_TOLERANCE, MixedIntegerBlock
from climbplan.limms.consensus.nonlinear import KinematicSolution, NonlinearBlock
from climbplan.limms.consensus.problem import HELD, ConsensusProblem, interpolate_chain_points
from climbplan.limms.consensus.projection import Projection
from climbplan.program.residuals import BlockResidual

TOLERANCES = (0.01, 0.01, 0.1)  # [m], [m], [rad] of mean residuals
LATCH_TOLERANCE = 1e-4  # [m] violation of latches of an iterate
MAX_MIP_CALLBACKS = 150  # limit checks of HiGHS, integers free, with a consensus term
_FRAMES = np.array([0, 0, 1, 2, 2, 3, 3, 3])  # straight link along the z axis of each frame


@dataclass(frozen=True)
class ConsensusResidual:
    """Disagreement of the blocks, eq. (6.13): means and largest values."""

    box: tuple[float, float]  # r_pB [m]
    points: tuple[float, float]  # r_pL [m]
    axes: tuple[float, float]  # r_RL [rad]

    @property
    def has_converged(self) -> bool:
        """True if all means are within their tolerances."""
        means = (self.box[0], self.points[0], self.axes[0])
        return all(value <= limit for value, limit in zip(means, TOLERANCES, strict=True))


@dataclass(frozen=True)
class IterationRecord:
    """The record of one iteration."""

    residual: ConsensusResidual
    violation: float  # of the nonlinear block [m]
    penetration: float  # of its links [m]
    goal_error: float  # distance to the goal in the mixed-integer block [m]
    mixed_integer_seconds: float
    nonlinear_seconds: float
    frozen: bool


@dataclass(frozen=True)
class ConsensusIterate:
    """The iterate on which the blocks agreed best."""

    number: int
    modes: Modes
    copy: LocalCopy  # of the nonlinear block
    angles: Array
    velocity: Array  # of the box, from the mixed-integer block
    held_seconds: float  # [s] of an interval in which the box is held
    residual: ConsensusResidual
    violation: float
    worst_rows: BlockResidual | None  # the rows that the mixed-integer solution violates most

    def rank(self) -> tuple[bool, float]:
        """Return the sort key, smaller is better: feasible latches first, then agreement."""
        r = self.residual
        return (self.violation > LATCH_TOLERANCE, r.box[0] + r.points[0] + 0.1 * r.axes[0])


def compute_residual(
    problem: ConsensusProblem, first: LocalCopy, second: LocalCopy
) -> ConsensusResidual:
    """Return eq. (6.13) of two copies, without the start, which both share.

    Frames differ in their z axes, which points determine. The mixed-integer block leaves the other
    axes free, so they are those of the nonlinear block.
    """
    module = problem.scene.module
    box = np.linalg.norm(first.box[1:] - second.box[1:], axis=-1)
    point_errors = interpolate_chain_points(first.points[1:], module) - interpolate_chain_points(
        second.points[1:], module
    )
    points = np.linalg.norm(point_errors, axis=-1)
    axes = np.linalg.norm(
        _link_directions(problem, first) - _link_directions(problem, second), axis=-1
    )[..., _FRAMES]
    return ConsensusResidual(
        *((float(values.mean()), float(values.max())) for values in (box, points, axes))
    )


def _link_directions(problem: ConsensusProblem, copy: LocalCopy) -> Array:
    """Return the unit directions (K, L, 4, 3) of links."""
    directions: Array = np.diff(copy.points[1:], axis=2) / problem.link_lengths[:, None]
    return directions


@dataclass(frozen=True)
class AdmmParameters:
    """The parameters of Algorithm 3, as the spec gives them."""

    iterations: int
    growth: float  # rho
    weight: float  # W^0 of both blocks
    freeze_after: int  # iterations with free integers


@dataclass(frozen=True)
class ConsensusRun:
    """The iterations from one choice of integers."""

    steps: tuple[IterationRecord, ...]
    best: ConsensusIterate


def run_admm(
    block: MixedIntegerBlock,
    nonlinear: NonlinearBlock,
    initial: BlockSolution,
    parameters: AdmmParameters,
    deadline: float,
    report: Callable[[float], None] = lambda share: None,
) -> ConsensusRun | None:
    """Run Algorithm 3 from a first solution of the mixed-integer block.

    The integers are fixed after `freeze_after` iterations if the block reaches the goal with them;
    the published form never fixes them. Iterations stop early where the blocks agree to a tenth of
    the tolerances.

    Args:
        block: The mixed-integer block.
        nonlinear: The nonlinear block.
        initial: The first solution of the mixed-integer block.
        parameters: Parameters of the algorithm.
        deadline: Time limit as `time.monotonic` [s].
        report: Receives the fraction of iterations done.

    Returns:
        The iterations, or None if the time does not suffice for one.
    """
    problem = block.problem
    weight, solution = parameters.weight, initial
    assert initial.copy is not None
    dual = initial.copy.scale(0.0)
    records: list[IterationRecord] = []
    best: ConsensusIterate | None = None
    projection: Projection | None = None
    for index in range(parameters.iterations):
        assert solution.copy is not None
        kinematic = _solve_kinematics(nonlinear, solution, dual, deadline)
        if not np.isfinite(kinematic.violation):
            break  # the deadline interrupted the block
        residual = compute_residual(problem, solution.copy, kinematic.copy)
        records.append(_build_record(residual, solution, kinematic, projection is not None))
        iterate = _build_iterate(problem, len(records), residual, solution, kinematic)
        if best is None or iterate.rank() < best.rank():
            best = iterate
        report((index + 1) / parameters.iterations)
        if _has_converged_early(residual) or time.monotonic() > deadline:
            break
        dual = _update_dual(dual, solution.copy, kinematic.copy, parameters.growth)
        weight *= parameters.growth
        may_freeze = problem.formulation.freezes_integers and index + 1 >= parameters.freeze_after
        if projection is None and may_freeze and solution.goal_error <= GOAL_TOLERANCE:
            assert solution.x is not None
            projection = Projection(block, solution.x)
        target = kinematic.copy.add_scaled(dual, -1.0)
        if projection is not None:
            solution = projection.solve(target, weight, kinematic.region)
        else:
            block.set_consensus_target(target, weight)
            solution = block.solve(MAX_MIP_CALLBACKS, deadline, solution.x)
        if solution.copy is None:
            break
    block.clear_consensus()
    return None if best is None else ConsensusRun(tuple(records), best)


def _solve_kinematics(
    nonlinear: NonlinearBlock, solution: BlockSolution, dual: LocalCopy, deadline: float
) -> KinematicSolution:
    """Solve the nonlinear block with the modes of the other block, near its copy plus the dual."""
    assert solution.copy is not None
    assert solution.modes is not None
    return nonlinear.solve(solution.copy.add_scaled(dual, 1.0), solution.modes, deadline)


def _update_dual(dual: LocalCopy, first: LocalCopy, second: LocalCopy, growth: float) -> LocalCopy:
    """Return the scaled dual of eq. (6.12c), which shrinks as the weights grow."""
    return dual.add_scaled(first, 1.0).add_scaled(second, -1.0).scale(1 / growth)


def _build_record(
    residual: ConsensusResidual,
    solution: BlockSolution,
    kinematic: KinematicSolution,
    is_frozen: bool,
) -> IterationRecord:
    """Return the record of an iteration."""
    return IterationRecord(
        residual,
        kinematic.violation,
        kinematic.penetration,
        solution.goal_error,
        solution.seconds,
        kinematic.seconds,
        is_frozen,
    )


def _build_iterate(
    problem: ConsensusProblem,
    number: int,
    residual: ConsensusResidual,
    solution: BlockSolution,
    kinematic: KinematicSolution,
) -> ConsensusIterate:
    """Return the iterate of an iteration."""
    assert solution.modes is not None
    assert solution.velocity is not None
    return ConsensusIterate(
        number,
        solution.modes,
        kinematic.copy,
        kinematic.angles,
        solution.velocity,
        problem.formulation.interval_seconds[HELD],
        residual,
        max(kinematic.violation, kinematic.penetration),
        solution.worst_rows,
    )


def _has_converged_early(residual: ConsensusResidual) -> bool:
    """Return whether all means are within a tenth of their tolerances."""
    means = (residual.box[0], residual.points[0], residual.axes[0])
    return all(value <= limit / 10 for value, limit in zip(means, TOLERANCES, strict=True))
