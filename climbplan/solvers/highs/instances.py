"""HiGHS: mixed-integer linear and convex quadratic programs, and both by outer approximation.

HiGHS supports no mixed-integer quadratic programs, cones or indicators, and answers an unsupported
model with zeros. Return codes and the validity of values are therefore checked. With binaries and a
quadratic cost (or balls), each square of the cost gets an epigraph with tangents (Duran and
Grossmann 1986). A mixed-integer linear program gives a bound and binaries, the convex program at
those binaries gives an incumbent, and both give new tangents until bound and incumbent meet.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import highspy
import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.box import propagate_box
from climbplan.program.instance import Instance
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.highs.model import (
    SolverAbandoned,
    build_linear_model,
    build_quadratic_model,
    create_highs,
    run_highs,
)
from climbplan.solvers.result import (
    Answer,
    SolverResult,
    compute_zero_cost,
    judge_answer,
    relative_gap,
)
from climbplan.solvers.separable_cost import SeparableCost, factor_cost
from climbplan.solvers.weak_duality import compute_dual_bound

NAME = "highs"
TOLERANCE = 2e-6
_FIRST_TANGENTS = 9  # of each square, over its range
_ROUNDS = 200
_SOLVED = (highspy.HighsModelStatus.kOptimal,)
_INFEASIBLE = highspy.HighsModelStatus.kInfeasible
_UNBOUNDED_OR_INFEASIBLE = highspy.HighsModelStatus.kUnboundedOrInfeasible
_FEASIBLE_POINT = 2  # HiGHS's kSolutionStatusFeasible
_QUADRATIC_FEASIBILITY = 1e-7  # with smaller tolerances the quadratic solver fails more often
_MIN_TIME = 0.05  # least time for the program at the integers of the last answer [s]
_INNER_GAP = 0.5  # fraction of the gap that the linear programs may leave


@dataclass(frozen=True)
class _HighsAnswer:
    """One answer of HiGHS."""

    x: Array | None
    row_dual: Array | None  # gradient of the cost along rows, without binaries
    bound: float
    infeasible: bool
    nodes: int
    note: str
    is_left: bool = False  # whether the solver still runs and must not be used again


def solve_highs(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
) -> SolverResult:
    """Solve an instance of rows, binaries and balls with HiGHS on one thread.

    At a limit the incumbent and the bound are kept.

    Args:
        instance: Instance without choices, implications and products.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        tolerance: Largest violation of any constraint.

    Raises:
        UsageError: The instance has other features and has to be reformulated first.
    """
    supported = {"integers", "balls", "cones", "integers beyond 0 and 1"}
    unsupported = instance.features - supported
    if unsupported:
        raise UsageError(
            f"{instance.name}: highs cannot hold {', '.join(sorted(unsupported))}: "
            "reformulate first"
        )
    begin = time.perf_counter()
    if (instance.lower > instance.upper).any() or (instance.row_lower > instance.row_upper).any():
        answer = Answer(None, np.inf, True, 0, 0.0, NAME, ("infeasible: bounds cross",))
        return judge_answer(instance, answer, gap, tolerance)
    if not instance.integer.any() and "balls" not in instance.features:
        result = judge_answer(
            instance, _solve_continuous(instance, begin, time_limit), gap, tolerance
        )
        # HiGHS's quadratic solver sometimes fails on small singular programs, or stops early.
        if result.status in ("optimal", "infeasible") or not instance.P.count_nonzero():
            return result
    answer = _solve_by_outer_approximation(instance, gap, begin, time_limit, tolerance)
    return judge_answer(instance, answer, gap, tolerance)


def save_highs_model(instance: Instance, path: Path) -> None:
    """Write rows, binaries and the quadratic cost as .lp or .mps for other solvers.

    Variables are x<i> and rows row<k>, in order of the instance.

    Raises:
        UsageError: The suffix or folder is unknown, or HiGHS does not support the form.
    """
    if path.suffix not in (".lp", ".mps") or not path.parent.is_dir():
        raise UsageError(f"{path}: expected .lp or .mps in a directory that exists")
    if instance.features - {"integers"}:
        kinds = ", ".join(sorted(instance.features - {"integers"}))
        raise UsageError(f"{instance.name}: {kinds} cannot be written, reformulate first")
    solver = create_highs()
    solver.passModel(_build_model(instance))
    for i in range(instance.size):
        solver.passColName(i, f"x{i}")
    for k in range(instance.A.shape[0]):
        solver.passRowName(k, f"row{k}")
    if solver.writeModel(str(path)) == highspy.HighsStatus.kError:
        raise UsageError(f"{path}: cannot be written")


def _build_model(instance: Instance) -> Any:
    """Build the HiGHS model of an instance."""
    lp = build_linear_model(
        instance.q,
        sparse.csr_matrix(instance.A),
        constant=instance.constant,
        lower=instance.lower,
        upper=instance.upper,
        integer=instance.integer,
        row_lower=instance.row_lower,
        row_upper=instance.row_upper,
    )
    return build_quadratic_model(lp, instance.P) if instance.P.count_nonzero() else lp


def _run_solver(solver: Any, mixed: bool, time_left: float = np.inf) -> _HighsAnswer:
    """Run HiGHS on its model; its status counts only with a clean return code.

    `left` is the time [s] after which a mixed-integer search is abandoned.
    """
    try:
        code = run_highs(solver, deadline=time.monotonic() + time_left if mixed else np.inf)
    except SolverAbandoned as behind:
        return _HighsAnswer(behind.x, None, behind.bound, False, 0, f"HiGHS: {behind}", True)
    status = solver.getModelStatus()
    note = f"HiGHS {solver.version()}: {solver.modelStatusToString(status)}"
    if code == highspy.HighsStatus.kError:
        return _HighsAnswer(None, None, -np.inf, False, 0, f"{note} (refused)")
    if status == _UNBOUNDED_OR_INFEASIBLE:
        solver.setOptionValue("presolve", "off")
        run_highs(solver)
        status = solver.getModelStatus()
        solver.setOptionValue("presolve", "choose")
    info, solution = solver.getInfo(), solver.getSolution()
    feasible = info.primal_solution_status == _FEASIBLE_POINT and solution.value_valid
    x = np.array(solution.col_value) if feasible else None
    dual = np.array(solution.row_dual) if solution.dual_valid and not mixed else None
    bound = float(info.mip_dual_bound) if mixed else -np.inf
    if not mixed and status in _SOLVED:
        bound = float(info.objective_function_value)
    nodes = int(max(info.mip_node_count, 0)) if mixed else int(info.simplex_iteration_count)
    infeasible = status == _INFEASIBLE
    return _HighsAnswer(x, dual, np.inf if infeasible else bound, infeasible, nodes, note)


def _solve_continuous(instance: Instance, begin: float, time_limit: float) -> Answer:
    """Solve a linear or convex quadratic program; its bound is computed from the multipliers."""
    solver = create_highs(time_limit)
    if instance.P.count_nonzero():
        solver.setOptionValue("primal_feasibility_tolerance", _QUADRATIC_FEASIBILITY)
    solver.passModel(_build_model(instance))
    answer = _run_solver(solver, mixed=False)
    bound = np.inf if answer.infeasible else -np.inf
    if answer.x is not None and answer.row_dual is not None:
        bound = compute_dual_bound(instance, answer.x, -answer.row_dual)
    duration = time.perf_counter() - begin
    return Answer(answer.x, bound, answer.infeasible, answer.nodes, duration, NAME, (answer.note,))


class _OuterApproximation:
    """The linear model of rows and tangents: x, then one epigraph for each square."""

    def __init__(self, instance: Instance, cost: SeparableCost) -> None:
        """Build the model without tangents."""
        self.instance, self.cost = instance, cost
        n, S = instance.size, len(cost.offset)
        self.size = n + S
        A = sparse.csr_matrix(instance.A)
        rows = sparse.csr_matrix((A.data, A.indices, A.indptr), shape=(A.shape[0], n + S))
        self.lp = build_linear_model(
            np.concatenate([cost.slope, np.ones(S)]),
            rows,
            constant=cost.constant,
            lower=np.concatenate([instance.lower, np.zeros(S)]),
            upper=np.concatenate([instance.upper, np.full(S, np.inf)]),
            integer=np.concatenate([instance.integer, np.zeros(S, bool)]),
            row_lower=instance.row_lower,
            row_upper=instance.row_upper,
        )

    def build_square_tangents(self, u: Array) -> tuple[sparse.csr_matrix, Array]:
        """Return tangents of the squares at u^0 (S,), as rows and lower ends.

        They are t_j - u_j^0 U_j x >= u_j^0 offset_j - 1/2 u_j^0^2.
        """
        S = len(u)
        rows = sparse.hstack([-(sparse.diags(u) @ self.cost.U), sparse.identity(S)]).tocsr()
        return rows, u * self.cost.offset - 0.5 * u**2

    def build_ball_tangents(self, x: Array) -> tuple[sparse.csr_matrix, Array]:
        """Return tangents of the balls that x violates, as rows and lower ends."""
        blocks, ends = [sparse.csr_matrix((0, self.size))], [np.zeros(0)]
        for balls in self.instance.balls:
            v = balls.vectors(x)
            length = np.linalg.norm(v, axis=1)
            violated = np.flatnonzero((length > balls.limits(x)) & (length > 0))
            d = v.shape[1]
            for k in violated:
                direction = v[k] / length[k]
                normal = -direction @ balls.F[k * d : (k + 1) * d].toarray()
                if balls.slope is not None:
                    normal += balls.slope[[k]].toarray()[0]
                row = sparse.csr_matrix(normal)
                blocks.append(
                    sparse.csr_matrix((row.data, row.indices, row.indptr), shape=(1, self.size))
                )
                ends.append(np.array([direction @ balls.f[k] - balls.radius[k]]))
        return sparse.vstack(blocks).tocsr(), np.concatenate(ends)


def _add_first_tangents(solver: Any, approximation: _OuterApproximation) -> None:
    """Add tangents of the squares, spread over the ranges of these."""
    cost = approximation.cost
    reach = propagate_box(approximation.instance).interval(cost.U)
    low, high = reach.lower + cost.offset, reach.upper + cost.offset
    bounded = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(bounded, low, 0.0), np.where(bounded, high, 0.0)
    for fraction in np.linspace(0.0, 1.0, _FIRST_TANGENTS):
        _add_rows(solver, *approximation.build_square_tangents(low + fraction * (high - low)))


def _solve_by_outer_approximation(
    instance: Instance, gap: float, begin: float, time_limit: float, tolerance: float
) -> Answer:
    """Alternate linear and convex programs until bound and incumbent meet."""
    cost, zero_cost = factor_cost(instance), compute_zero_cost(instance)
    approximation = _OuterApproximation(instance, cost)
    solver = create_highs(time_limit, _INNER_GAP * gap)
    solver.passModel(approximation.lp)
    if len(cost.offset):
        _add_first_tangents(solver, approximation)
    linear = not len(cost.offset) and "balls" not in instance.features
    incumbent: Array | None = None
    best, bound, nodes, note = np.inf, -np.inf, 0, ""
    completed_integers: set[bytes] = set()
    num_rounds = 0
    infeasible = is_left = False
    while num_rounds < _ROUNDS:
        num_rounds += 1
        time_left = time_limit - (time.perf_counter() - begin)
        if time_left <= 0:
            break
        if np.isfinite(time_left):
            solver.setOptionValue("time_limit", float(solver.getRunTime() + time_left))
        answer = _run_solver(solver, bool(instance.integer.any()), time_left)
        nodes += answer.nodes
        note, is_left = answer.note, answer.is_left
        if answer.infeasible:
            # Tangents cut off no incumbent: with one, this is rounding and proves nothing.
            infeasible = incumbent is None
            break
        bound = max(bound, answer.bound)
        if answer.x is None:
            break
        x = answer.x[: instance.size]
        time_left = time_limit - (time.perf_counter() - begin)
        completion = _complete_integers(instance, x, completed_integers, linear, time_left)
        for candidate in (x, completion):
            if candidate is None or instance.violation(candidate) > tolerance:
                continue
            if (value := instance.objective(candidate)) < best:
                incumbent, best = candidate, value
        if linear or is_left or relative_gap(best, bound, zero_cost) <= gap:
            break
        for point in (x, completion):
            if point is not None:
                if len(cost.offset):
                    _add_rows(solver, *approximation.build_square_tangents(cost.values(point)))
                _add_rows(solver, *approximation.build_ball_tangents(point))
        if incumbent is not None:
            heights = 0.5 * cost.values(incumbent) ** 2
            start = highspy.HighsSolution()
            start.col_value = list(np.concatenate([incumbent, heights]))
            solver.setSolution(start)
    duration = time.perf_counter() - begin
    row_count = "" if is_left else f", {solver.getNumRow()} rows"
    log = (note, f"{num_rounds} linear programs{row_count}")
    return Answer(incumbent, bound, infeasible, nodes, duration, NAME, log)


def _add_rows(solver: Any, rows: sparse.csr_matrix, lower: Array) -> None:
    """Add rows with lower ends to the solver's model."""
    count = len(lower)
    if count:
        upper = np.full(count, highspy.kHighsInf)
        start, index = rows.indptr[:-1].astype(np.int32), rows.indices.astype(np.int32)
        solver.addRows(count, lower, upper, rows.nnz, start, index, rows.data)


def _complete_integers(
    instance: Instance, x: Array, completed_integers: set[bytes], linear: bool, time_left: float
) -> Array | None:
    """Return the best point with the binaries of x, once for each set of binaries."""
    integers = np.round(x[instance.integer])
    key = integers.astype(np.int8).tobytes()
    if key in completed_integers:
        return None
    completed_integers.add(key)
    lower, upper = instance.lower.copy(), instance.upper.copy()
    lower[instance.integer] = upper[instance.integer] = integers
    no_integer = np.zeros(instance.size, bool)
    fixed_instance = replace(instance, lower=lower, upper=upper, integer=no_integer)
    if linear:
        return _solve_continuous(fixed_instance, time.perf_counter(), max(time_left, _MIN_TIME)).x
    return solve_convex(fixed_instance, "clarabel").x
