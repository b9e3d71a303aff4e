"""An instance as a smooth nonlinear program: built once per structure, numbers as parameters.

CasADi functions of the variables v = (x, d) and of all numbers of the instance. Another theta of
the same program has the same structure, so only the parameter vector and the bounds change. What
becomes of binaries and of the rows that hang on them is a `Manner`:

pinned: integers are given; rows whose condition fails are left open, so that one compiled
program serves every assignment.
product: s (row - upper) <= slack, with s the indicator (or one minus it): at s = 1 a row is off by
at most the slack in its own unit.
big-m: row - upper <= M (1 - s) with M from the bounds: linear, but at s = 1 - eps a row may be
off by M eps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal

import casadi as ca
import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.conditional_rows import canonical, conditional_rows, excess
from climbplan.reformulations.structure import Pattern, Structure

Coupling = Literal["pinned", "product", "big-m"]
Gap = Literal["product", "fischer-burmeister"]

_LEAST_RADIUS = 1e-9


@dataclass(frozen=True)
class Manner:
    """How integers, and the rows that hang on them, appear in the nonlinear program."""

    coupling: Coupling = "pinned"
    gap: Gap = "product"  # of binaries to 0 or 1, where they are not pinned
    only_products: bool = False  # leave out rows without products, balls and choices


@dataclass(frozen=True)
class Consensus:
    """share * cost + sum weight (x - target)^2 in place of the cost."""

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
    """minimise f(v; p) subject to bounds on v = (x, d) and on g(v; p)."""

    structure: Structure
    manner: Manner
    v: Any  # symbols (N,)
    p: Any
    f: Any
    g: Any
    rows: IntArray  # stated rows kept
    conditional: IntArray  # conditional rows kept

    @property
    def size(self) -> int:
        """N: x and, unless pinned, one indicator for each alternative of each choice."""
        return int(self.v.numel())

    @property
    def binaries(self) -> IntArray:
        """Indices in v of what must end at 0 or 1."""
        indicators = np.arange(self.structure.size, self.size)
        return np.concatenate([np.array(self.structure.integer, np.int64), indicators])

    def numbers(self, instance: Instance, consensus: Consensus | None = None) -> Array:
        """The parameter vector p of an instance of the same structure."""
        n = instance.size
        rows = conditional_rows(instance)
        above, below = np.zeros(len(rows.upper)), np.zeros(len(rows.upper))
        if self.manner.coupling == "big-m":
            reach = excess(instance, rows)
            above, below = reach.above, reach.below
        pull = consensus or Consensus(np.zeros(n), np.zeros(n))
        return np.concatenate(
            [
                canonical(instance.P.tocsr()).data,
                instance.q,
                [instance.constant],
                canonical(instance.A).data,
                canonical(instance.Q).data,
                rows.A.data,
                rows.Q.data,
                np.where(np.isfinite(rows.lower), rows.lower, 0.0),
                np.where(np.isfinite(rows.upper), rows.upper, 0.0),
                below,
                above,
                *(
                    part
                    for b in instance.balls
                    for part in (canonical(b.F).data, b.f.ravel(), _scale(b.radius))
                ),
                *([] if instance.smooth is None else [instance.smooth.theta]),
                pull.weight,
                pull.target,
                [pull.share],
            ]
        )

    def pinned_bounds(
        self, instance: Instance, integers: Array, assignment: IntArray | None = None
    ) -> Bounds:
        """Bounds with integers at the rounded values of `integers` (n,) and choices made.

        assignment: the alternative of each choice, the least violated at `integers` if left out.
        """
        chosen = instance.assignment(integers) if assignment is None else assignment
        fixed = np.round(integers)
        lower = np.where(instance.integer, fixed, instance.lower)
        upper = np.where(instance.integer, fixed, instance.upper)
        rows = conditional_rows(instance)
        active = rows.active(np.concatenate([fixed, indicators(instance, chosen)]))
        low = np.where(active, rows.lower, -np.inf)[self.conditional]
        high = np.where(active, rows.upper, np.inf)[self.conditional]
        return self._bounds(instance, lower, upper, low, high)

    def relaxed_bounds(self, instance: Instance, eps: float, slack: float = 0.0) -> Bounds:
        """Bounds with binaries between 0 and 1, no further from both than eps allows.

        slack: of rows coupled by products, in their own unit.
        """
        extra = self.size - instance.size
        lower = np.concatenate([instance.lower, np.zeros(extra)])
        upper = np.concatenate([instance.upper, np.ones(extra)])
        below, above, equal = _ends(self.structure, self.conditional)
        slack = slack if self.manner.coupling == "product" else 0.0
        one_sided = len(below) + len(above)
        if self.manner.coupling == "product":
            low = np.concatenate([np.full(one_sided, -np.inf), np.full(len(equal), -slack)])
        else:
            one_sided += 2 * len(equal)
            low = np.full(one_sided, -np.inf)
        return self._bounds(instance, lower, upper, low, np.full(len(low), slack), eps)

    def _bounds(
        self,
        instance: Instance,
        lower: Array,
        upper: Array,
        low: Array,
        high: Array,
        eps: float | None = None,
    ) -> Bounds:
        row_lower = [instance.row_lower[self.rows], low]
        row_upper = [instance.row_upper[self.rows], high]
        if not self.manner.only_products:
            for balls in instance.balls:
                radius = balls.radius
                row_lower.append(np.full(balls.count, -np.inf))
                row_upper.append(np.where(radius < 0, -1.0, radius**2 / _scale(radius)))
        if instance.smooth is not None:
            row_lower.append(instance.smooth.lower)
            row_upper.append(instance.smooth.upper)
        if eps is not None:
            count = len(self.structure.choices)
            row_lower += [np.ones(count), np.full(len(self.binaries), -np.inf)]
            row_upper += [np.ones(count), np.full(len(self.binaries), eps)]
        return Bounds(lower, upper, np.concatenate(row_lower), np.concatenate(row_upper))


def nlp_form(instance: Instance, manner: Manner) -> NlpForm:
    """The form of an instance; instances of one structure share it."""
    return _build(Structure.of(instance), manner)


def indicators(instance: Instance, assignment: IntArray) -> Array:
    """d: 1 for the chosen alternative of each choice, 0 for the others."""
    groups = [
        np.eye(len(c.alternatives))[k] for c, k in zip(instance.choices, assignment, strict=True)
    ]
    return np.concatenate([np.zeros(0), *groups])


class _Numbers:
    """Hands out parameter symbols in the order of `NlpForm.numbers`."""

    def __init__(self) -> None:
        self.all: list[Any] = []

    def vector(self, name: str, size: int) -> Any:
        self.all.append(ca.SX.sym(name, size))
        return self.all[-1]

    def matrix(self, name: str, pattern: Pattern) -> Any:
        return pattern.filled(self.vector(name, len(pattern.indices)))


@lru_cache(maxsize=32)
def _build(structure: Structure, manner: Manner) -> NlpForm:
    n, m = structure.size, len(structure.indicator)
    pinned = manner.coupling == "pinned"
    numbers = _Numbers()
    x = ca.SX.sym("x", n)
    d = ca.SX.sym("d", 0 if pinned else sum(structure.choices))
    v = ca.vertcat(x, d)
    w = _pick(x, structure.first) * _pick(x, structure.second)
    P, q = numbers.matrix("P", structure.P), numbers.vector("q", n)
    cost = ca.dot(x, P @ x) / 2 + ca.dot(q, x) + numbers.vector("constant", 1)
    row = numbers.matrix("A", structure.A) @ x + numbers.matrix("Q", structure.Q) @ w
    hanging = numbers.matrix("Ac", structure.conditional_A) @ x
    hanging += numbers.matrix("Qc", structure.conditional_Q) @ w
    low, high = numbers.vector("low", m), numbers.vector("high", m)
    below, above = numbers.vector("below", m), numbers.vector("above", m)

    rows, kept = np.arange(structure.A.shape[0]), np.arange(m)
    if manner.only_products:
        rows, kept = structure.Q.nonempty(), structure.conditional_Q.nonempty()
    g = [_pick(row, rows)]
    if pinned:
        g.append(_pick(hanging, kept))
    else:
        s = v[list(structure.indicator)] if m else ca.SX(0, 1)
        sign = ca.DM([1.0 if value else -1.0 for value in structure.value])
        s = sign * s + (1 - sign) / 2  # the indicator, or one minus it
        under, over, equal = _ends(structure, kept)
        if manner.coupling == "product":
            g.append(_pick(s * (low - hanging), under))
            g.append(_pick(s * (hanging - high), over))
            g.append(_pick(s * (hanging - high), equal))
        else:
            g.append(_pick(low - hanging - below * (1 - s), np.concatenate([under, equal])))
            g.append(_pick(hanging - high - above * (1 - s), np.concatenate([over, equal])))
    for pattern, dimension in structure.balls:
        count = pattern.shape[0] // dimension
        F, f = numbers.matrix("F", pattern), numbers.vector("f", count * dimension)
        squares = ca.reshape((F @ x + f) ** 2, dimension, count)
        scaled = ca.sum1(squares).T / numbers.vector("radius", count)
        g += [] if manner.only_products else [scaled]
    if structure.smooth is not None:
        theta = numbers.vector("theta", structure.smooth.function.size1_in(1))
        g.append(structure.smooth.function(x[: structure.smooth.size], theta))
    if not pinned:
        ends = np.cumsum([0, *structure.choices])
        groups = [ca.sum1(d[int(a) : int(b)]) for a, b in pairwise(ends)]
        g += groups
        z = ca.vertcat(_pick(x, structure.integer), d)
        g.append(_distance(z, manner.gap))
    weight, target = numbers.vector("weight", n), numbers.vector("target", n)
    f = numbers.vector("share", 1) * cost + ca.dot(weight, (x - target) ** 2)
    return NlpForm(structure, manner, v, ca.vertcat(*numbers.all), f, ca.vertcat(*g), rows, kept)


def _distance(z: Any, gap: Gap) -> Any:
    """How far z is from 0 and 1: zero there, positive between."""
    if gap == "product":
        return z * (1 - z)  # eq. (7.4)
    # Fischer-Burmeister of (z, 1 - z); smooth, since z and 1 - z never vanish together
    return 1 - ca.sqrt(z**2 + (1 - z) ** 2)


def _ends(structure: Structure, kept: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Conditional rows bounded below, above, and equalities."""
    bounded = np.array(structure.bounded, bool).reshape(-1, 3)[kept]
    return kept[bounded[:, 0]], kept[bounded[:, 1]], kept[bounded[:, 2]]


def _pick(expression: Any, index: IntArray | tuple[int, ...]) -> Any:
    """Entries as a column, also none of them: of one variable CasADi takes nothing as a row."""
    return expression[[int(i) for i in index]] if len(index) else ca.SX(0, 1)


def _scale(radius: Array) -> Array:
    return np.maximum(radius, _LEAST_RADIUS)
