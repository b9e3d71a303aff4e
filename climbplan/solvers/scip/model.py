"""SCIP models of instances: parts shared by convex programs and whole statements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyscipopt
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.box import VariableBox
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer_form import ChoiceRow, build_mixed_integer_form
from climbplan.solvers.separable_cost import SeparableCost

_FEASIBILITY = 1e-6  # SCIP's tolerance of rows, by which propagated bounds are widened


@dataclass
class ScipModel:
    """The model and its variables: x0 ..., w0 ... of products, in<choice>_<alternative>."""

    model: Any
    x: list[Any]  # (n,)
    w: list[Any] = field(default_factory=list)  # (K,)
    binaries: list[list[Any]] = field(default_factory=list)  # by choice and alternative

    @classmethod
    def create(cls, instance: Instance, lower: Array, upper: Array) -> ScipModel:
        """Create a model with bounded variables and nothing else; stated binaries are binary."""
        model = pyscipopt.Model(instance.name)
        model.hideOutput()
        x = [
            model.addVar(
                f"x{i}",
                vtype=("B" if low >= 0.0 and high <= 1.0 else "I") if is_integer else "C",
                lb=convert_bound(low),
                ub=convert_bound(high),
            )
            for i, (low, high, is_integer) in enumerate(
                zip(lower, upper, instance.integer, strict=True)
            )
        ]
        return cls(model, x)

    def build_affine(self, row: sparse.csr_matrix, offset: float = 0.0) -> Any:
        """Return row (x, w) + offset; a row may cover x alone."""
        variables = self.x + self.w
        pairs = zip(row.indices, row.data, strict=True)
        return pyscipopt.quicksum(float(a) * variables[j] for j, a in pairs) + offset

    def add_range(self, expression: Any, low: float, high: float, name: str) -> None:
        """Add low <= expression <= high; infinite ends are left out."""
        low, high = float(low), float(high)  # NumPy's scalars would take over the comparison
        if np.isfinite(low) and low == high:
            self.model.addCons(expression == low, name)
        elif np.isfinite(low) and np.isfinite(high):
            self.model.addCons((low <= expression) <= high, name)
        elif np.isfinite(low):
            self.model.addCons(expression >= low, name)
        elif np.isfinite(high):
            self.model.addCons(expression <= high, name)

    def add_rows(self, instance: Instance) -> None:
        """Add rows over x, and over w where the model has products."""
        rows = sparse.csr_matrix(instance.A)
        if self.w:
            rows = sparse.hstack([instance.A, instance.Q]).tocsr()
        for i, (low, high) in enumerate(zip(instance.row_lower, instance.row_upper, strict=True)):
            self.add_range(self.build_affine(rows[i]), low, high, f"row{i}")

    def set_cost(self, cost: SeparableCost, box: VariableBox) -> None:
        """Set the cost as separable epigraphs: one large quadratic leaves the bound at zero.

        Each difference is scaled to at most 1, so that the solver's tolerance is small in the cost.
        """
        reach = box.interval(cost.U)
        largest = np.maximum(np.abs(reach.lower + cost.offset), np.abs(reach.upper + cost.offset))
        scale = np.where(np.isfinite(largest) & (largest > 0), largest, 1.0)
        terms = []
        for j, (offset, unit) in enumerate(zip(cost.offset, scale, strict=True)):
            difference = self.add_affine_variable(cost.U[j] / unit, float(offset / unit), f"u{j}")
            height = self.model.addVar(f"cost{j}", lb=0.0)
            self.model.addCons(difference * difference - height <= 0, f"square{j}")
            terms.append(0.5 * float(unit) ** 2 * height)
        terms += [float(cost.slope[i]) * self.x[i] for i in np.flatnonzero(cost.slope)]
        self.model.setObjective(pyscipopt.quicksum(terms))
        self.model.addObjoffset(cost.constant)

    def set_general_cost(self, instance: Instance) -> None:
        """Set a cost that is not convex: the least t with 1/2 x'Px + q'x <= t."""
        P, x = sparse.triu(instance.P).tocoo(), self.x
        weights = np.where(P.row == P.col, 0.5, 1.0) * P.data
        terms = [
            float(weight) * x[i] * x[j]
            for weight, i, j in zip(weights, P.row, P.col, strict=True)
            if weight
        ]
        linear = self.build_affine(sparse.csr_matrix(instance.q))
        height = self.model.addVar("cost", lb=None)
        self.model.addCons(pyscipopt.quicksum(terms) + linear - height <= 0, "cost_is")
        self.model.setObjective(1.0 * height)
        self.model.addObjoffset(instance.constant)

    def add_balls(self, instance: Instance) -> None:
        """Add second-order cones, those of constant radius scaled to 1 for the same tolerance."""
        for b, balls in enumerate(instance.balls):
            d = balls.f.shape[1]
            for k, radius in enumerate(balls.radius):
                unit = max(float(radius), 1e-9) if balls.slope is None else 1.0
                components = [
                    self.add_affine_variable(
                        balls.F[k * d + i] / unit, float(balls.f[k, i]) / unit, f"ball{b}_{k}_{i}"
                    )
                    for i in range(d)
                ]
                square = pyscipopt.quicksum(component * component for component in components)
                if balls.slope is None:
                    limit = 1.0 if radius > 0 else float(np.sign(radius))
                    self.model.addCons(square <= limit, f"ball{b}_{k}")
                    continue
                name = f"limit{b}_{k}"
                height = self.add_affine_variable(balls.slope[k], float(radius), name, lower=0.0)
                self.model.addCons(square - height * height <= 0, f"ball{b}_{k}")

    def add_affine_variable(
        self, row: sparse.csr_matrix, offset: float, name: str, lower: float | None = None
    ) -> Any:
        """Add a variable equal to row (x, w) + offset, at least `lower`."""
        variable = self.model.addVar(name, lb=lower)
        self.model.addCons(self.build_affine(row, offset) - variable == 0, f"{name}_is")
        return variable

    def add_choice_binaries(self, instance: Instance) -> None:
        """Add a binary for each alternative of each choice, exactly one of which is 1."""
        for c, choice in enumerate(instance.choices):
            group = [
                self.model.addVar(f"in{c}_{r}", vtype="B") for r in range(len(choice.alternatives))
            ]
            self.model.addCons(pyscipopt.quicksum(group) == 1, f"one{c}")
            self.binaries.append(group)

    def add_choice_rows(self, entries: Sequence[ChoiceRow]) -> None:
        """Add rows whose ends depend on the binaries of their choice."""
        for number, entry in enumerate(entries):
            _add_choice_row(self, entry, number)


def build_convex_model(instance: Instance) -> ScipModel:
    """Build a convex instance with choices, whose rows depend on binaries through hulls.

    Raises:
        UsageError: A choice's point is not bounded along a direction that needs it.
    """
    form = build_mixed_integer_form(instance)
    scip = ScipModel.create(instance, *widen_box(instance, form.box))
    scip.set_cost(form.squares, form.box)
    scip.add_rows(instance)
    scip.add_balls(instance)
    scip.add_choice_binaries(instance)
    scip.add_choice_rows(form.choice_rows)
    return scip


def widen_box(instance: Instance, box: VariableBox) -> tuple[Array, Array]:
    """Return propagated bounds that SCIP may use: wider by its tolerance, within the stated ones.

    A propagated bound is exact up to rounding errors, which are as large as SCIP's epsilon. SCIP
    then takes bounds for crossed, and reports programs as infeasible whose optimum is on them.
    """
    wider = _FEASIBILITY * ~instance.integer
    return (
        np.maximum(instance.lower, box.lower - wider),
        np.minimum(instance.upper, box.upper + wider),
    )


def _add_choice_row(scip: ScipModel, entry: ChoiceRow, number: int) -> None:
    """Add a row whose ends depend on the binaries of its choice."""
    value = scip.build_affine(entry.row)
    group = scip.binaries[entry.choice]
    for bound, sign, end in ((entry.lower, 1.0, "from"), (entry.upper, -1.0, "to")):
        if bound is not None:
            right_side = pyscipopt.quicksum(float(v) * b for v, b in zip(bound, group, strict=True))
            scip.model.addCons(sign * (value - right_side) >= 0, f"choice{number}_{end}")


def convert_bound(value: float) -> float | None:
    """Convert a bound to SCIP's, None for an infinite one."""
    return float(value) if np.isfinite(value) else None
