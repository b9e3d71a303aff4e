"""A free-flyer among rectangles: arXiv 2107.08143, section V-B, with thrust of bounded norm.

A point in the plane with a bounded thrust approaches its goal as far as the number of steps allows.
It stays outside every rectangle at each step: left, right, below or above, with one binary each.
The state is (x, y, vx, vy) [m, m/s].
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.program.instance import Instance
from climbplan.program.polytope import Polytope
from climbplan.program.problem import Problem
from climbplan.program.statement import Program

STEP = 0.8  # [s]
SIDE = 4.0  # side of the square table [m]
MAX_SPEED = 1.0  # largest speed along an axis [m/s]
MAX_THRUST = 0.5  # largest norm of the thrust [m/s^2]
HALF_SIDES = (0.15, 0.45)  # range of half sides of rectangles [m]
_CLEARANCE = 0.1  # distance of start and goal from rectangles [m]
_EFFORT = 0.1  # weight against squared distances to the goal
_SIDES = ("left", "right", "below", "above")
_NORMALS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


def build_free_flyer(rng: np.random.Generator, steps: int, rectangles: int) -> Instance:
    """Build an instance with sampled rectangles, start and goal; 4 steps rectangles binaries."""
    problem = build_free_flyer_problem(rng, steps, rectangles)
    return problem.instance(problem.sample_parameters(rng))


def build_free_flyer_problem(rng: np.random.Generator, steps: int, rectangles: int) -> Problem:
    """Build a problem with sampled rectangles and parameters `start` (2,) and `goal` (2,) [m]."""
    center = rng.uniform(0.1 * SIDE, 0.9 * SIDE, (rectangles, 2))
    half = rng.uniform(*HALF_SIDES, (rectangles, 2))
    p = Program("free_flyer")
    start, goal = p.parameter("start", (2,)), p.parameter("goal", (2,))
    low, high = (
        np.array([0.0, 0.0, -MAX_SPEED, -MAX_SPEED]),
        np.array([SIDE, SIDE, MAX_SPEED, MAX_SPEED]),
    )
    x = p.continuous("state", (steps + 1, 4), low, high)
    u = p.continuous("thrust", (steps, 2), -MAX_THRUST, MAX_THRUST, unit="m/s^2")
    p.equal("dynamics.start", x[0] - np.concatenate([start, np.zeros(2)]))
    p.equal("dynamics.place", x[1:, :2] - x[:-1, :2] - STEP * x[:-1, 2:] - 0.5 * STEP**2 * u)
    p.equal("dynamics.rate", x[1:, 2:] - x[:-1, 2:] - STEP * u)
    p.ball("thrust.norm", u, MAX_THRUST, unit="m/s^2")
    for k in range(rectangles):
        edges = [_build_half_plane(side, center[k], half[k]) for side in range(4)]
        p.one_of(f"beside.{k}", x[1:, :2], [edges] * steps, unit="m")
    p.minimise("goal", np.sum((x[1:, :2] - goal) ** 2))
    p.minimise("rest", np.sum(x[-1, 2:] ** 2))
    p.minimise("effort", _EFFORT * np.sum(u**2))

    def sample(rng: np.random.Generator) -> dict[str, Array]:
        start_point = _sample_free_point(rng, center, half, 0.25)
        return {
            "start": start_point,
            "goal": SIDE - _sample_free_point(rng, SIDE - center, half, 0.25),
        }

    return Problem("free_flyer", p, sample)


def _build_half_plane(side: int, center: Array, half: Array) -> Polytope:
    """Return the half plane outside a side of a rectangle."""
    normal = _NORMALS[side]
    edge = normal @ center - np.abs(normal) @ half
    return Polytope.halfspaces(_SIDES[side], normal[None], np.array([edge]))


def _sample_free_point(
    rng: np.random.Generator, center: Array, half: Array, fraction: float
) -> Array:
    """Sample a point in the lower fraction of the table outside all rectangles."""
    while True:
        point = rng.uniform([0.0, 0.0], [SIDE, fraction * SIDE])
        if not (np.abs(point - center) < half + _CLEARANCE).all(axis=1).any():
            return point
