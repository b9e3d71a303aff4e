"""An instance as a SCIP model, for solving and for writing to a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyscipopt
from scipy import sparse

from climbplan.program.instance import Balls, Instance
from climbplan.program.polytope import Array
from climbplan.solvers.mixed_integer_form import ChoiceRow, MixedIntegerForm, mixed_integer_form


@dataclass(frozen=True)
class ScipModel:
    """The model and its handles."""

    model: Any
    x: list[Any]  # (n,)
    binaries: list[list[Any]]  # by choice and alternative


def scip_model(instance: Instance) -> ScipModel:
    """Variables x0 ..., one epigraph for each square of the cost, one binary an alternative.

    Raises UsageError if a choice's point is not bounded along a direction that needs it.
    """
    form = mixed_integer_form(instance)
    model = pyscipopt.Model(instance.name)
    model.hideOutput()
    x = [
        model.addVar(f"x{i}", lb=_bound(low), ub=_bound(high))
        for i, (low, high) in enumerate(zip(form.box.lower, form.box.upper, strict=True))
    ]
    built = ScipModel(model, x, [])
    _cost(built, form)
    for i, (low, high) in enumerate(zip(instance.row_lower, instance.row_upper, strict=True)):
        _between(built, _affine(built, instance.A[i], 0.0), low, high, f"row{i}")
    for b, balls in enumerate(instance.balls):
        _balls(built, balls, b)
    _choices(built, instance, form.choice_rows)
    return built


def _bound(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _affine(built: ScipModel, row: sparse.csr_matrix, offset: float) -> Any:
    pairs = zip(row.indices, row.data, strict=True)
    return pyscipopt.quicksum(float(a) * built.x[j] for j, a in pairs) + offset


def _between(built: ScipModel, expression: Any, low: float, high: float, name: str) -> None:
    if np.isfinite(low) and np.isfinite(high):
        built.model.addCons((low <= expression) <= high, name)
    elif np.isfinite(low):
        built.model.addCons(expression >= low, name)
    elif np.isfinite(high):
        built.model.addCons(expression <= high, name)


def _named(built: ScipModel, row: sparse.csr_matrix, offset: float, name: str) -> Any:
    """A variable equal to row x + offset."""
    variable = built.model.addVar(name, lb=None)
    built.model.addCons(_affine(built, row, offset) - variable == 0, f"{name}_is")
    return variable


def _cost(built: ScipModel, form: MixedIntegerForm) -> None:
    """Separable epigraphs of explicit differences: one large quadratic leaves the bound at zero.

    Each difference is scaled to at most 1, so that the solver's tolerance is small in the cost.
    """
    squares, model = form.squares, built.model
    reach = form.box.interval(squares.U)
    largest = np.maximum(np.abs(reach.lower + squares.offset), np.abs(reach.upper + squares.offset))
    scale = np.where(np.isfinite(largest) & (largest > 0), largest, 1.0)
    terms = []
    for j, (offset, unit) in enumerate(zip(squares.offset, scale, strict=True)):
        step = _named(built, squares.U[j] / unit, float(offset / unit), f"u{j}")
        height = model.addVar(f"cost{j}", lb=0.0)
        model.addCons(step * step - height <= 0, f"square{j}")
        terms.append(0.5 * float(unit) ** 2 * height)
    terms += [float(squares.slope[i]) * built.x[i] for i in np.flatnonzero(squares.slope)]
    model.setObjective(pyscipopt.quicksum(terms))
    model.addObjoffset(squares.constant)


def _balls(built: ScipModel, balls: Balls, block: int) -> None:
    d = balls.f.shape[1]
    for k, radius in enumerate(balls.radius):
        name = f"ball{block}_{k}"
        parts = [
            _named(built, balls.F[k * d + i], float(balls.f[k, i]), f"{name}_{i}") for i in range(d)
        ]
        # Scaled to radius 1, so that the solver's tolerance means the same for every ball.
        scale = 1.0 / max(float(radius), 1e-9) ** 2
        square = pyscipopt.quicksum(scale * p * p for p in parts)
        built.model.addCons(square <= float(radius) ** 2 * scale if radius >= 0 else -1.0, name)


def _choices(built: ScipModel, instance: Instance, rows: tuple[ChoiceRow, ...]) -> None:
    model = built.model
    for c, choice in enumerate(instance.choices):
        group = [model.addVar(f"in{c}_{r}", vtype="B") for r in range(len(choice.alternatives))]
        model.addCons(pyscipopt.quicksum(group) == 1, f"one{c}")
        built.binaries.append(group)
    for number, entry in enumerate(rows):
        value = _affine(built, entry.row, 0.0)
        group = built.binaries[entry.choice]
        for bound, sign, end in ((entry.lower, 1.0, "from"), (entry.upper, -1.0, "to")):
            if bound is not None:
                edge = _weighted(bound, group)
                model.addCons(sign * (value - edge) >= 0, f"choice{number}_{end}")


def _weighted(values: Array, binaries: list[Any]) -> Any:
    return pyscipopt.quicksum(float(v) * b for v, b in zip(values, binaries, strict=True))
