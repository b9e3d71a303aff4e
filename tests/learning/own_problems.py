"""Two small problems: bilinear with a choice and implications, and one with nothing feasible."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.methods.candidate_solving import candidate_at, solve_candidate
from climbplan.program import Instance, Polytope, Problem, Program


def _box(name: str, low: list[float], high: list[float]) -> Polytope:
    A = np.vstack([np.eye(2), -np.eye(2)])
    b = np.concatenate([high, -np.array(low)])
    corners = np.array(list(product(*zip(low, high, strict=True))))
    return Polytope(name, A, b, np.zeros((0, 2)), np.zeros(0), corners)


def islands(bilinear: bool = True) -> Program:
    """Come near a goal from one of two islands; the sail, if set, must carry enough."""
    p = Program("islands")
    goal = p.parameter("goal", (2,))
    x = p.continuous("x", (2,), -2.0, 2.0, unit="m")
    sail = p.continuous("sail", (1,), 0.0, 2.0)
    is_set = p.binary("is_set", (1,))
    west, east = _box("west", [-2, -1], [-0.5, 1]), _box("east", [0.5, -1], [2, 1])
    p.one_of("island", x, [[west, east]], unit="m")
    p.when("sail.set", is_set, sail, lower=0.5)
    p.when("sail.down", is_set, sail, upper=0.0, value=False)
    if bilinear:
        p.between("drift", x[:1] * sail, -0.6, 0.6)
    p.between("wind", sail + x[1:], 0.2, 3.0)
    p.minimise("distance", np.sum((x - goal) ** 2) + 0.3 * is_set[0] + 0.1 * sail[0] ** 2)
    return p


def draw(rng: np.random.Generator) -> dict[str, Array]:
    return {"goal": rng.uniform(-1.5, 1.5, 2)}


def islands_problem(bilinear: bool = True, **more: Any) -> Problem:
    return Problem("islands", islands(bilinear), draw, **more)


def enumerated(instance: Instance) -> float:
    """The best over all integers, each pinned program from several starts."""
    best = np.inf
    rng = np.random.default_rng(0)
    for is_set, island in product((0.0, 1.0), (0, 1)):
        for _ in range(4):
            x = rng.uniform(instance.lower, instance.upper)
            x[instance.integer] = is_set
            result = solve_candidate(instance, candidate_at(x, np.array([island])))
            if result.objective is not None:
                best = min(best, result.objective)
    return best


def impossible() -> Problem:
    """`far` and `near` conflict; `idle` has nothing to do with it."""
    p = Program("impossible")
    x = p.continuous("x", (2,), -5.0, 5.0)
    p.between("far", x[0], 3.0, 9.0)
    p.between("idle", x[1], -4.0, 4.0)
    p.ball("near", x, 2.0)
    p.minimise("cost", x[0] ** 2)
    return Problem("impossible", p)
