"""SCIP on the whole statement: binaries, implications, choices and products (`minlp-scip`).

Implications are indicator constraints. Choices are rows over binaries from the hulls of their
alternatives where these are bounded, and indicator constraints otherwise: SCIP 10 cuts off optima
of many indicator constraints that share a binary. Products are quadratic equations, on which SCIP
branches in space. The cost is a sum of separable epigraphs. SCIP's bounds are valid for the exact
problem, up to its row tolerance.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.program.box import propagate_box
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer_form import build_mixed_integer_form
from climbplan.solvers.result import SolverResult, judge_answer
from climbplan.solvers.scip.model import ScipModel, convert_bound
from climbplan.solvers.scip.run import read_answer, read_values, run_model
from climbplan.solvers.separable_cost import factor_cost, is_convex
from climbplan.solvers.tree.repair import repair_point

NAME = "minlp-scip"
TOLERANCE = 2e-6
_SCIP_ERROR = 1e-5  # relative error of SCIP's objective through its row tolerance
_THICKNESS = 1e-6  # by which rows are widened: SCIP's own tolerance


def solve_minlp_scip(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
) -> SolverResult:
    """Solve any instance with SCIP on one thread.

    Args:
        instance: The instance.
        gap: Relative gap to prove.
        time_limit: Time limit [s].
        tolerance: Largest violation at which SCIP's point is accepted.
        start: (n,) first incumbent, if it is feasible.
    """
    begin = time.perf_counter()
    scip = build_bilinear_model(_widen_rows(instance) if instance.products.count else instance)
    if start is not None:
        _add_start(scip, instance, start)
    run_model(scip.model, gap, _SCIP_ERROR, time_limit - (time.perf_counter() - begin))
    x = assignment = None
    if scip.model.getNSols() > 0:
        chosen = [int(np.argmax(read_values(scip.model, group))) for group in scip.binaries]
        assignment = np.array(chosen, np.int64)
        x = repair_point(instance, read_values(scip.model, scip.x), assignment)
    return judge_answer(
        instance, read_answer(scip.model, NAME, begin, x, assignment), gap, tolerance
    )


def _widen_rows(instance: Instance) -> Instance:
    """Return the relaxation with all rows and bounds wider by SCIP's tolerance.

    Equations with products may leave a feasible set without interior. SCIP 9 and 10 then cut off
    optima and report bounds far above them. With an interior they do not.
    """
    implications, continuous = instance.implications, ~instance.integer
    return replace(
        instance,
        lower=instance.lower - _THICKNESS * continuous,
        upper=instance.upper + _THICKNESS * continuous,
        row_lower=instance.row_lower - _THICKNESS,
        row_upper=instance.row_upper + _THICKNESS,
        implications=replace(
            implications,
            lower=implications.lower - _THICKNESS,
            upper=implications.upper + _THICKNESS,
        ),
    )


def save_bilinear_model(instance: Instance, path: Path) -> None:
    """Write the whole statement for other solvers: .lp, .mps or .cip.

    Variables are x<i> in order of the instance, w<k> its products, in<choice>_<alternative> the
    binaries of choices.

    Raises:
        UsageError: The suffix is unknown, or the file cannot be written.
    """
    if path.suffix not in (".lp", ".mps", ".cip") or not path.parent.is_dir():
        raise UsageError(f"{path}: expected .lp, .mps or .cip in a directory that exists")
    try:
        build_bilinear_model(instance).model.writeProblem(str(path), verbose=False)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def build_bilinear_model(instance: Instance) -> ScipModel:
    """Build a model with variables x0 ..., w0 ... for products, and an epigraph for each square.

    A cost that is not convex has one epigraph.
    """
    box = propagate_box(instance)
    scip = ScipModel.create(instance, instance.lower, instance.upper)
    model, x, products = scip.model, scip.x, instance.products
    for k, (low, high) in enumerate(zip(box.products.lower, box.products.upper, strict=True)):
        scip.w.append(model.addVar(f"w{k}", lb=convert_bound(low), ub=convert_bound(high)))
    for k, (i, j) in enumerate(zip(products.first, products.second, strict=True)):
        model.addCons(x[i] * x[j] - scip.w[k] == 0, f"product{k}")
    if is_convex(instance.P):
        scip.set_cost(factor_cost(instance), box)
    else:
        scip.set_general_cost(instance)
    scip.add_rows(instance)
    scip.add_balls(instance)
    _add_implications(scip, instance)
    scip.add_choice_binaries(instance)
    try:
        scip.add_choice_rows(build_mixed_integer_form(instance).choice_rows)
    except UsageError:  # a point without bounds has no hull
        _add_choices(scip, instance)
    return scip


def _add_indicator(
    scip: ScipModel,
    binary: Any,
    row: sparse.csr_matrix,
    low: float,
    high: float,
    *,
    value: bool = True,
    name: str,
) -> None:
    """Add: binary = value implies low <= row <= high."""
    for bound, sign, end in ((high, 1.0, "upper"), (low, -1.0, "lower")):
        if np.isfinite(bound):
            below = scip.build_affine(sign * row) <= float(sign * bound)
            scip.model.addConsIndicator(below, binary, activeone=value, name=f"{name}_{end}")


def _add_implications(scip: ScipModel, instance: Instance) -> None:
    """Add implications as indicator constraints."""
    implications = instance.implications
    rows = sparse.hstack([implications.A, implications.Q]).tocsr()
    for k in range(implications.count):
        binary, low, high = (
            scip.x[implications.binary[k]],
            implications.lower[k],
            implications.upper[k],
        )
        value = bool(implications.value[k])
        _add_indicator(scip, binary, rows[k], low, high, value=value, name=f"when{k}")


def _add_choices(scip: ScipModel, instance: Instance) -> None:
    """Add the rows of every alternative as indicator constraints."""
    for c, choice in enumerate(instance.choices):
        for r, polytope in enumerate(choice.alternatives):
            binary = scip.binaries[c][r]
            A = sparse.csr_matrix(sparse.csr_matrix(polytope.A) @ choice.E)
            C = sparse.csr_matrix(sparse.csr_matrix(polytope.C) @ choice.E)
            for k, high in enumerate(polytope.b - polytope.A @ choice.e):
                _add_indicator(scip, binary, A[k], -np.inf, high, name=f"in{c}_{r}_{k}")
            for k, value in enumerate(polytope.c - polytope.C @ choice.e):
                _add_indicator(scip, binary, C[k], value, value, name=f"in{c}_{r}_at{k}")


def _add_start(scip: ScipModel, instance: Instance, start: Array) -> None:
    """Add a partial solution that SCIP completes."""
    scip.model.setParam("heuristics/completesol/maxunknownrate", 1.0)
    partial = scip.model.createPartialSol()
    for variable, value in zip(scip.x, start, strict=True):
        scip.model.setSolVal(partial, variable, float(value))
    for group, chosen in zip(scip.binaries, instance.assignment(start), strict=True):
        for r, variable in enumerate(group):
            scip.model.setSolVal(partial, variable, float(r == chosen))
    scip.model.addSol(partial)
