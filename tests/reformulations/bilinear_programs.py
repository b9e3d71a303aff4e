"""Small random mixed-integer bilinear programs, and an oracle for them by enumeration."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from climbplan.arrays import Array
from climbplan.program import Instance, Polytope, Program
from climbplan.reformulations.fixed_integers import FixedIntegerForm
from climbplan.solvers.convex.sessions import solve_convex

BOUND = 2.0


@dataclass(frozen=True)
class Optimum:
    objective: float
    x: Array | None


def disjunctive(seed: int, n: int = 4) -> Instance:
    """Without products: three binaries with implications of both values, two choices, a cost."""
    rng = np.random.default_rng(seed)
    p = Program("disjunctive")
    x = p.continuous("x", (n,), -BOUND, BOUND)
    z = p.binary("z", (3,))
    for k in range(3):
        p.when(f"on{k}", z[k], x @ rng.normal(size=(n, 2)), upper=rng.normal(size=2))
        p.when(f"off{k}", z[k], x @ rng.normal(size=(n, 1)), lower=rng.normal(), value=False)
    p.between("some", np.sum(z, keepdims=True), 1.0, 2.0)
    p.between("sum", np.sum(x, keepdims=True), -1.0, 1.5)
    triangle = Polytope.halfspaces(
        "triangle",
        np.array([[1.0, 0], [0, 1], [-1, -1]]),
        rng.uniform([-0.6, -0.6, 0.9], [0.2, 0.2, 1.7]),
    )
    half = Polytope.halfspaces("half", rng.normal(size=(1, 2)), rng.uniform(-0.5, 0.5, 1))
    line = Polytope(
        "line", np.zeros((0, 2)), np.zeros(0), rng.normal(size=(1, 2)), rng.normal(size=1) * 0.3
    )
    square = Polytope(
        "square",
        np.vstack([np.eye(2), -np.eye(2)]),
        np.array([1.5, 1.5, -1.0, -1.0]),
        np.zeros((0, 2)),
        np.zeros(0),
        np.array([[1.0, 1], [1, 1.5], [1.5, 1], [1.5, 1.5]]),
    )
    p.one_of("place", np.stack([x[:2], x[2:4]]), [[triangle, square], [half, line, square]])
    p.minimise("distance", np.sum((x - rng.uniform(-BOUND, BOUND, n)) ** 2))
    p.minimise("binaries", z @ rng.uniform(-0.5, 0.5, 3))
    return p.instantiate()


def bilinear(seed: int) -> Instance:
    """Two variables on products and squares, two binaries, linear cost and a quadratic one."""
    rng = np.random.default_rng(seed)
    p = Program("bilinear")
    x = p.continuous("x", (3,), -1.0, 2.0)
    z = p.binary("z", (2,))
    p.between("product", x[:1] * x[1:2] + rng.normal() * x[2:], -0.2, 0.4)
    p.between("circle", x[:1] ** 2 + x[1:2] ** 2, 0.8, 1.2)
    p.when("on", z[0], x[1:2] * x[2:] - x[:1], lower=0.2)
    p.when("off", z[0], x[1:2] - x[2:], lower=0.1, value=False)
    p.when("other", z[1], x[:1] - 0.5 * x[2:], upper=-0.1)
    p.between("some", np.sum(z, keepdims=True), 1.0, 2.0)
    p.minimise("distance", np.sum((x - rng.uniform(-1, 2, 3)) ** 2) + 0.3 * z[0] + 0.2 * z[1])
    return p.instantiate()


def enumerated(instance: Instance) -> Optimum:
    """The best of all integers and alternatives, each a convex program."""
    best = Optimum(np.inf, None)
    form = FixedIntegerForm.of(instance)
    whole = np.flatnonzero(instance.integer)
    for bits in itertools.product((0.0, 1.0), repeat=len(whole)):
        x = np.zeros(instance.size)
        x[whole] = bits
        for chosen in itertools.product(*(range(len(c.alternatives)) for c in instance.choices)):
            found = solve_convex(form.at(x, np.array(chosen, np.int64), compact=True), "clarabel")
            if found.objective is not None and found.objective < best.objective:
                best = Optimum(found.objective, found.x)
    return best


def scanned(seed: int, step: float = 0.005) -> float:
    """Optimum of `bilinear(seed)` by scanning x0 and x1; the best x2 follows in closed form.

    From above: scanned points are feasible.
    """
    instance = bilinear(seed)
    axis = np.arange(-1.0, 2.0 + 0.5 * step, step)
    x0, x1 = (part.ravel() for part in np.meshgrid(axis, axis, indexing="ij"))
    best = np.inf
    for bits in itertools.product((0.0, 1.0), repeat=2):
        pinned = FixedIntegerForm.of(instance).at(np.array([0.0, 0.0, 0.0, *bits]), compact=True)
        low, high = np.full(x0.shape, -1.0), np.full(x0.shape, 2.0)
        possible = np.ones(x0.shape, bool)
        for k in range(pinned.A.shape[0]):
            row, quadratic = pinned.A[[k]].toarray()[0], pinned.Q[[k]].toarray()[0]
            rest = row[0] * x0 + row[1] * x1 + row[3:] @ np.array(bits)
            slope = np.full(x0.shape, row[2])
            for w, (i, j) in enumerate(
                zip(pinned.products.first, pinned.products.second, strict=True)
            ):
                factor = {0: x0, 1: x1}[int(i)]
                if j == 2:
                    slope += quadratic[w] * factor
                else:
                    rest += quadratic[w] * factor * {0: x0, 1: x1}[int(j)]
            with np.errstate(divide="ignore", invalid="ignore"):
                one = (pinned.row_lower[k] - rest) / slope
                other = (pinned.row_upper[k] - rest) / slope
            flat = np.abs(slope) < 1e-12
            possible &= ~flat | ((rest >= pinned.row_lower[k]) & (rest <= pinned.row_upper[k]))
            low = np.where(flat, low, np.fmax(low, np.minimum(one, other)))
            high = np.where(flat, high, np.fmin(high, np.maximum(one, other)))
        held = possible & (low <= high)
        if not held.any():
            continue
        # The cost is separable: x2 is best at its unconstrained minimum, cut to the interval.
        x2 = np.clip(-instance.q[2] / instance.P[2, 2], low[held], high[held])
        points = np.stack([x0[held], x1[held], x2], axis=1)
        diagonal = instance.P.diagonal()[:3]
        cost = points**2 @ (0.5 * diagonal) + points @ instance.q[:3]
        best = min(best, float(cost.min() + instance.q[3:] @ np.array(bits) + instance.constant))
    return best
