"""Mixed-integer programs with second-order cones: a tree of cone programs, then master programs.

The tree (`conic_tree`) closes programs of some tens of integers. Where it does not within its
nodes, outer approximation goes on (Duran, Grossmann 1986): a master program has tangents in place
of the cones, and is solved by branch and bound, or by HiGHS where its cost is linear: its bound is
valid. The convex program at its integers gives an incumbent. Both points give new tangents, those
of the convex program's solution being all that its integers need. A quadratic cost with directions
that nothing bounds becomes a cone itself, so that its master programs are linear.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.certificates.certificate import Certificate
from climbplan.errors import UsageError
from climbplan.program.instance import Balls, Instance
from climbplan.progress import hide_searches, report_search
from climbplan.solvers.convex.clarabel import ClarabelSession
from climbplan.solvers.highs.instances import solve_highs
from climbplan.solvers.mixed_integer.certification import certify_splits, compute_proof_deadline
from climbplan.solvers.mixed_integer.conic_tree import ConicTree
from climbplan.solvers.mixed_integer.method import solve_mixed_integer
from climbplan.solvers.result import (
    FEASIBILITY,
    Answer,
    SolverResult,
    compute_closing_bound,
    judge_answer,
    relative_gap,
)
from climbplan.solvers.separable_cost import factor_cost

NAME = "branch-and-bound"
_MAX_ROUNDS = 200
_SHORTFALL = 1e-7  # relative amount by which leaves may fall short of the tree's bound
_MASTER_GAP = 0.3  # fraction of the gap that master programs may leave
_MASTER_TOLERANCE = 1e-6  # of rows at points that give integers and tangents only
_ACTIVE = 1e-6  # relative distance from a cone's boundary within which it gets a tangent
_TREE_NODES = 4000  # cone programs of the tree before master programs
_TREE_TIME = 0.5  # fraction of the time limit for them
_UNLIMITED = 10**9
_MAX_POINTS = 60  # of tangents that are kept for the next program


@dataclass
class ConicSearch:
    """Solves programs of one statement in turn, each from the integers and tangents of the last."""

    gap: float = 1e-4
    tolerance: float = FEASIBILITY
    points: list[Array] = field(default_factory=list)
    start: Array | None = None  # last incumbent
    proves: bool = False  # whether the tree alone solves, and writes a certificate
    certificate: Certificate | None = None  # of the last program
    is_relaxation_unbounded: bool = False  # of the last program

    def solve(self, instance: Instance, time_limit: float = np.inf) -> SolverResult:
        """Find the global optimum of an instance with integers and cones, without products.

        Variables need no bounds. Where the relaxation is unbounded the result is `limit`.

        Args:
            instance: The instance.
            time_limit: Time limit [s].
        """
        begin = time.perf_counter()
        deadline = begin + time_limit
        tree = ConicTree(instance, self.gap, self.tolerance, self.start)
        half = begin + _TREE_TIME * time_limit if np.isfinite(time_limit) else np.inf
        tree.run(deadline if self.proves else half, _UNLIMITED if self.proves else _TREE_NODES)
        self.is_relaxation_unbounded = tree.root == "unbounded"
        log: tuple[str, ...] = ()
        bound, incumbent, nodes = tree.bound, tree.incumbent, tree.num_nodes
        if self.proves:
            self.certificate = _certify(instance, tree, begin, deadline)
        elif not tree.is_finished and not self.is_relaxation_unbounded:
            bound, incumbent, nodes, log = self._solve_masters(instance, tree, deadline)
            cost = np.inf if incumbent is None else instance.objective(incumbent)
            if incumbent is None or relative_gap(cost, bound, tree.zero_cost) > self.gap:
                tree.run(deadline, _UNLIMITED)
                bound = max(bound, tree.bound)
                if tree.incumbent is not None:
                    incumbent = tree.incumbent
        self.start = incumbent if incumbent is not None else self.start
        infeasible = incumbent is None and tree.is_finished and bound == np.inf
        note = "the relaxation is unbounded" if self.is_relaxation_unbounded else tree.root
        answer = Answer(
            x=incumbent,
            bound=bound,
            infeasible=infeasible,
            nodes=nodes,
            time=time.perf_counter() - begin,
            solver=NAME,
            log=(note, f"{tree.num_nodes} cone programs", *log),
        )
        return judge_answer(instance, answer, self.gap, self.tolerance)

    def _solve_masters(
        self, instance: Instance, tree: ConicTree, deadline: float
    ) -> tuple[float, Array | None, int, tuple[str, ...]]:
        """Go on with master programs from a tree; return bound, incumbent, nodes and a log."""
        incumbent, best, bound, nodes = tree.incumbent, tree.cost, tree.bound, tree.num_nodes
        self.points += [x for x in (tree.root_solution, incumbent) if x is not None]
        num_rounds, completed, note = 0, set[bytes](), "linear masters"
        while num_rounds < _MAX_ROUNDS and (time_left := deadline - time.perf_counter()) > 0:
            num_rounds += 1
            with hide_searches():  # points of masters violate cones
                result = self._solve_master(instance, time_left)
            nodes += result.nodes
            bound = max(bound, result.bound)
            if result.x is None:
                note = result.log[-1] if result.log else result.status
                break
            completion = _complete(instance, result.x, completed)
            trials = [result.x] if completion is None else [result.x, completion]
            self.points += trials
            for point in trials:
                value = instance.objective(point)
                if value < best and instance.violation(point) <= self.tolerance:
                    incumbent, best = point, value
            report_search(best, bound)
            if relative_gap(best, bound, tree.zero_cost) <= self.gap:
                break
        del self.points[:-_MAX_POINTS]
        tree.offer(incumbent)
        return bound, incumbent, nodes, (note, f"{num_rounds} master programs, {nodes} nodes")

    def _solve_master(self, instance: Instance, time_limit: float) -> SolverResult:
        """Solve the program with tangents at all points; its bound holds for the instance."""
        gap, tolerance = _MASTER_GAP * self.gap, max(self.tolerance, _MASTER_TOLERANCE)
        master = _replace_cones(instance, self.points)
        if not instance.P.count_nonzero():
            return solve_highs(master, gap, time_limit, tolerance)
        try:
            return solve_mixed_integer(master, gap, time_limit, tolerance)
        except UsageError:  # a direction without cost is not bounded
            return self._solve_linear_master(instance, time_limit)

    def _solve_linear_master(self, instance: Instance, time_limit: float) -> SolverResult:
        """Solve the master program whose cost is a cone, too."""
        stated = _state_epigraph(instance)
        heights = [_compute_height(instance, x) for x in self.points]
        points = [np.append(x, t) for x, t in zip(self.points, heights, strict=True)]
        master = _replace_cones(stated, points)
        result = solve_highs(
            master, _MASTER_GAP * self.gap, time_limit, max(self.tolerance, _MASTER_TOLERANCE)
        )
        return replace(result, x=None if result.x is None else result.x[: instance.size])


def _certify(instance: Instance, tree: ConicTree, begin: float, deadline: float) -> Certificate:
    """Certify the bound of a tree, as far as it has come."""
    required_bound, cost = tree.bound, tree.cost
    if np.isfinite(cost):
        closed = compute_closing_bound(cost, tree.gap, tree.zero_cost)
        required_bound = min(closed, required_bound - _SHORTFALL * max(1.0, abs(required_bound)))
    proof_deadline = compute_proof_deadline(begin, deadline)
    return certify_splits(instance, tree.splits, required_bound, proof_deadline)


def solve_conic(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = FEASIBILITY,
) -> SolverResult:
    """Find the global optimum of one instance by `ConicSearch`."""
    return ConicSearch(gap, tolerance).solve(instance, time_limit)


def _compute_height(instance: Instance, x: Array) -> float:
    """Return 1/2 |u|^2 of `_state_epigraph` at x."""
    return float(0.5 * np.sum(factor_cost(instance).values(x) ** 2))


def _state_epigraph(instance: Instance) -> Instance:
    """Return the program: minimise t + s'x + c subject to |(u, t - 1/2)| <= t + 1/2.

    The cost of the instance is 1/2 |u|^2 + s'x + c with u = U x + o, and the cone states
    that t is at least 1/2 |u|^2.
    """
    squares, n = factor_cost(instance), instance.size
    column = sparse.csr_matrix(([1.0], ([0], [n])), shape=(1, n + 1))
    cone = Balls(
        F=sparse.vstack([_append_column(squares.U), column]).tocsr(),
        f=np.append(squares.offset, -0.5)[None],
        radius=np.array([0.5]),
        slope=column,
    )
    stated = tuple(
        replace(
            balls,
            F=_append_column(balls.F),
            slope=None if balls.slope is None else _append_column(balls.slope),
        )
        for balls in instance.balls
    )
    no_rows = replace(instance.implications, A=sparse.csr_matrix((0, n + 1)))
    return replace(
        instance,
        P=sparse.csc_matrix((n + 1, n + 1)),
        q=np.append(squares.slope, 1.0),
        constant=squares.constant,
        lower=np.append(instance.lower, 0.0),
        upper=np.append(instance.upper, np.inf),
        A=_append_column(instance.A),
        integer=np.append(instance.integer, False),
        balls=(*stated, cone),
        implications=no_rows,
    )


def _append_column(matrix: sparse.spmatrix) -> sparse.csr_matrix:
    """Return a matrix with a column of zeros."""
    return sparse.hstack([matrix, sparse.csr_matrix((matrix.shape[0], 1))]).tocsr()


def _complete(instance: Instance, x: Array, completed: set[bytes]) -> Array | None:
    """Return the best point with the integers of x; None if there is none, or it is known."""
    fixed = np.round(x[instance.integer])
    if fixed.tobytes() in completed:
        return None
    completed.add(fixed.tobytes())
    lower, upper = instance.lower.copy(), instance.upper.copy()
    lower[instance.integer] = upper[instance.integer] = fixed
    no_integer = np.zeros(instance.size, bool)
    fixed_instance = replace(instance, lower=lower, upper=upper, integer=no_integer)
    return ClarabelSession().solve(fixed_instance).x


def _replace_cones(instance: Instance, points: list[Array]) -> Instance:
    """Return the instance with tangents of its cones at points as rows, in place of the cones.

    With a = (F x + f) / |F x + f| every x' in the cone has a'(F x' + f) <= radius + slope x'.
    """
    blocks, ends = [sparse.csr_matrix(instance.A)], [instance.row_upper]
    for balls in instance.balls:
        count, d = balls.f.shape
        for x in points:
            vectors = balls.vectors(x)
            length = np.linalg.norm(vectors, axis=1)
            margin = _ACTIVE * np.maximum(1.0, length)
            chosen = np.flatnonzero((length - balls.limits(x) > -margin) & (length > 1e-12))
            if not len(chosen):
                continue
            normal = vectors[chosen] / length[chosen, None]  # (c, d)
            places = (
                np.repeat(np.arange(len(chosen)), d),
                (chosen[:, None] * d + np.arange(d)).ravel(),
            )
            mixing = sparse.csr_matrix((normal.ravel(), places), shape=(len(chosen), count * d))
            rows = sparse.csr_matrix(mixing @ balls.F)
            if balls.slope is not None:
                rows = rows - balls.slope[chosen]
            blocks.append(sparse.csr_matrix(rows))
            ends.append(balls.radius[chosen] - np.sum(normal * balls.f[chosen], axis=1))
    rows = sparse.vstack(blocks).tocsr()
    extra = rows.shape[0] - len(instance.row_lower)
    return replace(
        instance,
        A=rows,
        row_lower=np.append(instance.row_lower, np.full(extra, -np.inf)),
        row_upper=np.concatenate(ends),
        Q=sparse.csr_matrix((rows.shape[0], 0)),
        balls=(),
    )
