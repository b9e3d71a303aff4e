"""Answers to a stated program: what a plan file of kind `climbplan/program` holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.program.statement import Program
from climbplan.store.root_attributes import PlanHeader


@dataclass(frozen=True)
class VariableBlock:
    """One named block of x."""

    name: str
    shape: tuple[int, ...]
    start: int  # first column of x
    unit: str
    integer: bool

    @property
    def stop(self) -> int:
        """One past its last column."""
        return self.start + int(np.prod(self.shape, dtype=int))


@dataclass(frozen=True)
class ParameterBlock:
    """One named block of the parameters."""

    name: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Layouts:
    """What the columns of `parameters` and `x` are, and the bounds of x."""

    parameters: tuple[ParameterBlock, ...]
    variables: tuple[VariableBlock, ...]
    lower: Array  # (N,)
    upper: Array  # (N,)

    @classmethod
    def of(cls, program: Program) -> Layouts:
        """Return the columns of a statement."""
        variables = program.variables.values()
        return cls(
            tuple(ParameterBlock(name, shape) for name, shape in program.parameters.items()),
            tuple(VariableBlock(v.name, v.shape, v.start, v.unit, v.integer) for v in variables),
            np.concatenate([np.zeros(0), *(v.lower.ravel() for v in variables)]),
            np.concatenate([np.zeros(0), *(v.upper.ravel() for v in variables)]),
        )

    def same_columns(self, layouts: Layouts) -> bool:
        """Return whether names, shapes and kinds agree."""
        return self.parameters == layouts.parameters and self.variables == layouts.variables


@dataclass(frozen=True)
class ProgramTotals:
    """All rows together."""

    status: str
    objective: float | None  # None where a row has none
    bound: float | None
    gap: float | None  # relative


@dataclass(frozen=True, kw_only=True)
class ProgramPlan(PlanHeader):
    """n solved instances of one problem; a row without an answer has NaN and `found` false."""

    problem: str
    layouts: Layouts
    parameters: Array  # (n, p)
    features: Array  # (n, d)
    x: Array  # (n, N)
    assignment: IntArray  # (n, C) chosen alternative of each choice, -1 without an answer
    found: BoolArray  # (n,)
    status: tuple[str, ...]  # (n,)
    objective: Array  # (n,)
    bound: Array  # (n,) -inf where the method proves none
    gap: Array  # (n,) relative
    time: Array  # (n,) [s]
    method: tuple[str, ...]  # (n,)
    winner: tuple[str, ...]  # (n,) candidate, start or variant of the answer
    tried: IntArray  # (n,) candidates or starts
    tolerance: float  # largest residual of any block, in its unit
    stored_totals: ProgramTotals | None = field(default=None, compare=False)  # found when reading

    @property
    def count(self) -> int:
        """n."""
        return len(self.status)

    @property
    def overall(self) -> str:
        """The status of all rows together: optimal only if all are, infeasible likewise."""
        return combine_statuses(self.status)

    @property
    def total(self) -> float | None:
        """The objective of all rows together, None where a row has none."""
        return float(self.objective.sum()) if self.found.all() else None

    @property
    def total_bound(self) -> float | None:
        """The bound of all rows together, None where a row has none."""
        whole = float(self.bound.sum()) if self.found.all() else np.nan
        return whole if np.isfinite(whole) else None

    @property
    def totals(self) -> ProgramTotals:
        """Status, objective, bound and gap of all rows together."""
        total, bound = self.total, self.total_bound
        if total is None or bound is None:
            return ProgramTotals(self.overall, total, None, None)
        gap = max(0.0, total - bound) / max(abs(total), 1e-9)
        return ProgramTotals(self.overall, total, bound, gap)


def combine_statuses(rows: Sequence[str]) -> str:
    """Return one status for several instances."""
    kinds = set(rows)
    if len(kinds) == 1:
        return next(iter(kinds))
    return "feasible" if kinds <= {"optimal", "feasible"} else "limit"
