"""Prefix relaxations: the first intervals of a walk alone, to tighten the bounds of the whole.

A motion below the cutoff pays for its first k intervals at most the cutoff less a lower bound on
the cost of all later intervals. The relaxation of the truncated task with that cutoff contains the
beginning of every such motion. Its linear programs are many times smaller than those of the whole
task, and the bounds of early knots tighten most, because the start is given. Each prefix that is
one interval longer starts from the bounds of the one before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import highspy
import numpy as np

from climbplan.solvers.highs.model import build_rows_model, run_highs
from climbplan.walking.micp.attitude_box import AttitudeBox
from climbplan.walking.micp.bound_tightening import tighten_bounds
from climbplan.walking.micp.outer_approximation import (
    TANGENT_TOLERANCE,
    confirm_infeasible,
    create_lp_solver,
    refine_outer_approximation,
)
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation, build_relaxation
from climbplan.walking.micp.variable_bounds import VariableBounds
from climbplan.walking.task.task import Goal, WalkTask

_T = TypeVar("_T", AttitudeBox, VariableBounds)
# Fields of bounds that are not by interval: states have one knot more than intervals
_STATE_FIELDS, _TOTAL_FIELDS = ("state_low", "state_high"), ("velocity_cost",)
MIN_PREFIX = 3  # intervals of the shortest prefix: the start decides the first
MIN_PREFIX_GAIN = 0.003  # of the cost, by which a prefix has to raise the bound
_TAIL_COST_TOLERANCE = 1e-4  # of the cost, that a tail cost is lowered by for rounding


@dataclass(frozen=True)
class TaskRelaxation:
    """How a task is relaxed: what the programs of all its nodes have in common."""

    task: WalkTask
    attitude_box: AttitudeBox
    cutoff: float  # limit on the cost of motions
    arm_pieces: int
    height_pieces: int
    tangent_ratio: float  # from one tangent of a square to the next
    num_rotation_knots: int | None = None  # knots with rows of rotation; None: all

    def build(
        self, bounds: VariableBounds | None, constant_inertia: bool = False
    ) -> MixedIntegerRelaxation:
        """Return the relaxation of all motions within bounds.

        Args:
            bounds: Bounds of the variables; None: those of the attitude box and the cutoff alone.
            constant_inertia: Take the inertia at the middle of the attitude box: fewer columns.
        """
        attitude_box = self.attitude_box
        if bounds is not None:
            attitude_box = bounds.intersect_attitude_box(attitude_box)
        return build_relaxation(
            self.task,
            attitude_box,
            self.cutoff,
            self.arm_pieces,
            self.height_pieces,
            self.tangent_ratio,
            bounds=bounds,
            constant_inertia=constant_inertia,
            num_rotation_knots=self.num_rotation_knots,
        )

    def build_prefix(
        self, bounds: VariableBounds, length: int, tail_cost: float
    ) -> MixedIntegerRelaxation:
        """Return the relaxation of the first intervals of all motions within bounds.

        The inertia is linear: bound tightening solves hundreds of its linear programs.

        Args:
            bounds: Bounds of the variables of the whole motion.
            length: Number of intervals of the prefix.
            tail_cost: Lower bound on the cost of all later intervals.
        """
        prefix = TaskRelaxation(
            truncate_task(self.task, length),
            _truncate_arrays(self.attitude_box, length, tuple(vars(self.attitude_box))),
            self.cutoff - tail_cost,
            self.arm_pieces,
            self.height_pieces,
            self.tangent_ratio,
        )
        return prefix.build(truncate_bounds(bounds, length), constant_inertia=True)


@dataclass(frozen=True)
class TightenedBounds:
    """The outcome of bound tightening by prefixes."""

    bounds: VariableBounds
    tail_costs: tuple[float, ...]  # (N + 1) lower bounds on the cost from each knot on


def tighten_by_prefixes(
    formulation: TaskRelaxation,
    program: MixedIntegerRelaxation,
    seconds: float,
    clock: Callable[[], float],
    min_gain: float = MIN_PREFIX_GAIN,
) -> TightenedBounds | None:
    """Tighten the bounds of a program by ever longer prefixes.

    It ends when a prefix does not raise the bound of the whole by enough, or when time is over.

    Args:
        formulation: The formulation of the program.
        program: The relaxation of the whole task.
        seconds: Time limit [s].
        clock: Clock of the time limit [s].
        min_gain: Fraction of the cutoff by which a prefix has to raise the bound.

    Returns:
        The tightened bounds; None if the program is infeasible.
    """
    end, bounds, last_bound = clock() + seconds, program.bounds, -np.inf
    tail_costs = np.zeros(formulation.task.knots + 1)
    for length in range(MIN_PREFIX, formulation.task.knots):
        bound = _bound_relaxation(formulation, program)
        if np.isinf(bound):
            return None
        if clock() >= end or bound < last_bound + min_gain * formulation.cutoff:
            break
        last_bound = bound
        tail_cost = bound_tail_cost(program, length)
        if tail_cost is None:
            return None
        tail_costs[length] = tail_cost
        tightened = tighten_by_prefix(
            formulation,
            bounds,
            length,
            tuple(tail_costs),
            0,
            seconds=max(end - clock(), 0.0),
            clock=clock,
        )
        if tightened is None:
            return None
        bounds, program = tightened, formulation.build(tightened)
    # The cost from a knot on is at most that from any earlier knot on.
    return TightenedBounds(bounds, tuple(np.maximum.accumulate(tail_costs[::-1])[::-1].tolist()))


def tighten_by_prefix(
    formulation: TaskRelaxation,
    bounds: VariableBounds,
    length: int,
    tail_costs: Sequence[float] | Mapping[int, float],
    first_knot: int,
    *,
    seconds: float = np.inf,
    clock: Callable[[], float] = time.perf_counter,
) -> VariableBounds | None:
    """Tighten bounds by the prefix relaxation of one length.

    Args:
        formulation: The formulation of the whole task.
        bounds: Bounds of the variables of the whole motion.
        length: Number of intervals of the prefix.
        tail_costs: Lower bound on the cost from a knot on, by knot; that of `length` is used.
        first_knot: Bounds of earlier knots are left as they are.
        seconds: Time limit [s].
        clock: Clock of the time limit [s].

    Returns:
        The tightened bounds; None if the prefix is infeasible.
    """
    prefix = formulation.build_prefix(bounds, length, tail_costs[length])
    for _, solution in refine_outer_approximation(
        prefix.model, TANGENT_TOLERANCE * formulation.cutoff, create_lp_solver()
    ):
        if solution is None:
            return None
    tightened = tighten_bounds(prefix, seconds, clock, first_knot)
    return merge_prefix_bounds(bounds, tightened) if tightened is not None else None


def bound_by_prefix(
    formulation: TaskRelaxation, bounds: VariableBounds, length: int, tail_cost: float
) -> float:
    """Return a lower bound on the cost of motions by a prefix relaxation alone.

    Args:
        formulation: The formulation of the whole task.
        bounds: Bounds of the variables of the whole motion.
        length: Number of intervals of the prefix.
        tail_cost: Lower bound on the cost of all later intervals.

    Returns:
        The bound; infinite if the prefix is infeasible.
    """
    prefix = formulation.build_prefix(bounds, length, tail_cost)
    return tail_cost + _bound_relaxation(formulation, prefix)


def bound_by_tightening(
    formulation: TaskRelaxation,
    bounds: VariableBounds,
    max_rounds: int,
    seconds_left: Callable[[], float],
    clock: Callable[[], float],
) -> float:
    """Return a lower bound on the cost of motions by rounds of bound tightening.

    Args:
        formulation: The formulation of the task.
        bounds: Bounds of the variables.
        max_rounds: Number of rounds of bound tightening.
        seconds_left: Returns the time that is left [s].
        clock: Clock of the time limit [s].

    Returns:
        The bound; the cutoff if no motion is below it.
    """
    bound = 0.0
    for round_ in range(max_rounds + 1):
        program = formulation.build(bounds)
        bound = max(bound, min(_bound_relaxation(formulation, program), formulation.cutoff))
        if bound >= formulation.cutoff or round_ == max_rounds or seconds_left() <= 0:
            break
        tightened = tighten_bounds(program, seconds_left(), clock)
        if tightened is None:
            return formulation.cutoff
        bounds = tightened
    return bound


def _bound_relaxation(formulation: TaskRelaxation, program: MixedIntegerRelaxation) -> float:
    """Return the bound of a relaxation by outer approximation; infinite if it is infeasible."""
    solutions = refine_outer_approximation(
        program.model, TANGENT_TOLERANCE * formulation.cutoff, create_lp_solver()
    )
    return max((bound for bound, _ in solutions), default=0.0)


def bound_tail_cost(program: MixedIntegerRelaxation, first_knot: int) -> float | None:
    """Return a lower bound on the cost from a knot on, lowered by the tolerance of the solver.

    Args:
        program: The relaxation of the whole task.
        first_knot: The first knot of the tail.

    Returns:
        The bound, at least 0; None if the program is infeasible.
    """
    cost = minimise_tail_cost(program, first_knot)
    return None if cost is None else max(cost - _TAIL_COST_TOLERANCE * program.cutoff, 0.0)


def minimise_tail_cost(program: MixedIntegerRelaxation, first_knot: int) -> float | None:
    """Minimise the cost from a knot on over the linear relaxation.

    Returns:
        The minimum; 0 if the solver does not find it, None if the program is infeasible.
    """
    solver = create_lp_solver()
    solver.passModel(build_rows_model(program.model, relaxed=True))
    cost, constant = program.build_tail_cost(first_knot)
    solver.changeColsCost(len(cost), np.arange(len(cost), dtype=np.int32), cost)
    run_highs(solver)
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kInfeasible:
        return None if confirm_infeasible(solver) else 0.0
    if status != highspy.HighsModelStatus.kOptimal:
        return 0.0
    minimum = float(solver.getInfo().objective_function_value) - program.model.constant + constant
    return max(minimum, 0.0)


def truncate_task(task: WalkTask, length: int) -> WalkTask:
    """Return the first intervals of a task, without its goal, which is at the end."""
    arrays = {name: value[:length] for name, value in vars(task.reference).items()}
    reference = replace(task.reference, **arrays)
    return replace(task, knots=length, goal=Goal.anywhere(), reference=reference)


def truncate_bounds(bounds: VariableBounds, length: int) -> VariableBounds:
    """Return the bounds of the first intervals.

    What the velocities cost together stays: fewer of them cost no more.
    """
    states = _truncate_arrays(bounds, length, _STATE_FIELDS)
    by_interval = [name for name in vars(bounds) if name not in _STATE_FIELDS + _TOTAL_FIELDS]
    return _truncate_arrays(states, length - 1, tuple(by_interval))


def merge_prefix_bounds(bounds: VariableBounds, prefix_bounds: VariableBounds) -> VariableBounds:
    """Return the bounds of a motion with those of its first intervals replaced."""
    copies = {name: value.copy() for name, value in vars(bounds).items()}
    for name, value in vars(prefix_bounds).items():
        if name not in _TOTAL_FIELDS:  # that of the prefix is of its velocities only
            copies[name][: len(value)] = value
    return VariableBounds(**copies)


def _truncate_arrays(arrays: _T, last: int, names: tuple[str, ...]) -> _T:
    """Return the dataclass with the arrays of these names up to an index, which is included."""
    return replace(arrays, **{name: getattr(arrays, name)[: last + 1] for name in names})
