"""An instance as a SCIP model: what convex programs and whole statements share of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyscipopt
from scipy import sparse

from climbplan.arrays import Array
from climbplan.program.box import Box
from climbplan.program.instance import Instance
from climbplan.solvers.mixed_integer_form import ChoiceRow, mixed_integer_form
from climbplan.solvers.separable_cost import SeparableCost


@dataclass
class ScipModel:
    """The model and its handles. Variables x0 ..., w0 ... of products, in<choice>_<alternative>."""

    model: Any
    x: list[Any]  # (n,)
    w: list[Any] = field(default_factory=list)  # (K,)
    binaries: list[list[Any]] = field(default_factory=list)  # by choice and alternative

    @classmethod
    def of(cls, instance: Instance, lower: Array, upper: Array) -> ScipModel:
        """Variables within bounds and nothing else; stated binaries are binary."""
        model = pyscipopt.Model(instance.name)
        model.hideOutput()
        x = [
            model.addVar(
                f"x{i}", vtype="B" if whole else "C", lb=scip_bound(low), ub=scip_bound(high)
            )
            for i, (low, high, whole) in enumerate(zip(lower, upper, instance.integer, strict=True))
        ]
        return cls(model, x)

    def affine(self, row: sparse.csr_matrix, offset: float = 0.0) -> Any:
        """row (x, w) + offset; rows of x alone will do."""
        variables = self.x + self.w
        pairs = zip(row.indices, row.data, strict=True)
        return pyscipopt.quicksum(float(a) * variables[j] for j, a in pairs) + offset

    def between(self, expression: Any, low: float, high: float, name: str) -> None:
        """low <= expression <= high, ends that are infinite left out."""
        low, high = float(low), float(high)  # NumPy's own numbers compare in its way
        if np.isfinite(low) and low == high:
            self.model.addCons(expression == low, name)
        elif np.isfinite(low) and np.isfinite(high):
            self.model.addCons((low <= expression) <= high, name)
        elif np.isfinite(low):
            self.model.addCons(expression >= low, name)
        elif np.isfinite(high):
            self.model.addCons(expression <= high, name)

    def rows(self, instance: Instance) -> None:
        """Rows over x, and over w where the model has products."""
        whole = sparse.csr_matrix(instance.A)
        if self.w:
            whole = sparse.hstack([instance.A, instance.Q]).tocsr()
        for i, (low, high) in enumerate(zip(instance.row_lower, instance.row_upper, strict=True)):
            self.between(self.affine(whole[i]), low, high, f"row{i}")

    def cost(self, cost: SeparableCost, box: Box) -> None:
        """Separable epigraphs of differences: one large quadratic leaves the bound at zero.

        Each difference is scaled to at most 1, so that the solver's tolerance is small in the cost.
        """
        reach = box.interval(cost.U)
        largest = np.maximum(np.abs(reach.lower + cost.offset), np.abs(reach.upper + cost.offset))
        scale = np.where(np.isfinite(largest) & (largest > 0), largest, 1.0)
        terms = []
        for j, (offset, unit) in enumerate(zip(cost.offset, scale, strict=True)):
            step = self.named(cost.U[j] / unit, float(offset / unit), f"u{j}")
            height = self.model.addVar(f"cost{j}", lb=0.0)
            self.model.addCons(step * step - height <= 0, f"square{j}")
            terms.append(0.5 * float(unit) ** 2 * height)
        terms += [float(cost.slope[i]) * self.x[i] for i in np.flatnonzero(cost.slope)]
        self.model.setObjective(pyscipopt.quicksum(terms))
        self.model.addObjoffset(cost.constant)

    def balls(self, instance: Instance) -> None:
        """Second-order cones, scaled to radius 1: the tolerance means the same for every ball."""
        for b, balls in enumerate(instance.balls):
            d = balls.f.shape[1]
            for k, radius in enumerate(balls.radius):
                unit = max(float(radius), 1e-9)
                parts = [
                    self.named(
                        balls.F[k * d + i] / unit, float(balls.f[k, i]) / unit, f"ball{b}_{k}_{i}"
                    )
                    for i in range(d)
                ]
                limit = 1.0 if radius > 0 else float(np.sign(radius))
                square = pyscipopt.quicksum(part * part for part in parts)
                self.model.addCons(square <= limit, f"ball{b}_{k}")

    def named(self, row: sparse.csr_matrix, offset: float, name: str) -> Any:
        """A variable equal to row (x, w) + offset."""
        variable = self.model.addVar(name, lb=None)
        self.model.addCons(self.affine(row, offset) - variable == 0, f"{name}_is")
        return variable

    def one_of_each(self, instance: Instance) -> None:
        """A binary for each alternative of each choice, of which one is 1."""
        for c, choice in enumerate(instance.choices):
            group = [
                self.model.addVar(f"in{c}_{r}", vtype="B") for r in range(len(choice.alternatives))
            ]
            self.model.addCons(pyscipopt.quicksum(group) == 1, f"one{c}")
            self.binaries.append(group)


def scip_model(instance: Instance) -> ScipModel:
    """A convex instance with choices, whose rows hang on binaries by their hulls.

    Raises UsageError if a choice's point is not bounded along a direction that needs it.
    """
    form = mixed_integer_form(instance)
    built = ScipModel.of(instance, form.box.lower, form.box.upper)
    built.cost(form.squares, form.box)
    built.rows(instance)
    built.balls(instance)
    built.one_of_each(instance)
    for number, entry in enumerate(form.choice_rows):
        _choice_row(built, entry, number)
    return built


def _choice_row(built: ScipModel, entry: ChoiceRow, number: int) -> None:
    value = built.affine(entry.row)
    group = built.binaries[entry.choice]
    for bound, sign, end in ((entry.lower, 1.0, "from"), (entry.upper, -1.0, "to")):
        if bound is not None:
            edge = pyscipopt.quicksum(float(v) * b for v, b in zip(bound, group, strict=True))
            built.model.addCons(sign * (value - edge) >= 0, f"choice{number}_{end}")


def scip_bound(value: float) -> float | None:
    """A bound as SCIP takes it: None for none."""
    return float(value) if np.isfinite(value) else None
