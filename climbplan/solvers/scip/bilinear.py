"""SCIP on the whole statement: binaries, implications, choices and products (`minlp-scip`).

Implications and choices are indicator constraints, products are quadratic equations that SCIP
branches on in space, the cost is a sum of separable epigraphs. Its bounds are valid for the exact
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
from climbplan.program.box import propagated_box
from climbplan.program.instance import Instance
from climbplan.solvers.result import SolverResult, judged
from climbplan.solvers.scip.model import ScipModel, scip_bound
from climbplan.solvers.scip.run import claim, run_model, values
from climbplan.solvers.separable_cost import separable_cost
from climbplan.solvers.tree.mending import mended

NAME = "minlp-scip"
TOLERANCE = 2e-6
_OWN_ERROR = 1e-5  # relative: how far SCIP's objective may be off through its row tolerance
_THICKNESS = 1e-6  # of rows, in their unit: SCIP's own tolerance


def solve_minlp_scip(
    instance: Instance,
    gap: float = 1e-4,
    time_limit: float = np.inf,
    tolerance: float = TOLERANCE,
    start: Array | None = None,
) -> SolverResult:
    """Solve any instance with SCIP on one thread.

    gap: relative gap to prove. time_limit: [s]. tolerance: largest violation accepted when SCIP's
    point is checked. start: a point (n,) to begin from, if it is feasible.
    """
    begin = time.perf_counter()
    built = bilinear_model(_thickened(instance) if instance.products.count else instance)
    if start is not None:
        _give(built, instance, start)
    run_model(built.model, gap, _OWN_ERROR, time_limit - (time.perf_counter() - begin))
    x = assignment = None
    if built.model.getNSols() > 0:
        chosen = [int(np.argmax(values(built.model, group))) for group in built.binaries]
        assignment = np.array(chosen, np.int64)
        x = mended(instance, values(built.model, built.x), assignment)
    return judged(instance, claim(built.model, NAME, begin, x, assignment), gap, tolerance)


def _thickened(instance: Instance) -> Instance:
    """All rows and bounds wider by SCIP's tolerance: a relaxation, so its bounds hold for the
    instance.

    Where equations with products leave a set without an interior, SCIP 9 and 10 cut optima off and
    report bounds far above them (seen on the bookshelf: 72 where 0.02 is feasible). Presolving,
    separation and propagation each change what is lost; with an interior nothing is.
    """
    implied, continuous = instance.implications, ~instance.integer
    return replace(
        instance,
        lower=instance.lower - _THICKNESS * continuous,
        upper=instance.upper + _THICKNESS * continuous,
        row_lower=instance.row_lower - _THICKNESS,
        row_upper=instance.row_upper + _THICKNESS,
        implications=replace(
            implied, lower=implied.lower - _THICKNESS, upper=implied.upper + _THICKNESS
        ),
    )


def save_bilinear_model(instance: Instance, path: Path) -> None:
    """Write the whole statement for other solvers: .lp, .mps or .cip.

    Variables are x<i> in order of the instance, w<k> its products, in<choice>_<alternative> the
    binaries of choices. Raises UsageError for another suffix or an unwritable place.
    """
    if path.suffix not in (".lp", ".mps", ".cip") or not path.parent.is_dir():
        raise UsageError(f"{path}: expected .lp, .mps or .cip in a directory that exists")
    try:
        bilinear_model(instance).model.writeProblem(str(path), verbose=False)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error


def bilinear_model(instance: Instance) -> ScipModel:
    """Variables x0 ..., w0 ... for products, one epigraph for each square of the cost."""
    box = propagated_box(instance)
    built = ScipModel.of(instance, instance.lower, instance.upper)
    model, x, products = built.model, built.x, instance.products
    for k, (low, high) in enumerate(zip(box.products.lower, box.products.upper, strict=True)):
        built.w.append(model.addVar(f"w{k}", lb=scip_bound(low), ub=scip_bound(high)))
    for k, (i, j) in enumerate(zip(products.first, products.second, strict=True)):
        model.addCons(x[i] * x[j] - built.w[k] == 0, f"product{k}")
    built.cost(separable_cost(instance), box)
    built.rows(instance)
    built.balls(instance)
    _implications(built, instance)
    built.one_of_each(instance)
    _choices(built, instance)
    return built


def _switched(
    built: ScipModel,
    row: sparse.csr_matrix,
    low: float,
    high: float,
    binary: Any,
    value: bool,
    name: str,
) -> None:
    """binary = value implies low <= row <= high."""
    for bound, sign, end in ((high, 1.0, "upper"), (low, -1.0, "lower")):
        if np.isfinite(bound):
            below = built.affine(sign * row) <= float(sign * bound)
            built.model.addConsIndicator(below, binary, activeone=bool(value), name=f"{name}_{end}")


def _implications(built: ScipModel, instance: Instance) -> None:
    implied = instance.implications
    rows = sparse.hstack([implied.A, implied.Q]).tocsr()
    for k in range(implied.count):
        binary, low, high = built.x[implied.binary[k]], implied.lower[k], implied.upper[k]
        _switched(built, rows[k], low, high, binary, bool(implied.value[k]), f"when{k}")


def _choices(built: ScipModel, instance: Instance) -> None:
    for c, choice in enumerate(instance.choices):
        for r, polytope in enumerate(choice.alternatives):
            binary = built.binaries[c][r]
            A = sparse.csr_matrix(sparse.csr_matrix(polytope.A) @ choice.E)
            C = sparse.csr_matrix(sparse.csr_matrix(polytope.C) @ choice.E)
            for k, high in enumerate(polytope.b - polytope.A @ choice.e):
                _switched(built, A[k], -np.inf, high, binary, True, f"in{c}_{r}_{k}")
            for k, value in enumerate(polytope.c - polytope.C @ choice.e):
                _switched(built, C[k], value, value, binary, True, f"in{c}_{r}_at{k}")


def _give(built: ScipModel, instance: Instance, start: Array) -> None:
    """A partial solution that SCIP completes."""
    built.model.setParam("heuristics/completesol/maxunknownrate", 1.0)
    partial = built.model.createPartialSol()
    for variable, value in zip(built.x, start, strict=True):
        built.model.setSolVal(partial, variable, float(value))
    for group, chosen in zip(built.binaries, instance.assignment(start), strict=True):
        for r, variable in enumerate(group):
            built.model.setSolVal(partial, variable, float(r == chosen))
    built.model.addSol(partial)
