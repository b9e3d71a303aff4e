"""A free-flyer among rectangles: arXiv 2107.08143, section V-B, thrust of bounded norm.

A point in the plane, driven by a thrust whose norm is bounded, comes as near to its goal as so many
steps allow, and stays beside every rectangle at each of them: left, right, below or above, one
binary each. State (x, y, vx, vy) [m, m/s].
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.program.polytope import Polytope
from climbplan.program.problem import Problem
from climbplan.program.statement import Program

STEP = 0.8  # [s]
SIDE = 4.0  # [m] of the table, which is square
FASTEST = 1.0  # [m/s] along an axis
THRUST = 0.5  # [m/s^2] largest norm
HALF = (0.15, 0.45)  # [m] half sides of rectangles
_APART = 0.1  # [m] start and goal from rectangles
_EFFORT = 0.1  # beside squares of distance to the goal
_SIDES = ("left", "right", "below", "above")
_NORMALS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


def free_flyer(rng: np.random.Generator, steps: int, rectangles: int) -> Instance:
    """Rectangles, start and goal are drawn; 4 steps rectangles binaries."""
    problem = free_flyer_problem(rng, steps, rectangles)
    return problem.instance(problem.drawn(rng))


def free_flyer_problem(rng: np.random.Generator, steps: int, rectangles: int) -> Problem:
    """Rectangles are drawn and stay. Parameters: `start` (2,) and `goal` (2,) [m]."""
    middle = rng.uniform(0.1 * SIDE, 0.9 * SIDE, (rectangles, 2))
    half = rng.uniform(*HALF, (rectangles, 2))
    p = Program("free_flyer")
    start, goal = p.parameter("start", (2,)), p.parameter("goal", (2,))
    low, high = np.array([0.0, 0.0, -FASTEST, -FASTEST]), np.array([SIDE, SIDE, FASTEST, FASTEST])
    x = p.continuous("state", (steps + 1, 4), low, high)
    u = p.continuous("thrust", (steps, 2), -THRUST, THRUST, unit="m/s^2")
    p.equal("dynamics.start", x[0] - np.concatenate([start, np.zeros(2)]))
    p.equal("dynamics.place", x[1:, :2] - x[:-1, :2] - STEP * x[:-1, 2:] - 0.5 * STEP**2 * u)
    p.equal("dynamics.rate", x[1:, 2:] - x[:-1, 2:] - STEP * u)
    p.ball("thrust.norm", u, THRUST, unit="m/s^2")
    for k in range(rectangles):
        edges = [_beside(side, middle[k], half[k]) for side in range(4)]
        p.one_of(f"beside.{k}", x[1:, :2], [edges] * steps, unit="m")
    p.minimise("goal", np.sum((x[1:, :2] - goal) ** 2))
    p.minimise("rest", np.sum(x[-1, 2:] ** 2))
    p.minimise("effort", _EFFORT * np.sum(u**2))

    def drawn(rng: np.random.Generator) -> dict[str, Array]:
        begun = _clear(rng, middle, half, 0.25)
        return {"start": begun, "goal": SIDE - _clear(rng, SIDE - middle, half, 0.25)}

    return Problem("free_flyer", p, drawn)


def _beside(side: int, middle: Array, half: Array) -> Polytope:
    """The half plane beside a rectangle."""
    normal = _NORMALS[side]
    edge = normal @ middle - np.abs(normal) @ half
    return Polytope.halfspaces(_SIDES[side], normal[None], np.array([edge]))


def _clear(rng: np.random.Generator, middle: Array, half: Array, share: float) -> Array:
    """A point in the lower part of the table that is in no rectangle."""
    while True:
        point = rng.uniform([0.0, 0.0], [SIDE, share * SIDE])
        if not (np.abs(point - middle) < half + _APART).all(axis=1).any():
            return point
