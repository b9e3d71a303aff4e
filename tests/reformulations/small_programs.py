"""Small mixed-integer programs with every kind of block, and their optimum by enumeration."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from climbplan.arrays import Array
from climbplan.program import Instance, Polytope, Program
from climbplan.solvers.ipopt.instances import solve_fixed_integers

TOLERANCE = 1e-6


def small_program(bilinear: bool) -> Program:
    """Three modes by binaries, a point in one of two boxes, a ball; a product row if bilinear."""
    p = Program("small")
    goal, shift = p.parameter("goal", (3,)), p.parameter("shift", (2,))
    x = p.continuous("x", (3,), -2.0, 2.0, unit="m")
    mode = p.binary("mode", (3,))
    p.exactly_one("mode.one", mode[None, :])
    p.when("mode.low", mode[0], one(x[0] + x[1] - shift[0]), upper=-0.5, unit="m")
    p.when("mode.tie", mode[1], one(x[0] - x[2] - shift[1]), 0.0, 0.0, unit="m")
    p.when("mode.high", mode[2], one(x[1] + x[2]), lower=1.0, unit="m")
    p.when("mode.not_high", mode[2], x[2:], upper=1.2, unit="m", value=False)
    p.ball("near", x[None, :], 2.0, unit="m")
    boxes = [_box("left", [-2, -1], [-0.3, 1]), _box("right", [0.2, -1.5], [1.5, 1.5])]
    p.one_of("side", x[None, :2], [boxes], unit="m")
    if bilinear:
        p.between("twist", one(x[0] * x[1] - 0.5 * x[2] ** 2), -0.6, 0.3, unit="m^2")
        p.when("mode.twist", mode[0], one(x[0] * x[2]), 0.1, np.inf, unit="m^2")
    p.minimise("distance", np.sum((x - goal) ** 2))
    return p


def random_numbers(rng: np.random.Generator) -> dict[str, Array]:
    """Parameters of the small program."""
    return {"goal": rng.uniform(-1.5, 1.5, 3), "shift": rng.uniform(-0.3, 0.3, 2)}


def enumerated(instance: Instance) -> float:
    """Least cost over all integers and choices; exact for convex ones, else a good local value."""
    best = np.inf
    count = int(instance.integer.sum())
    sides = [range(len(c.alternatives)) for c in instance.choices]
    for bits in product((0.0, 1.0), repeat=count):
        start = np.zeros(instance.size)
        start[instance.integer] = bits
        for chosen in product(*sides):
            x = solve_fixed_integers(instance, start, np.array(chosen, np.int64)).v
            if instance.violation(x, np.array(chosen, np.int64)) <= TOLERANCE:
                best = min(best, instance.objective(x))
    return best


def one(scalar: Any) -> NDArray[np.object_]:
    """A block of one expression."""
    block = np.empty(1, dtype=object)
    block[0] = scalar
    return block


def _box(name: str, low: list[float], high: list[float]) -> Polytope:
    return Polytope.halfspaces(
        name, np.vstack([np.eye(2), -np.eye(2)]), np.concatenate([high, -np.array(low, float)])
    )
