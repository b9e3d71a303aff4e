"""`climbplan.CVXPY`: problems of CVXPY, solved by the built-in branch and bound.

    problem.solve(solver=climbplan.CVXPY(gap=1e-4))

Mixed-integer linear and convex quadratic programs, also with second-order cones. Problems without
integers are solved by Clarabel, with dual values.
"""

from __future__ import annotations

import hashlib
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import clarabel
import numpy as np
from cvxpy import settings
from cvxpy.error import SolverError
from cvxpy.reductions.solution import Solution, failure_solution
from cvxpy.reductions.solvers import utilities
from cvxpy.reductions.solvers.conic_solvers.conic_solver import ConicSolver
from scipy import sparse

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.progress_display import show_progress
from climbplan.arrays import Array
from climbplan.certificates.certificate import Certificate
from climbplan.certificates.checker import check
from climbplan.errors import UsageError
from climbplan.program.box import propagate_box
from climbplan.program.cvxpy_form import NAME, ConicForm, build_conic_instance
from climbplan.program.instance import Instance
from climbplan.progress import INTERVAL_VARIABLE
from climbplan.solvers.highs.instances import solve_highs
from climbplan.solvers.mixed_integer.certification import certify_without_search
from climbplan.solvers.mixed_integer.level_set import UnboundedRelaxation, bound_variables
from climbplan.solvers.mixed_integer.method import WarmStartedTree
from climbplan.solvers.mixed_integer.outer_approximation import ConicSearch
from climbplan.solvers.mixed_integer.unbounded import examine_unbounded
from climbplan.solvers.result import FEASIBILITY, SolverResult, relative_gap
from climbplan.store.certificate_file import write_certificates
from climbplan.store.certified import CertifiedRow, CertifiedRows

_SPEC = "kind: program\nsolver: {{gap: {gap:g}}}\n"  # of a certificate file
_CONTINUOUS = {
    clarabel.SolverStatus.Solved: settings.OPTIMAL,
    clarabel.SolverStatus.AlmostSolved: settings.OPTIMAL_INACCURATE,
    clarabel.SolverStatus.PrimalInfeasible: settings.INFEASIBLE,
    clarabel.SolverStatus.AlmostPrimalInfeasible: settings.INFEASIBLE_INACCURATE,
    clarabel.SolverStatus.DualInfeasible: settings.UNBOUNDED,
    clarabel.SolverStatus.AlmostDualInfeasible: settings.UNBOUNDED_INACCURATE,
    clarabel.SolverStatus.MaxIterations: settings.USER_LIMIT,
    clarabel.SolverStatus.MaxTime: settings.USER_LIMIT,
}


