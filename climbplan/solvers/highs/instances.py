"""HiGHS: mixed-integer linear programs, convex quadratic ones, and by outer approximation both.

HiGHS has no mixed-integer quadratic programs, cones or indicators, and answers a model that it
cannot hold with zeros: return codes and the validity of values are looked at. With binaries and a
quadratic cost (or balls), each square of the cost gets an epigraph with tangents (Duran and
Grossmann 1986): a mixed-integer linear program gives a bound and binaries, the convex program at
those binaries an incumbent, both give new tangents, until bound and incumbent meet.
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
from climbplan.program.box import propagated_box
from climbplan.program.instance import Instance
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.highs.model import (
    LeftBehind,
    highs,
    linear_model,
    quadratic_model,
    run_highs,
)
from climbplan.solvers.result import Answer, SolverResult, judged, relative_gap
from climbplan.solvers.separable_cost import SeparableCost, separable_cost
from climbplan.solvers.weak_duality import weak_dual

NAME = "highs"
TOLERANCE = 2e-6
_FIRST_TANGENTS = 9  # of each square, over its range
_ROUNDS = 200
_SOLVED = (highspy.HighsModelStatus.kOptimal,)
_INFEASIBLE = highspy.HighsModelStatus.kInfeasible
_VAGUE = highspy.HighsModelStatus.kUnboundedOrInfeasible
_FEASIBLE_POINT = 2  # HiGHS's kSolutionStatusFeasible
_QUADRATIC_FEASIBILITY = 1e-7  # asked for less, the quadratic solver gives up more often
_LEAST_TIME = 0.05  # [s] for the program at the integers of the last answer
_INNER_GAP = 0.5  # share of the gap asked for that the linear programs may leave


@dataclass(frozen=True)
class _Linear:
    """One answer of HiGHS."""

    x: Array | None
    row_dual: Array | None  # gradient of the cost along rows, without binaries
    bound: float
    infeasible: bool
    nodes: int
    note: str
    is_left: bool = False  # nothing may be done with the solver any more


def solve_highs(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
) -> SolverResult:
    """Solve an instance of rows, binaries and balls with HiGHS on one thread.

    gap: relative gap to prove. time_limit: [s]. tolerance: largest violation accepted. At a limit
    the incumbent and the bound are kept. Raises UsageError for choices, implications and products:
    reformulate first.
    """
    foreign = instance.features - {"integers", "balls"}
    if foreign:
        raise UsageError(
            f"{instance.name}: highs cannot hold {', '.join(sorted(foreign))}: reformulate first"
        )
    begin = time.perf_counter()
    if (instance.lower > instance.upper).any() or (instance.row_lower > instance.row_upper).any():
        answer = Answer(None, np.inf, True, 0, 0.0, NAME, ("infeasible: bounds cross",))
        return judged(instance, answer, gap, tolerance)
    if not instance.integer.any() and "balls" not in instance.features:
        result = judged(instance, _continuous(instance, begin, time_limit), gap, tolerance)
        # HiGHS's quadratic solver refuses one in ten small singular programs, or stops early.
        if result.status in ("optimal", "infeasible") or not instance.P.count_nonzero():
            return result
    answer = _outer_approximation(instance, gap, begin, time_limit, tolerance)
    return judged(instance, answer, gap, tolerance)


def save_highs_model(instance: Instance, path: Path) -> None:
    """Write rows, binaries and the quadratic cost as .lp or .mps for other solvers.

    Variables are x<i> and rows row<k>, in order of the instance.

    Raises UsageError for another suffix or place, or for a form that HiGHS cannot hold.
    """
    if path.suffix not in (".lp", ".mps") or not path.parent.is_dir():
        raise UsageError(f"{path}: expected .lp or .mps in a directory that exists")
    if instance.features - {"integers"}:
        kinds = ", ".join(sorted(instance.features - {"integers"}))
        raise UsageError(f"{instance.name}: {kinds} cannot be written, reformulate first")
    solver = highs()
    solver.passModel(_whole_model(instance))
    for i in range(instance.size):
        solver.passColName(i, f"x{i}")
    for k in range(instance.A.shape[0]):
        solver.passRowName(k, f"row{k}")
    if solver.writeModel(str(path)) == highspy.HighsStatus.kError:
        raise UsageError(f"{path}: cannot be written")


def _whole_model(instance: Instance) -> Any:
    lp = linear_model(
        instance.q,
        instance.constant,
        instance.lower,
        instance.upper,
        instance.integer,
        sparse.csr_matrix(instance.A),
        instance.row_lower,
        instance.row_upper,
    )
    return quadratic_model(lp, instance.P) if instance.P.count_nonzero() else lp


def _run(solver: Any, mixed: bool, left: float = np.inf) -> _Linear:
    """Solve what the solver holds; its word counts only with a clean return code and status.

    left: [s] after which a mixed-integer search is left behind.
    """
    try:
        code = run_highs(solver, deadline=time.monotonic() + left if mixed else np.inf)
    except LeftBehind as behind:
        return _Linear(behind.x, None, behind.bound, False, 0, f"HiGHS: {behind}", True)
    status = solver.getModelStatus()
    note = f"HiGHS {solver.version()}: {solver.modelStatusToString(status)}"
    if code == highspy.HighsStatus.kError:
        return _Linear(None, None, -np.inf, False, 0, f"{note} (refused)")
    if status == _VAGUE:
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
    return _Linear(x, dual, np.inf if infeasible else bound, infeasible, nodes, note)


def _continuous(instance: Instance, begin: float, time_limit: float) -> Answer:
    """A linear or convex quadratic program; the bound is computed from the multipliers."""
    solver = highs(time_limit)
    if instance.P.count_nonzero():
        solver.setOptionValue("primal_feasibility_tolerance", _QUADRATIC_FEASIBILITY)
    solver.passModel(_whole_model(instance))
    found = _run(solver, mixed=False)
    bound = np.inf if found.infeasible else -np.inf
    if found.x is not None and found.row_dual is not None:
        bound = weak_dual(instance, found.x, -found.row_dual)
    spent = time.perf_counter() - begin
    return Answer(found.x, bound, found.infeasible, found.nodes, spent, NAME, (found.note,))


class _Tangents:
    """The linear model of rows and tangents: x, then one epigraph for each square."""

    def __init__(self, instance: Instance, cost: SeparableCost) -> None:
        self.instance, self.cost = instance, cost
        n, S = instance.size, len(cost.offset)
        self.size = n + S
        A = sparse.csr_matrix(instance.A)
        wide = sparse.csr_matrix((A.data, A.indices, A.indptr), shape=(A.shape[0], n + S))
        self.lp = linear_model(
            np.concatenate([cost.slope, np.ones(S)]),
            cost.constant,
            np.concatenate([instance.lower, np.zeros(S)]),
            np.concatenate([instance.upper, np.full(S, np.inf)]),
            np.concatenate([instance.integer, np.zeros(S, bool)]),
            wide,
            instance.row_lower,
            instance.row_upper,
        )

    def square_rows(self, u: Array) -> tuple[sparse.csr_matrix, Array]:
        """t_j - u_j^0 U_j x >= u_j^0 offset_j - 1/2 u_j^0^2 at u^0 (S,): rows and lower ends."""
        S = len(u)
        rows = sparse.hstack([-(sparse.diags(u) @ self.cost.U), sparse.identity(S)]).tocsr()
        return rows, u * self.cost.offset - 0.5 * u**2

    def ball_rows(self, x: Array) -> tuple[sparse.csr_matrix, Array]:
        """Tangent half-spaces of the balls that x lies outside of, as rows >= lower ends."""
        parts, ends = [sparse.csr_matrix((0, self.size))], [np.zeros(0)]
        for balls in self.instance.balls:
            v = balls.vectors(x)
            length = np.linalg.norm(v, axis=1)
            out = np.flatnonzero((length > balls.radius) & (length > 0))
            d = v.shape[1]
            for k in out:
                direction = v[k] / length[k]
                row = sparse.csr_matrix(-direction @ balls.F[k * d : (k + 1) * d].toarray())
                parts.append(
                    sparse.csr_matrix((row.data, row.indices, row.indptr), shape=(1, self.size))
                )
                ends.append(np.array([direction @ balls.f[k] - balls.radius[k]]))
        return sparse.vstack(parts).tocsr(), np.concatenate(ends)


def _outer_approximation(
    instance: Instance, gap: float, begin: float, time_limit: float, tolerance: float
) -> Answer:
    cost = separable_cost(instance)
    tangents = _Tangents(instance, cost)
    solver = highs(time_limit, _INNER_GAP * gap)
    solver.passModel(tangents.lp)
    if len(cost.offset):
        box = propagated_box(instance)
        reach = box.interval(cost.U)
        low, high = reach.lower + cost.offset, reach.upper + cost.offset
        bounded = np.isfinite(low) & np.isfinite(high)
        for share in np.linspace(0.0, 1.0, _FIRST_TANGENTS):
            low, high = np.where(bounded, low, 0.0), np.where(bounded, high, 0.0)
            _add(solver, *tangents.square_rows(low + share * (high - low)))
    linear = not len(cost.offset) and "balls" not in instance.features
    incumbent: Array | None = None
    best, bound, nodes, note = np.inf, -np.inf, 0, ""
    tried: set[bytes] = set()
    rounds = 0
    infeasible = is_left = False
    while rounds < _ROUNDS:
        rounds += 1
        left = time_limit - (time.perf_counter() - begin)
        if left <= 0:
            break
        if np.isfinite(left):
            solver.setOptionValue("time_limit", float(solver.getRunTime() + left))
        found = _run(solver, bool(instance.integer.any()), left)
        nodes += found.nodes
        note, is_left = found.note, found.is_left
        if found.infeasible:
            # Tangents cut off no incumbent: with one, this is rounding and proves nothing.
            infeasible = incumbent is None
            break
        bound = max(bound, found.bound)
        if found.x is None:
            break
        x = found.x[: instance.size]
        left = time_limit - (time.perf_counter() - begin)
        completed = _completed(instance, x, tried, linear, left)
        for candidate in (x, completed):
            if candidate is None or instance.violation(candidate) > tolerance:
                continue
            if (value := instance.objective(candidate)) < best:
                incumbent, best = candidate, value
        if linear or is_left or relative_gap(best, bound) <= gap:
            break
        for point in (x, completed):
            if point is not None:
                if len(cost.offset):
                    _add(solver, *tangents.square_rows(cost.values(point)))
                _add(solver, *tangents.ball_rows(point))
        if incumbent is not None:
            heights = 0.5 * cost.values(incumbent) ** 2
            start = highspy.HighsSolution()
            start.col_value = list(np.concatenate([incumbent, heights]))
            solver.setSolution(start)
    spent = time.perf_counter() - begin
    count = "" if is_left else f", {solver.getNumRow()} rows"
    log = (note, f"{rounds} linear programs{count}")
    return Answer(incumbent, bound, infeasible, nodes, spent, NAME, log)


def _add(solver: Any, rows: sparse.csr_matrix, lower: Array) -> None:
    count = len(lower)
    if count:
        upper = np.full(count, highspy.kHighsInf)
        start, index = rows.indptr[:-1].astype(np.int32), rows.indices.astype(np.int32)
        solver.addRows(count, lower, upper, rows.nnz, start, index, rows.data)


def _completed(
    instance: Instance, x: Array, tried: set[bytes], linear: bool, left: float
) -> Array | None:
    """The best point with the binaries of x, once for each set of binaries; left: [s] for it."""
    given = np.round(x[instance.integer])
    key = given.astype(np.int8).tobytes()
    if key in tried:
        return None
    tried.add(key)
    lower, upper = instance.lower.copy(), instance.upper.copy()
    lower[instance.integer] = upper[instance.integer] = given
    none = np.zeros(instance.size, bool)
    pinned = replace(instance, lower=lower, upper=upper, integer=none)
    if linear:
        return _continuous(pinned, time.perf_counter(), max(left, _LEAST_TIME)).x
    return solve_convex(pinned, "clarabel").x
