"""Mixed-integer programs as nonlinear ones with complementarity constraints (MPCC).

Chapter 7.2.1: every binary becomes a continuous z in [0, 1] with z (1 - z) <= eps, eq. (7.4)
relaxed, or with the Fischer-Burmeister function of (z, 1 - z) at most eps. Alternatives of choices
get one such z each, summing to 1. Rows that hang on a binary are coupled by products or by big-M,
see `nlp_form`.

At eps the coupling by products leaves an active row off by about eps^power in its own unit, big-M
by M eps. Either leak vanishes when the integers are rounded and the pinned program is solved.
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
    Manner,
    NlpForm,
    indicators,
    nlp_form,
)

LEAST_SLACK = 1e-7  # of rows coupled by products: leaves IPOPT an interior


@dataclass(frozen=True)
class Rounded:
    """A point of the statement with integers made of a relaxed one."""

    x: Array  # (n,) continuous variables as they were, integers rounded
    assignment: IntArray  # chosen alternative of each choice
    fraction: float  # largest distance of a binary or indicator from 0 or 1 before rounding


@dataclass(frozen=True)
class SmoothProgram:
    """An instance as a nonlinear program with complementarity constraints."""

    instance: Instance
    form: NlpForm
    numbers: Array
    power: float

    def bounds(self, eps: float) -> Bounds:
        """Bounds at one value of the relaxation eps."""
        return self.form.relaxed_bounds(self.instance, eps, max(eps**self.power, LEAST_SLACK))

    def start(self, x: Array, assignment: IntArray | None = None, blur: float = 0.0) -> Array:
        """v (N,) at a point of the statement.

        blur: in [0, 1]; binaries are drawn so far towards 1/2, indicators towards equal shares.
        assignment: the least violated alternatives if left out.
        """
        chosen = self.instance.assignment(x) if assignment is None else assignment
        integer = self.instance.integer
        first = np.where(integer, (1 - blur) * x + blur / 2, x)
        shares = [np.full(k, 1 / k) for k in self.form.structure.choices]
        even = np.concatenate([np.zeros(0), *shares])
        return np.concatenate([first, (1 - blur) * indicators(self.instance, chosen) + blur * even])

    def invert(self, x: Array) -> Array:
        """The statement's variables in a point (N,), integers rounded."""
        return self.rounded(x).x

    def rounded(self, v: Array) -> Rounded:
        """The statement's variables in v (N,), integers rounded, the largest indicators chosen."""
        n, binaries = self.instance.size, v[self.form.binaries]
        x = np.where(self.instance.integer, np.round(v[:n]), v[:n])
        ends = np.cumsum([n, *self.form.structure.choices])
        chosen = [int(np.argmax(v[a:b])) for a, b in pairwise(ends)]
        fraction = np.abs(binaries - np.round(binaries)).max(initial=0.0)
        return Rounded(x, np.array(chosen, np.int64), float(fraction))


@dataclass(frozen=True)
class Complementarity(Reformulation[SmoothProgram]):
    """Binaries as continuous variables with complementarity constraints.

    kind: the function of (z, 1 - z) that is at most eps. coupling: of implications and choices.
    power: rows coupled by products have the slack eps^power, in their own unit. Above 1 they are
    wide at first, so that the cost chooses, and tight before the binaries are, which could
    otherwise settle where the rows then cannot follow.
    """

    kind: Gap = "product"
    coupling: Literal["product", "big-m"] = "product"
    power: float = 3.0

    def accepts(self, instance: Instance) -> bool:
        """All but unbounded rows under big-M."""
        return self.coupling == "product" or super().accepts(instance)

    def apply(self, instance: Instance) -> SmoothProgram:
        """The nonlinear program; raises UsageError where big-M lacks a bound."""
        form = nlp_form(instance, Manner(self.coupling, self.kind))
        return SmoothProgram(instance, form, form.numbers(instance), self.power)