@dataclass(frozen=True)
class SolverSettings:
    """Settings of `CVXPY`, each also an option of `problem.solve`."""

    gap: float = 1e-4  # relative, to prove
    absolute_gap: float = 1e-7  # in the unit of the objective, which is enough as well
    time_limit: float = np.inf  # [s]
    tolerance: float = FEASIBILITY  # largest violation of a row
    certificate: str | Path | None = None  # file for the proof of the bound

    def __post_init__(self) -> None:
        """Raise SolverError for a value that is no number >= 0, or no path."""
        for name in ("gap", "absolute_gap", "time_limit", "tolerance"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= 0:
                hint = "; leave it out for none" if name == "time_limit" else ""
                raise SolverError(f"{NAME}: {name}={value!r}: expected a number >= 0{hint}")
        if self.tolerance == 0:
            raise SolverError(f"{NAME}: tolerance=0: expected a number > 0, such as {FEASIBILITY}")
        if not isinstance(self.certificate, (str, Path, type(None))):
            raise SolverError(f"{NAME}: certificate={self.certificate!r}: expected a path")

    def update(self, options: Mapping[str, Any]) -> SolverSettings:
        """Return the settings with options of one call.

        Raises:
            SolverError: An option is not known, or its value is none of its kind.
        """
        option_names = {field.name for field in fields(self)}
        options_given = {key: value for key, value in options.items() if key != "use_quad_obj"}
        if unknown := sorted(set(options_given) - option_names):
            raise SolverError(
                f"{NAME}: no option {', '.join(unknown)}: expected some of "
                + ", ".join(sorted(option_names))
            )
        return replace(self, **options_given)


class CVXPY(ConicForm):
    """A solver object for `problem.solve(solver=...)` of CVXPY.

    The status is `optimal` where the gap is proved, `user_limit` with an incumbent at a limit, and
    `infeasible` where that is proved. `problem.solver_stats.extra_stats` has `bound` and `gap`
    (of the minimisation, so of the negated objective of a maximisation), `nodes`, `status` and
    `certificate`, which is None, with a warning, where no proof can be written. A problem with
    parameters (DPP) that is solved again starts from the last tree; each answer has its own proof.
    The bound of a problem without integers is the dual value of Clarabel, as exact as its
    tolerances.
    Variables without bounds get those of an incumbent's level set.

    Args:
        options: Fields of `SolverSettings`: gap, absolute_gap, time_limit [s], tolerance,
            certificate. Options of `problem.solve` override them.

    Raises:
        SolverError: An option is not known, or its value is none of its kind.
    """

    def __init__(self, **options: Any) -> None:
        self.settings = SolverSettings().update(options)

    def __eq__(self, solver: object) -> bool:
        """Return whether CVXPY may reuse what it has prepared for another object."""
        return isinstance(solver, CVXPY) and solver.settings == self.settings

    def __hash__(self) -> int:
        return hash(self.settings)

    def solve_via_data(
        self,
        data: dict[str, Any],
        warm_start: bool,
        verbose: bool,
        solver_opts: dict[str, Any],
        solver_cache: dict[str, Any] | None = None,
    ) -> Solution:
        """Solve the numbers of a problem; CVXPY calls this.

        Args:
            data: What `apply` returned.
            warm_start: Whether to start from the tree of the last solve.
            verbose: Whether to print the log, and before it lines of progress on standard error,
                which the environment variable CLIMBPLAN_PROGRESS_SECONDS also turns on.
            solver_opts: Options of this call.
            solver_cache: Trees of the problem.

        Raises:
            SolverError: An option is not known, or the problem has no bounds where the tree needs
                them.
            UsageError: CLIMBPLAN_PROGRESS_SECONDS is no positive number.
        """
        chosen = self.settings.update(solver_opts)
        if not data[settings.BOOL_IDX] and not data[settings.INT_IDX]:
            if chosen.certificate is not None:
                raise SolverError(f"{NAME}: certificates are made of problems with integers")
            return _solve_continuous(data, chosen, verbose)
        begin = time.perf_counter()
        cache = {} if solver_cache is None or not warm_start else solver_cache
        shows_lines = verbose or INTERVAL_VARIABLE in os.environ
        with ctrl_c_insists(), show_progress(shows_lines) as report:
            report("solve", 0.0)
            solved = _solve_integers(build_conic_instance(data, "cvxpy"), chosen, cache)
        if chosen.certificate is not None:
            _write_certificate(solved, chosen)
        if verbose:
            print("\n".join(solved.result.log))
        return _build_solution(solved, chosen, time.perf_counter() - begin)

    def invert(self, solution: Solution, inverse_data: Any) -> Solution:
        """Map a solution over columns back to the problem's variables and constraints."""
        primal = solution.primal_vars
        if solution.status not in settings.SOLUTION_PRESENT or primal is None:
            return failure_solution(solution.status, solution.attr)
        duals: dict[Any, Any] = {}
        if solution.dual_vars is not None:
            z, num_equations = solution.dual_vars["z"], inverse_data[ConicSolver.DIMS].zero
            for multipliers, kind in (
                (z[:num_equations], "EQ_CONSTR"),
                (z[num_equations:], "NEQ_CONSTR"),
            ):
                constraints = inverse_data[getattr(self, kind)]
                duals |= utilities.get_dual_values(
                    multipliers, utilities.extract_dual_value, constraints
                )
        columns = {inverse_data[self.VAR_ID]: primal["x"]}
        return Solution(solution.status, solution.opt_val, columns, duals, solution.attr)


@dataclass(frozen=True)
class _Solved:
    """The bounded instance, its result, its proof, and what an unbounded relaxation leaves."""

    instance: Instance
    result: SolverResult
    certificate: Certificate | None = None
    unbounded_status: str | None = None  # of CVXPY


def _solve_integers(instance: Instance, chosen: SolverSettings, cache: dict[str, Any]) -> _Solved:
    """Solve by the search of the last solve where there is one of the same shape.

    Raises:
        SolverError: A certificate is required and a direction without cost is not bounded.
    """
    begin = time.perf_counter()
    try:
        if chosen.certificate is not None:
            return _solve_with_proof(instance, chosen, cache, begin)
        result = _run_tree(instance, chosen, cache, begin)
    except UsageError as error:
        raise SolverError(f"{NAME}: {error}") from error
    is_over = _compute_time_left(chosen, begin) <= 0.0
    if result.status in ("optimal", "infeasible") or is_over:
        return _Solved(instance, result)
    # Nodes may stay open by rounding errors or for want of bounds; trees of cones close them
    search = _select_search(instance, chosen, cache, ConicSearch)
    retry = search.solve(instance, _compute_time_left(chosen, begin))
    if search.is_relaxation_unbounded:
        return _examine_unbounded(instance, retry, _compute_time_left(chosen, begin))
    return _Solved(instance, retry if _is_better(retry, result) else result)


def _solve_with_proof(
    instance: Instance, chosen: SolverSettings, cache: dict[str, Any], begin: float
) -> _Solved:
    """Solve by the tree that writes certificates.

    Raises:
        UsageError: A direction without cost is not bounded.
    """
    # A certificate bounds the cost over a box, and an open side needs a slope of exactly 0
    time_left = _compute_time_left(chosen, begin)
    try:
        bounded = bound_variables(instance, integers_only=False, time_limit=time_left)
    except UnboundedRelaxation as error:
        return _examine_unbounded(instance, _build_unsolved(begin, str(error)), time_left)
    if bounded is None:
        certificate = certify_without_search(instance)
        is_proof = check(instance, certificate).bound == np.inf
        return _Solved(instance, _build_infeasible(begin), certificate if is_proof else None)
    box = propagate_box(bounded)
    has_open_sides = not np.isfinite(box.upper - box.lower).all()
    kind = ConicSearch if "cones" in bounded.features or has_open_sides else WarmStartedTree
    search = _select_search(bounded, chosen, cache, kind)
    result = search.solve(bounded, _compute_time_left(chosen, begin))
    is_open = result.status not in ("optimal", "infeasible")
    if kind is WarmStartedTree and is_open and _compute_time_left(chosen, begin) > 0.0:
        # Nodes may stay open by rounding errors; trees of cones close them
        conic = _select_search(bounded, chosen, cache, ConicSearch)
        retry = conic.solve(bounded, _compute_time_left(chosen, begin))
        if _is_better(retry, result):
            search, result = conic, retry
    certificate = search.certificate
    is_proof = certificate is not None and (certificate.bound > -np.inf or not has_open_sides)
    return _Solved(bounded, result, certificate if is_proof else None)


def _is_better(retry: SolverResult, result: SolverResult) -> bool:
    """Return whether a second search has an optimum, or a point that is no worse than the first."""
    if retry.objective is None or result.objective is None:
        return result.objective is None
    return retry.status == "optimal" or retry.objective <= result.objective


def _run_tree(
    instance: Instance, chosen: SolverSettings, cache: dict[str, Any], begin: float
) -> SolverResult:
    """Solve by the tree that suits the instance: `limit` where it needs bounds."""
    time_left = _compute_time_left(chosen, begin)
    if instance.balls:
        return _build_unsolved(begin, "cones")
    if not instance.P.count_nonzero():
        return solve_highs(instance, chosen.gap, time_left, chosen.tolerance)
    try:
        bounded = bound_variables(instance, integers_only=True, time_limit=time_left)
        if bounded is None:
            return _build_infeasible(begin)
        search = _select_search(bounded, chosen, cache, WarmStartedTree)
        return search.solve(bounded, _compute_time_left(chosen, begin))
    except UsageError as error:
        return _build_unsolved(begin, str(error))


def _select_search(
    instance: Instance, chosen: SolverSettings, cache: dict[str, Any], kind: type
) -> Any:
    """Return the search of the last solve, or a new one where the shape is another."""
    rows = np.isfinite(np.stack([instance.row_lower, instance.row_upper])).tobytes()
    cones = [balls.f.shape for balls in instance.balls]
    key = (chosen, rows, str(cones), instance.integer.tobytes(), instance.A.indices.tobytes(), kind)
    shape, search = cache.get(NAME, (None, None))
    if shape != key:
        search = kind(chosen.gap, chosen.tolerance)
        search.proves = chosen.certificate is not None
        cache[NAME] = key, search
    return search


def _examine_unbounded(instance: Instance, result: SolverResult, time_left: float) -> _Solved:
    """Return the result of an instance whose relaxation is unbounded."""
    proof = examine_unbounded(instance, time_left)
    if proof.is_infeasible:
        return _Solved(instance, replace(result, status="infeasible", bound=np.inf))
    status = settings.UNBOUNDED if proof.is_unbounded else settings.INFEASIBLE_OR_UNBOUNDED
    return _Solved(instance, result, unbounded_status=status)


def _compute_time_left(chosen: SolverSettings, begin: float) -> float:
    """Return the time left [s]."""
    return max(chosen.time_limit - (time.perf_counter() - begin), 0.0)


def _build_unsolved(begin: float, why: str) -> SolverResult:
    """Return a result without a point."""
    infeasible = _build_infeasible(begin)
    return replace(infeasible, status="limit", bound=-np.inf, log=(why,))


def _build_infeasible(begin: float) -> SolverResult:
    """Return the result where no point is feasible before any search."""
    duration = time.perf_counter() - begin
    log = ("infeasible: the relaxation has no point",)
    return SolverResult("infeasible", None, None, None, np.inf, None, 0, duration, NAME, log)


def _build_solution(solved: _Solved, chosen: SolverSettings, duration: float) -> Solution:
    """Build what CVXPY reports.

    Raises:
        SolverError: A limit was reached without a feasible point.
    """
    result = solved.result
    statistics = {
        "bound": result.bound,
        "gap": result.gap,
        "nodes": result.nodes,
        "status": result.status,
        "certificate": solved.certificate,
    }
    attributes = {
        settings.SOLVE_TIME: duration,
        settings.NUM_ITERS: result.nodes,
        settings.EXTRA_STATS: statistics,
    }
    if result.x is None or result.objective is None:
        if result.status == "infeasible":
            return Solution(settings.INFEASIBLE, None, None, None, attributes)
        if solved.unbounded_status is not None:
            return Solution(solved.unbounded_status, None, None, None, attributes)
        raise SolverError(
            f"{NAME}: no feasible point within time_limit={chosen.time_limit:g} s: raise it "
            f"({'; '.join(result.log)})"
            if duration >= chosen.time_limit
            else f"{NAME}: no feasible point was found, and none was excluded "
            f"({'; '.join(result.log)})"
        )
    is_close = result.objective - result.bound <= chosen.absolute_gap
    status = settings.OPTIMAL if result.status == "optimal" or is_close else settings.USER_LIMIT
    return Solution(status, result.objective, {"x": result.x}, None, attributes)


def _solve_continuous(data: Mapping[str, Any], chosen: SolverSettings, verbose: bool) -> Solution:
    """Solve a problem without integers by Clarabel, on CVXPY's own rows, which give the duals."""
    q = np.asarray(data[settings.C], float).ravel()
    P = data.get(settings.P)
    P = sparse.csc_matrix((len(q), len(q))) if P is None else sparse.triu(P, format="csc")
    dims = data[ConicSolver.DIMS]
    cones: list[Any] = [clarabel.ZeroConeT(dims.zero), clarabel.NonnegativeConeT(dims.nonneg)]
    cones += [clarabel.SecondOrderConeT(int(size)) for size in dims.soc]
    options = clarabel.DefaultSettings()
    options.verbose = verbose
    if np.isfinite(chosen.time_limit):
        options.time_limit = chosen.time_limit
    A, b = sparse.csc_matrix(data[settings.A]), np.asarray(data[settings.B], float)
    answer = clarabel.DefaultSolver(P, q, A, b, cones, options).solve()
    constant = float(data[settings.OFFSET])
    value, bound = answer.obj_val + constant, answer.obj_val_dual + constant
    statistics = {"bound": bound, "gap": relative_gap(value, bound), "status": str(answer.status)}
    attributes = {
        settings.SOLVE_TIME: answer.solve_time,
        settings.NUM_ITERS: answer.iterations,
        settings.EXTRA_STATS: statistics,
    }
    status = _CONTINUOUS.get(answer.status, settings.SOLVER_ERROR)
    x: Array = np.array(answer.x)
    return Solution(status, value, {"x": x}, {"z": np.array(answer.z)}, attributes)


def _write_certificate(solved: _Solved, chosen: SolverSettings) -> None:
    """Write the proof of a bound, which `climbplan verify` checks without a solver.

    Raises:
        SolverError: The file cannot be written.
    """
    from climbplan.methods.certified_rows import is_weaker_than_search

    if solved.certificate is None or chosen.certificate is None:
        status = solved.unbounded_status or solved.result.status
        warnings.warn(
            f"{NAME}: no certificate was written to {chosen.certificate}: the status {status} "
            "is not proved by multipliers; bounds of all variables make a certificate possible",
            stacklevel=2,
        )
        return
    result, text = solved.result, _SPEC.format(gap=chosen.gap)
    proved = solved.certificate.bound
    if is_weaker_than_search(proved, result.bound, chosen.gap, chosen.absolute_gap):
        warnings.warn(
            f"{NAME}: the certificate proves a bound of {proved:.9g}, the search has "
            f"{result.bound:.9g}; `climbplan verify` confirms the former alone",
            stacklevel=2,
        )
    row = CertifiedRow(
        parameters=np.zeros(0),
        instance=solved.instance,
        certificate=solved.certificate,
        status=result.status,
        x=result.x,
        assignment=result.assignment,
    )
    certified = CertifiedRows(
        name="cvxpy",
        spec_text=text,
        spec_sha256=hashlib.sha256(text.encode()).hexdigest(),
        seed=0,
        problem="cvxpy",
        gap=chosen.gap,
        tolerance=chosen.tolerance,
        rows=(row,),
    )
    try:
        write_certificates(certified, Path(chosen.certificate))
    except UsageError as error:
        raise SolverError(f"{NAME}: {error}") from error
