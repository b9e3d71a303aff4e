"""An instance as a smooth nonlinear program: built once per structure, numbers as parameters.

CasADi functions of the variables v = (x, d) and of all numbers of the instance. Another theta of
the same program has the same structure, so only the parameter vector and the bounds change.
Binaries and indicator rows are treated by a `Manner`:

pinned: integers are fixed; inactive rows are open, so one compiled program serves every assignment.
product: s (row - upper) <= slack, with the indicator s (or one minus it); at s = 1 a row is
violated by at most the slack in its own unit. big-m: row - upper <= M (1 - s) with M from the
bounds, which is linear; at s = 1 - eps a row may be violated by M eps.

Equation numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.conditional_rows import (
    build_indicator_rows,
    canonicalise,
    compute_big_m,
)
from climbplan.reformulations.structure import Pattern, Structure

Coupling = Literal["pinned", "product", "big-m"]
Gap = Literal["product", "fischer-burmeister"]

_MIN_RADIUS = 1e-9


@dataclass(frozen=True)
class NlpOptions:
    """Treatment of integers and indicator rows in the nonlinear program."""

    coupling: Coupling = "pinned"
    gap: Gap = "product"  # distance of binaries to 0 or 1, where they are not fixed
    only_products: bool = False  # whether to leave out rows without products, balls and choices


@dataclass(frozen=True)
class Consensus:
    """Cost share * cost + sum weight (x - target)^2."""

    weight: Array  # (n,)
    target: Array  # (n,)
    share: float = 1.0


@dataclass(frozen=True)
class Bounds:
    """Bounds of variables and rows, infinite where there is none."""

    lower: Array  # (N,)
    upper: Array  # (N,)
    row_lower: Array  # (M,)
    row_upper: Array  # (M,)


@dataclass(frozen=True, eq=False)
class NlpForm:
    """Minimise f(v; p) subject to bounds on v = (x, d) and on g(v; p)."""

    structure: Structure
    manner: NlpOptions
    v: Any  # symbols (N,)
    p: Any
    f: Any
    g: Any
    rows: IntArray  # stated rows that are included
    conditional: IntArray  # indicator rows that are included

    @property
    def size(self) -> int:
        """Number of variables N: x, and indicators of alternatives unless integers are fixed."""
        return int(self.v.numel())

    @property
    def binaries(self) -> IntArray:
        """Indices in v of the variables that must end at 0 or 1."""
        indicators = np.arange(self.structure.size, self.size)
        return np.concatenate([np.array(self.structure.integer, np.int64), indicators])

    def build_parameters(self, instance: Instance, consensus: Consensus | None = None) -> Array:
        """Return the parameter vector p of an instance of the same structure."""
        n = instance.size
        rows = build_indicator_rows(instance)
        above, below = np.zeros(len(rows.upper)), np.zeros(len(rows.upper))
        if self.manner.coupling == "big-m":
            reach = compute_big_m(instance, rows)
            above, below = reach.above, reach.below
        consensus_term = consensus or Consensus(np.zeros(n), np.zeros(n))
        return np.concatenate(
            [
                canonicalise(instance.P.tocsr()).data,
                instance.q,
                [instance.constant],
                canonicalise(instance.A).data,
                canonicalise(instance.Q).data,
                rows.A.data,
                rows.Q.data,
                np.where(np.isfinite(rows.lower), rows.lower, 0.0),
                np.where(np.isfinite(rows.upper), rows.upper, 0.0),
                below,
                above,
                *(
                    array
                    for b in instance.balls
                    for array in (canonicalise(b.F).data, b.f.ravel(), _compute_scale(b.radius))
                ),
                *([] if instance.smooth is None else [instance.smooth.theta]),
                consensus_term.weight,
                consensus_term.target,
                [consensus_term.share],
            ]
        )

    def compute_fixed_bounds(
        self, instance: Instance, integers: Array, assignment: IntArray | None = None
    ) -> Bounds:
        """Return bounds with integers at the rounded values of `integers` (n,) and choices fixed.

        `assignment` is the alternative of each choice, the least violated at `integers` if missing.
        """
        chosen = instance.assignment(integers) if assignment is None else assignment
        fixed = np.round(integers)
        lower = np.where(instance.integer, fixed, instance.lower)
        upper = np.where(instance.integer, fixed, instance.upper)
        rows = build_indicator_rows(instance)
        active = rows.find_active(np.concatenate([fixed, build_indicators(instance, chosen)]))
        low = np.where(active, rows.lower, -np.inf)[self.conditional]
        high = np.where(active, rows.upper, np.inf)[self.conditional]
        return self._build_bounds(instance, lower, upper, low, high)

    def compute_relaxed_bounds(self, instance: Instance, eps: float, slack: float = 0.0) -> Bounds:
        """Return bounds with binaries between 0 and 1, at most eps away from both.

        `slack` is that of rows coupled by products, in their own unit.
        """
        extra = self.size - instance.size
        lower = np.concatenate([instance.lower, np.zeros(extra)])
        upper = np.concatenate([instance.upper, np.ones(extra)])
        below, above, equal = _split_by_bounds(self.structure, self.conditional)
        slack = slack if self.manner.coupling == "product" else 0.0
        one_sided = len(below) + len(above)
        if self.manner.coupling == "product":
            low = np.concatenate([np.full(one_sided, -np.inf), np.full(len(equal), -slack)])
        else:
            one_sided += 2 * len(equal)
            low = np.full(one_sided, -np.inf)
        return self._build_bounds(instance, lower, upper, low, np.full(len(low), slack), eps)

    def _build_bounds(
        self,
        instance: Instance,
        lower: Array,
        upper: Array,
        low: Array,
        high: Array,
        eps: float | None = None,
    ) -> Bounds:
        """Build bounds of variables and rows."""
        row_lower = [instance.row_lower[self.rows], low]
        row_upper = [instance.row_upper[self.rows], high]
        if not self.manner.only_products:
            for balls in instance.balls:
                radius = balls.radius
                row_lower.append(np.full(balls.count, -np.inf))
                row_upper.append(np.where(radius < 0, -1.0, radius**2 / _compute_scale(radius)))
        if instance.smooth is not None:
            row_lower.append(instance.smooth.lower)
            row_upper.append(instance.smooth.upper)
        if eps is not None:
            count = len(self.structure.choices)
            row_lower += [np.ones(count), np.full(len(self.binaries), -np.inf)]
            row_upper += [np.ones(count), np.full(len(self.binaries), eps)]
        return Bounds(lower, upper, np.concatenate(row_lower), np.concatenate(row_upper))


def build_nlp_form(instance: Instance, manner: NlpOptions) -> NlpForm:
    """Build the form of an instance; instances of one structure share it."""
    return _build_symbolic(Structure.of(instance), manner)


def build_indicators(instance: Instance, assignment: IntArray) -> Array:
    """Return d: 1 for the chosen alternative of each choice, 0 for the others."""
    groups = [
        np.eye(len(c.alternatives))[k] for c, k in zip(instance.choices, assignment, strict=True)
    ]
    return np.concatenate([np.zeros(0), *groups])


class _ParameterSymbols:
    """Creates parameter symbols in the order of `NlpForm.build_parameters`."""

    def __init__(self) -> None:
        self.all: list[Any] = []

    def create_vector(self, name: str, size: int) -> Any:
        """Create a vector of symbols."""
        self.all.append(ca.SX.sym(name, size))
        return self.all[-1]

    def create_matrix(self, name: str, pattern: Pattern) -> Any:
        """Create a matrix of symbols."""
        return pattern.fill(self.create_vector(name, len(pattern.indices)))


class _IndicatorLimits(NamedTuple):
    """Bounds of indicator rows and their big-M, symbols (m,) in the order of the parameters."""

    low: Any
    high: Any
    below: Any  # big-M of the lower bound
    above: Any  # big-M of the upper bound


def _couple_indicators(
    s: Any,
    values: Any,
    limits: _IndicatorLimits,
    sides: tuple[IntArray, IntArray, IntArray],
    coupling: Coupling,
) -> list[Any]:
    """Return rows g <= slack that let indicators s (m,) activate rows with some values (m,).

    `sides` are the rows bounded below, those bounded above, and equations.
    """
    under, over, equal = sides
    if coupling == "product":
        return [
            _select_entries(s * (limits.low - values), under),
            _select_entries(s * (values - limits.high), over),
            _select_entries(s * (values - limits.high), equal),
        ]
    below, above = limits.below * (1 - s), limits.above * (1 - s)
    return [
        _select_entries(limits.low - values - below, np.concatenate([under, equal])),
        _select_entries(values - limits.high - above, np.concatenate([over, equal])),
    ]


@lru_cache(maxsize=32)
def _build_symbolic(structure: Structure, manner: NlpOptions) -> NlpForm:
    """Build the symbolic program of a structure."""
    n, m = structure.size, len(structure.indicator)
    pinned = manner.coupling == "pinned"
    numbers = _ParameterSymbols()
    x = ca.SX.sym("x", n)
    d = ca.SX.sym("d", 0 if pinned else sum(structure.choices))
    v = ca.vertcat(x, d)
    w = _select_entries(x, structure.first) * _select_entries(x, structure.second)
    P, q = numbers.create_matrix("P", structure.P), numbers.create_vector("q", n)
    cost = ca.dot(x, P @ x) / 2 + ca.dot(q, x) + numbers.create_vector("constant", 1)
    row = numbers.create_matrix("A", structure.A) @ x + numbers.create_matrix("Q", structure.Q) @ w
    indicator_values = numbers.create_matrix("Ac", structure.conditional_A) @ x
    indicator_values += numbers.create_matrix("Qc", structure.conditional_Q) @ w
    limits = _IndicatorLimits(*(numbers.create_vector(s, m) for s in _IndicatorLimits._fields))
    rows, included = np.arange(structure.A.shape[0]), np.arange(m)
    if manner.only_products:
        rows, included = (
            structure.Q.list_nonempty_rows(),
            structure.conditional_Q.list_nonempty_rows(),
        )
    g = [_select_entries(row, rows)]
    if pinned:
        g.append(_select_entries(indicator_values, included))
    else:
        s = v[list(structure.indicator)] if m else ca.SX(0, 1)
        sign = ca.DM([1.0 if value else -1.0 for value in structure.value])
        s = sign * s + (1 - sign) / 2  # the indicator, or one minus it
        sides = _split_by_bounds(structure, included)
        g += _couple_indicators(s, indicator_values, limits, sides, manner.coupling)
    for pattern, dimension in structure.balls:
        count = pattern.shape[0] // dimension
        F, f = numbers.create_matrix("F", pattern), numbers.create_vector("f", count * dimension)
        squares = ca.reshape((F @ x + f) ** 2, dimension, count)
        scaled = ca.sum1(squares).T / numbers.create_vector("radius", count)
        g += [] if manner.only_products else [scaled]
    if structure.smooth is not None:
        theta = numbers.create_vector("theta", structure.smooth.function.size1_in(1))
        g.append(structure.smooth.function(x[: structure.smooth.size], theta))
    if not pinned:
        ends = np.cumsum([0, *structure.choices])
        groups = [ca.sum1(d[int(a) : int(b)]) for a, b in pairwise(ends)]
        g += groups
        z = ca.vertcat(_select_entries(x, structure.integer), d)
        g.append(_measure_integrality_gap(z, manner.gap))
    weight, target = numbers.create_vector("weight", n), numbers.create_vector("target", n)
    f = numbers.create_vector("share", 1) * cost + ca.dot(weight, (x - target) ** 2)
    return NlpForm(
        structure, manner, v, ca.vertcat(*numbers.all), f, ca.vertcat(*g), rows, included
    )


def _measure_integrality_gap(z: Any, gap: Gap) -> Any:
    """Return the distance of z from 0 and 1: zero there, positive between."""
    if gap == "product":
        return z * (1 - z)  # eq. (7.4)
    # Fischer-Burmeister of (z, 1 - z); smooth, since z and 1 - z never vanish together
    return 1 - ca.sqrt(z**2 + (1 - z) ** 2)


def _split_by_bounds(
    structure: Structure, included: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Return indicator rows bounded below, above, and equations."""
    bounded = np.array(structure.bounded, bool).reshape(-1, 3)[included]
    return included[bounded[:, 0]], included[bounded[:, 1]], included[bounded[:, 2]]


def _select_entries(expression: Any, index: IntArray | tuple[int, ...]) -> Any:
    """Return entries as a column, possibly empty: CasADi indexes a single variable as a row."""
    return expression[[int(i) for i in index]] if len(index) else ca.SX(0, 1)


def _compute_scale(radius: Array) -> Array:
    """Return the scale of balls."""
    return np.maximum(radius, _MIN_RADIUS)
