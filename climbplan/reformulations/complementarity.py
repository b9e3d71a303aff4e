"""Mixed-integer programs as nonlinear ones with complementarity constraints (MPCC).

Chapter 7.2.1: every binary becomes a continuous z in [0, 1] with z (1 - z) <= eps, eq. (7.4)
relaxed, or with the Fischer-Burmeister function of (z, 1 - z) at most eps. Each alternative of a
choice gets such a z, and they sum to 1. Indicator rows are coupled by products or by big-M, see
`nlp_form`.

At eps the coupling by products leaves an active row violated by about eps^power in its own unit,
big-M by M eps. Both vanish when the integers are rounded and the program at these integers is
solved.

Equation and chapter numbers are those of X. Lin (UCLA 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.program.instance import Instance
from climbplan.reformulations.base import Reformulation
from climbplan.reformulations.nlp_form import (
    Bounds,
    Gap,
    NlpForm,
    NlpOptions,
    build_indicators,
    build_nlp_form,
)

MIN_SLACK = 1e-7  # smallest slack of rows coupled by products, an interior for IPOPT


@dataclass(frozen=True)
class RoundedPoint:
    """A point of the statement whose integers are rounded from a relaxed one."""

    x: Array  # (n,) continuous variables unchanged, integers rounded
    assignment: IntArray  # chosen alternative of each choice
    fraction: float  # largest distance of a binary or indicator from 0 or 1 before rounding


@dataclass(frozen=True)
class SmoothProgram:
    """An instance as a nonlinear program with complementarity constraints."""

    instance: Instance
    form: NlpForm
    numbers: Array
    power: float

    def compute_bounds(self, eps: float) -> Bounds:
        """Return bounds at one value of the relaxation eps."""
        return self.form.compute_relaxed_bounds(self.instance, eps, max(eps**self.power, MIN_SLACK))

    def build_start(self, x: Array, assignment: IntArray | None = None, blur: float = 0.0) -> Array:
        """Return v (N,) at a point of the statement.

        Args:
            x: (n,) point.
            assignment: (C,) alternative of each choice, the least violated if missing.
            blur: Fraction in [0, 1] by which binaries are moved towards 1/2 and indicators towards
                equal values.
        """
        chosen = self.instance.assignment(x) if assignment is None else assignment
        integer = self.instance.integer
        start_x = np.where(integer, (1 - blur) * x + blur / 2, x)
        uniform = [np.full(k, 1 / k) for k in self.form.structure.choices]
        uniform_indicators = np.concatenate([np.zeros(0), *uniform])
        return np.concatenate(
            [
                start_x,
                (1 - blur) * build_indicators(self.instance, chosen) + blur * uniform_indicators,
            ]
        )

    def invert(self, x: Array) -> Array:
        """Return the statement's variables in a point (N,), with integers rounded."""
        return self.round_point(x).x

    def round_point(self, v: Array) -> RoundedPoint:
        """Return the statement's variables in v (N,), with integers and indicators rounded."""
        n, binaries = self.instance.size, v[self.form.binaries]
        x = np.where(self.instance.integer, np.round(v[:n]), v[:n])
        ends = np.cumsum([n, *self.form.structure.choices])
        chosen = [int(np.argmax(v[a:b])) for a, b in pairwise(ends)]
        fraction = np.abs(binaries - np.round(binaries)).max(initial=0.0)
        return RoundedPoint(x, np.array(chosen, np.int64), float(fraction))


@dataclass(frozen=True)
class Complementarity(Reformulation[SmoothProgram]):
    """Binaries as continuous variables with complementarity constraints.

    Attributes:
        kind: Function of (z, 1 - z) that is at most eps.
        coupling: Coupling of implications and choices.
        power: Rows coupled by products have the slack eps^power, in their own unit. Above 1 they
            are wide at first, so that the cost selects binaries, and tight before the binaries are
            integral.
    """

    kind: Gap = "product"
    coupling: Literal["product", "big-m"] = "product"
    power: float = 3.0

    def accepts(self, instance: Instance) -> bool:
        """Accept all instances except unbounded rows under big-M."""
        return self.coupling == "product" or super().accepts(instance)

    def apply(self, instance: Instance) -> SmoothProgram:
        """Build the nonlinear program.

        Raises:
            UsageError: Big-M lacks a bound.
        """
        form = build_nlp_form(instance, NlpOptions(self.coupling, self.kind))
        return SmoothProgram(instance, form, form.build_parameters(instance), self.power)
