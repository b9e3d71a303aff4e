"""Who solves the instances: SCIP, HiGHS, Bonmin and our own tree, on one thread each.

Every answer is judged on the instance as stated, whatever its solver says.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from climbplan.errors import UsageError
from climbplan.program.instance import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.model_file import save_model
from climbplan.solvers.registry import BACKENDS, solve
from climbplan.solvers.result import Answer, SolverResult, judge_answer

GAP = 1e-4
_TOLERANCE = 1e-5  # of rows: what solvers of files leave by their own defaults
_CONVEX = frozenset({"balls", "choices", "integers", "implications"})
_PRODUCTS = _CONVEX | {"products"}


@dataclass(frozen=True)
class Contender:
    """One way to solve an instance."""

    name: str
    backend: str
    what: str
    holds: frozenset[str]  # features of instances
    run: Callable[[Instance, float], SolverResult]
    proves: bool = True

    @property
    def available(self) -> bool:
        """Whether its solver is installed."""
        return BACKENDS[self.backend].available


def timed(contender: Contender, instance: Instance, limit: float) -> tuple[SolverResult, float]:
    """Its answer and CPU seconds, those of processes that it starts among them.

    What it refuses to take (a bound that it lacks) has status "limit" and says so in its log.
    """
    begin = _spent()
    try:
        found = contender.run(instance, limit)
    except UsageError as error:
        refused = Answer(None, -np.inf, False, 0, 0.0, contender.name, (str(error),))
        found = judge_answer(instance, refused, GAP, _TOLERANCE)
    return found, _spent() - begin


def _spent() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _tree(instance: Instance, limit: float) -> SolverResult:
    return solve(instance, "branch-and-bound", GAP, limit)


def _scip(instance: Instance, limit: float) -> SolverResult:
    hulls = bool(instance.choices) and instance.features <= BACKENDS["scip"].accepts
    return solve(instance, "scip" if hulls else "minlp-scip", GAP, limit)


def _scip_file(instance: Instance, limit: float) -> SolverResult:
    """What anybody gets who reads the file with SCIP and lets it run."""
    import pyscipopt

    from climbplan.solvers.scip.run import read_answer, run_model

    suffix = ".nl" if {"products", "balls"} & instance.features else ".mps"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"instance{suffix}"
        save_model(instance, path)
        begin = time.perf_counter()
        model = pyscipopt.Model()
        model.hideOutput()
        model.readProblem(str(path))
    run_model(model, GAP, 0.0, limit)
    x = assignment = None
    if model.getNSols() > 0:
        best = model.getBestSol()
        value = {v.name: model.getSolVal(best, v) for v in model.getVars()}
        x = np.array([value[f"x{i}"] for i in range(instance.size)])
        picks, at = [], instance.size
        for choice in instance.choices:
            size = len(choice.alternatives)
            picks.append(int(np.argmax([value[f"x{at + r}"] for r in range(size)])))
            at += size
        assignment = np.array(picks, np.int64)
        x = np.where(instance.integer, np.round(x), x)
    answer = read_answer(model, "scip, file", begin, x, assignment)
    return judge_answer(instance, answer, GAP, _TOLERANCE)


def _highs(instance: Instance, limit: float) -> SolverResult:
    form = BigM().apply(instance)
    found = solve(form.instance, "highs", GAP, limit)
    x = None if found.x is None else found.x[: instance.size]
    picks = None if found.x is None else form.decode_alternatives(found.x)
    infeasible = found.status == "infeasible"
    answer = Answer(x, found.bound, infeasible, found.nodes, found.time, "highs", found.log, picks)
    return judge_answer(instance, answer, GAP, _TOLERANCE)


def _bonmin(instance: Instance, limit: float) -> SolverResult:
    return solve(instance, "bonmin", GAP, limit)


def _mpcc(instance: Instance, limit: float) -> SolverResult:
    return solve(instance, "mpcc", GAP, limit)


CONTENDERS = (
    Contender("tree", "branch-and-bound", "our own branch and bound", _PRODUCTS, _tree),
    Contender("scip", "scip", "SCIP on the statement: hulls, indicators", _PRODUCTS, _scip),
    Contender("scip-file", "scip", "SCIP on the file", _PRODUCTS, _scip_file),
    Contender("highs", "highs", "HiGHS on big-M, squares and cones by tangents", _CONVEX, _highs),
    Contender("mpcc", "mpcc", "complementarity by IPOPT: no bounds", _PRODUCTS, _mpcc, False),
    Contender("bonmin", "bonmin", "Bonmin on big-M: no bounds", _PRODUCTS, _bonmin, False),
)
