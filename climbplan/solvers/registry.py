"""Registry of the solvers of instances: which exist, which are installed, and calls by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Literal, Protocol

import numpy as np

from climbplan.errors import MissingSolver, UsageError
from climbplan.program.instance import Instance
from climbplan.solvers.result import KnownResult, SolverResult


class Solve(Protocol):
    """The function of one backend."""

    def __call__(
        self, instance: Instance, gap: float = ..., time_limit: float = ...
    ) -> SolverResult:
        """Solve an instance to a relative gap within a time limit [s]."""


class SolveWarmStarted(Protocol):
    """The function of a backend that starts from the result of a relaxed instance."""

    def __call__(
        self,
        instance: Instance,
        gap: float = ...,
        time_limit: float = ...,
        *,
        known_result: KnownResult | None = ...,
        nodes: float = ...,
    ) -> SolverResult:
        """Solve an instance to a relative gap within a time limit [s]."""


@dataclass(frozen=True)
class Backend:
    """Description of one solver, which does not import it."""

    name: str
    module: str  # that has to be importable
    distribution: str  # as `pip install` knows it
    install: str
    accepts: frozenset[str]  # supported features of instances (`Instance.features`)
    load: Callable[[], Solve]
    purpose: str
    proves: bool = True  # whether it proves bounds and infeasibility; a local method does not
    load_knowing: Callable[[], SolveWarmStarted] | None = (
        None  # where it can start from a laxer answer
    )

    @property
    def available(self) -> bool:
        """Return whether it is installed; nothing is imported and no licence is used."""
        return find_spec(self.module) is not None

    @property
    def version(self) -> str | None:
        """Installed version, None if it is not installed."""
        try:
            return version(self.distribution)
        except PackageNotFoundError:
            return None


def _load_branch_and_bound() -> SolveWarmStarted:
    from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound

    return solve_branch_and_bound


def _load_benders() -> Solve:
    from climbplan.solvers.benders.method import solve_benders

    return solve_benders


def _load_scip() -> Solve:
    from climbplan.solvers.scip.instances import solve_scip

    return solve_scip


def _load_gurobi() -> Solve:
    from climbplan.solvers.gurobi import solve_gurobi

    return solve_gurobi


def _load_highs() -> Solve:
    from climbplan.solvers.highs.instances import solve_highs

    return solve_highs


def _load_minlp_scip() -> Solve:
    from climbplan.solvers.scip.bilinear import solve_minlp_scip

    return solve_minlp_scip


def _load_ipopt() -> Solve:
    from climbplan.solvers.ipopt.instances import solve_ipopt

    return solve_ipopt


def _load_mpcc() -> Solve:
    from climbplan.solvers.ipopt.mpcc import solve_mpcc

    return solve_mpcc


def _load_bonmin() -> Solve:
    from climbplan.solvers.bonmin import solve_bonmin

    return solve_bonmin


def _load_slack_selection() -> Solve:
    from climbplan.solvers.slack_selection import solve_slack_selection

    return solve_slack_selection


def _load_admm() -> Solve:
    from climbplan.solvers.admm import solve_admm_default

    return solve_admm_default


def _create_convex_loader(backend: Literal["daqp", "clarabel", "osqp"]) -> Callable[[], Solve]:
    def load() -> Solve:
        from climbplan.solvers.convex.sessions import solve_convex

        def solve_once(
            instance: Instance, gap: float = 1e-4, time_limit: float = np.inf
        ) -> SolverResult:
            """One convex program: over before a time limit would matter."""
            return solve_convex(instance, backend, gap)

        return solve_once

    return load


_DISJUNCTIVE = frozenset({"balls", "choices"})
_BILINEAR = _DISJUNCTIVE | {"integers", "implications", "products"}
_EVERYTHING = _BILINEAR | {"smooth"}
_CONIC = frozenset({"cones", "integers beyond 0 and 1"})

BACKENDS = {
    backend.name: backend
    for backend in (
        Backend(
            name="branch-and-bound",
            module="daqp",
            distribution="daqp",
            install="pip install daqp",
            accepts=_BILINEAR | _CONIC,
            load=_load_branch_and_bound,
            load_knowing=_load_branch_and_bound,
            purpose="postures: own tree with DAQP nodes; compiled tree over integers and in space",
        ),
        Backend(
            name="benders",
            module="highspy",
            distribution="highspy",
            install="pip install highspy",
            accepts=frozenset({"choices", "integers", "implications"}),
            load=_load_benders,
            purpose="generalised Benders cuts by the own tree's solver, integers by HiGHS",
        ),
        Backend(
            name="scip",
            module="pyscipopt",
            distribution="PySCIPOpt",
            install="pip install PySCIPOpt",
            accepts=_DISJUNCTIVE,
            load=_load_scip,
            purpose="independent oracle of convex programs with choices",
        ),
        Backend(
            name="gurobi",
            module="gurobipy",
            distribution="gurobipy",
            install="pip install 'climbplan[gurobi]'",
            accepts=_DISJUNCTIVE | {"integers"},
            load=_load_gurobi,
            purpose="optional, of convex programs with choices or binaries, mccormick and admm",
        ),
        Backend(
            name="highs",
            module="highspy",
            distribution="highspy",
            install="pip install highspy",
            accepts=frozenset({"balls", "integers"}) | _CONIC,
            load=_load_highs,
            purpose="mccormick and admm; quadratic costs by outer approximation",
        ),
        Backend(
            name="minlp-scip",
            module="pyscipopt",
            distribution="PySCIPOpt",
            install="pip install PySCIPOpt",
            accepts=_BILINEAR | _CONIC,
            load=_load_minlp_scip,
            purpose="whole statements, products branched on in space; fallback of knn",
        ),
        Backend(
            name="sl1-relaxation",
            module="clarabel",
            distribution="clarabel",
            install="pip install clarabel",
            accepts=_DISJUNCTIVE,
            load=_load_slack_selection,
            purpose="convex programs with choices by L1 relaxation and rounding, as SL1M",
            proves=False,
        ),
        Backend(
            name="mpcc",
            module="casadi",
            distribution="casadi",
            install="pip install casadi",
            accepts=_EVERYTHING,
            load=_load_mpcc,
            purpose="whole statements by complementarity and IPOPT, fast",
            proves=False,
        ),
        Backend(
            name="admm",
            module="casadi",
            distribution="casadi",
            install="pip install casadi",
            accepts=_EVERYTHING,
            load=_load_admm,
            purpose="whole statements between HiGHS and IPOPT",
            proves=False,
        ),
        Backend(
            name="bonmin",
            module="casadi",
            distribution="casadi",
            install="pip install casadi",
            accepts=_EVERYTHING,
            load=_load_bonmin,
            purpose="whole statements by nonlinear branch and bound: a baseline",
            proves=False,
        ),
        Backend(
            name="ipopt",
            module="casadi",
            distribution="casadi",
            install="pip install casadi",
            accepts=frozenset({"balls", "products", "smooth"}),
            load=_load_ipopt,
            purpose="what is left when integers are pinned, products included",
            proves=False,
        ),
        Backend(
            name="clarabel",
            module="clarabel",
            distribution="clarabel",
            install="pip install clarabel",
            accepts=frozenset({"balls", "cones"}),
            load=_create_convex_loader("clarabel"),
            purpose="convex programs with exact cones, pinned programs",
        ),
        Backend(
            name="daqp",
            module="daqp",
            distribution="daqp",
            install="pip install daqp",
            accepts=frozenset(),
            load=_create_convex_loader("daqp"),
            purpose="small dense quadratic programs, re-solved warm",
        ),
        Backend(
            name="osqp",
            module="osqp",
            distribution="osqp",
            install="pip install osqp",
            accepts=frozenset(),
            load=_create_convex_loader("osqp"),
            purpose="quadratic programs, the published choice",
        ),
    )
}


def list_available() -> tuple[str, ...]:
    """Return the names of the installed solvers."""
    return tuple(name for name, backend in BACKENDS.items() if backend.available)


def require(solver: str) -> Backend:
    """Return the backend of a name.

    Raises:
        UsageError: The name is unknown.
        MissingSolver: The solver is not installed.
    """
    backend = BACKENDS.get(solver)
    if backend is None:
        raise UsageError(f"unknown solver {solver!r}: expected one of {', '.join(BACKENDS)}")
    if not backend.available:
        raise MissingSolver(
            f"solver {solver!r} is not installed ({backend.install}); "
            f"available: {', '.join(list_available())}"
        )
    return backend


def solve(
    instance: Instance,
    solver: str,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    known_result: KnownResult | None = None,
    nodes: float = np.inf,
) -> SolverResult:
    """Solve an instance by the solver of a name.

    Args:
        instance: The instance.
        solver: Name in the registry.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        known_result: Result of a relaxed instance with the same choices, if a solver can use it.
        nodes: Largest number of nodes of the built-in tree; other solvers have the time limit only.

    Raises:
        UsageError: The name is unknown, or the solver does not support the instance.
        MissingSolver: The solver is not installed.
    """
    backend = require(solver)
    unsupported = instance.features - backend.accepts
    if unsupported:
        raise UsageError(
            f"solver {solver!r} cannot hold {', '.join(sorted(unsupported))} (program "
            f"{instance.name!r}): reformulate first, or use "
            + " or ".join(n for n, b in BACKENDS.items() if instance.features <= b.accepts)
        )
    if backend.load_knowing is not None:
        return backend.load_knowing()(
            instance, gap, time_limit, known_result=known_result, nodes=nodes
        )
    return backend.load()(instance, gap=gap, time_limit=time_limit)
