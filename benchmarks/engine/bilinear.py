"""Problems with products for trees that branch in space: a flyer that turns, a box that is pushed.

Rotations are (c, s) = (cos, sin) and turn by the Cayley map, which keeps c^2 + s^2 = 1: with t the
tangent of half the angle of a step, c' - c = -t (s' + s) and s' - s = t (c' + c). So all that is
not linear is a product of two variables.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from climbplan.arrays import Array
from climbplan.program.polytope import Polytope
from climbplan.program.problem import Problem
from climbplan.program.statement import Program

# Flyer
STEP = 0.8  # [s]
SIDE = 3.0  # [m] of the table, which is square
FASTEST = 1.0  # [m/s] along an axis
THRUST = 0.6  # [m/s^2] most of the one thruster
MOST_TURN = 0.35  # largest tangent of half a step's angle
OBSTACLES = np.array([[1.0, 1.1], [2.0, 1.7]])  # [m] middles
HALF_SIDES = np.array([[0.3, 0.25], [0.25, 0.3]])  # [m]

# Pushed box
HALF = 0.05  # [m] half its side
MOST_PUSH = 1.0  # largest force, by the weight that slides
PUSH_FRICTION = 0.3  # of the finger
GIVE = 0.04  # [m] by which a step's largest force moves the box
REACH = 0.3  # [m] of the table to each side


def _turned(p: Program, heading: Any, turn: Any) -> None:
    """(c, s) (T + 1, 2) by tangents of half angles (T,)."""
    c, s = heading[:, 0], heading[:, 1]
    p.equal("turn.c", c[1:] - c[:-1] + turn * s[1:] + turn * s[:-1])
    p.equal("turn.s", s[1:] - s[:-1] - turn * c[1:] - turn * c[:-1])


def turning_flyer(steps: int) -> Problem:
    """One thruster, fixed to a body that turns; beside two blocks, as near to the goal as may be.

    Parameters: `start` (4,) [m, m/s], `heading` (2,) cosine and sine, `goal` (2,) [m].
    """
    p = Program("turning_flyer")
    start, begun = p.parameter("start", (4,)), p.parameter("heading", (2,))
    goal = p.parameter("goal", (2,))
    low, high = np.array([0.0, 0.0, -FASTEST, -FASTEST]), np.array([SIDE, SIDE, FASTEST, FASTEST])
    x = p.continuous("state", (steps + 1, 4), low, high)
    heading = p.continuous("direction", (steps + 1, 2), -1.0, 1.0)
    thrust = p.continuous("thrust", (steps,), 0.0, THRUST, unit="m/s^2")
    turn = p.continuous("turn", (steps,), -MOST_TURN, MOST_TURN)
    p.equal("start.state", x[0] - start)
    p.equal("start.heading", heading[0] - begun)
    _turned(p, heading, turn)
    pushed = thrust[:, None] * heading[1:]
    p.equal("move.place", x[1:, :2] - x[:-1, :2] - STEP * x[:-1, 2:] - 0.5 * STEP**2 * pushed)
    p.equal("move.rate", x[1:, 2:] - x[:-1, 2:] - STEP * pushed)
    for k, (middle, half) in enumerate(zip(OBSTACLES, HALF_SIDES, strict=True)):
        sides = [
            Polytope.halfspaces(name, normal[None], np.array([normal @ middle - reach]))
            for name, normal, reach in (
                ("left", np.array([1.0, 0.0]), half[0]),
                ("right", np.array([-1.0, 0.0]), half[0]),
                ("below", np.array([0.0, 1.0]), half[1]),
                ("above", np.array([0.0, -1.0]), half[1]),
            )
        ]
        p.one_of(f"beside.{k}", x[1:, :2], [sides] * steps, unit="m")
    p.minimise("goal", np.sum((x[-1, :2] - goal) ** 2))
    p.minimise("rest", 0.2 * np.sum(x[-1, 2:] ** 2))
    p.minimise("effort", 0.05 * np.sum(thrust**2) + 0.05 * np.sum(turn**2))
    return Problem("turning_flyer", p, _random_flight)


def _random_flight(rng: np.random.Generator) -> dict[str, Array]:
    angle = rng.uniform(-np.pi, np.pi)
    place = rng.uniform([0.1, 0.1], [2.9, 0.7])
    return {
        "start": np.concatenate([place, rng.uniform(-0.2, 0.2, 2)]),
        "heading": np.array([np.cos(angle), np.sin(angle)]),
        "goal": rng.uniform([0.3, 2.2], [2.7, 2.8]),
    }


def planar_push(steps: int) -> Problem:
    """A finger pushes a square box over a table, at its left or lower face, quasi-statically.

    The box slides along the force (a round limit surface: Lynch, Maekawa and Tanie 1992); where the
    finger stands on its face and at which face it stands is chosen anew at each step.
    Parameter: `goal` (4,) place [m], cosine and sine of the box.
    """
    p = Program("planar_push")
    goal = p.parameter("goal", (4,))
    place = p.continuous("place", (steps + 1, 2), -REACH, REACH, unit="m")
    heading = p.continuous("direction", (steps + 1, 2), [0.3, -0.95], [1.0, 0.95])
    turn = p.continuous("turn", (steps,), -0.3, 0.3)
    force = p.continuous("force", (steps, 2), -MOST_PUSH, MOST_PUSH)  # in the box's frame
    along = p.continuous("along", (steps,), -HALF, HALF, unit="m")  # where on the face
    press = p.continuous("press", (steps,), 0.0, MOST_PUSH)
    left = p.binary("left", (steps,))
    p.equal("start", np.concatenate([place[0], heading[0] - np.array([1.0, 0.0])]))
    c, s = heading[:-1, 0], heading[:-1, 1]
    moved = np.stack([c * force[:, 0] - s * force[:, 1], s * force[:, 0] + c * force[:, 1]], axis=1)
    p.equal("move.place", place[1:] - place[:-1] - GIVE * moved, unit="m")
    _turned(p, heading, turn)
    # A moment of HALF times the largest force turns by GIVE / HALF
    lever = along * press
    scale = 0.5 * GIVE / HALF**2
    for name, value, other, sign in (("left", True, 1, -1.0), ("lower", False, 0, 1.0)):
        slide = force[:, other]
        p.when(f"{name}.press", left, press - force[:, 1 - other], 0.0, 0.0, value=value)
        p.when(f"{name}.slips", left, slide - PUSH_FRICTION * press, upper=0.0, value=value)
        p.when(f"{name}.slides", left, -slide - PUSH_FRICTION * press, upper=0.0, value=value)
        moment = sign * (HALF * slide + lever)
        p.when(f"{name}.turns", left, turn - scale * moment, 0.0, 0.0, value=value)
    p.minimise("place", 100.0 * np.sum((place[-1] - goal[:2]) ** 2))
    p.minimise("heading", np.sum((heading[-1] - goal[2:]) ** 2))
    p.minimise("effort", 0.01 * np.sum(press**2))
    return Problem("planar_push", p, _random_goal)


def _random_goal(rng: np.random.Generator) -> dict[str, Array]:
    angle = rng.uniform(-0.6, 0.6)
    return {"goal": np.array([*rng.uniform(0.02, 0.1, 2), np.cos(angle), np.sin(angle)])}
