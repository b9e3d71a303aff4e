"""A cart-pole that balances between two soft walls, as a program of one's own.

The cart may push its pole's tip against a wall and take the force. One binary a wall and step
says whether the tip is in contact; the horizon is 10 steps. Dynamics are linear about upright,
as in arXiv 2310.03344 and 2406.00780. Every method of `climbplan solve` takes it from here:

    climbplan solve specs/cart_pole.yaml --problem specs/cart_pole.py:problem

States (x, theta, v, omega): cart position to the right [m], pole angle to the left [rad], rates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from climbplan.program import Problem, Program

Array = NDArray[np.float64]

HORIZON, STEP = 10, 0.02  # [-], [s]
CART, TIP_MASS, LENGTH, GRAVITY = 1.0, 0.4, 0.6, 9.81  # [kg], [kg], [m], [m/s^2]
STIFFNESS = 50.0  # of both walls [N/m]
WALLS = np.array([0.35, 0.40])  # right, left: distance from the middle [m]
REACH, MOST_FORCE, MOST_INPUT = 0.6, 30.0, 20.0  # [m], [N], [N]
Q, R = np.diag([1.0, 50.0, 1.0, 50.0]), np.array([[0.1]])
SIDE = np.array([1.0, -1.0])  # right wall, left wall

# Newton for the cart and for the tip, with sin(theta) = theta:
#   CART dv/dt = u + TIP_MASS GRAVITY theta
#   LENGTH domega/dt = dv/dt + GRAVITY theta - push / TIP_MASS,  push: force on the tip to the right
_PULL, _FALL = GRAVITY * TIP_MASS / CART, GRAVITY * (CART + TIP_MASS) / (CART * LENGTH)
DRIFT = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, _PULL, 0, 0], [0, _FALL, 0, 0]])
INPUT = np.array([[0], [0], [1 / CART], [1 / (CART * LENGTH)]])
CONTACT = np.outer([0, 0, 0, 1 / (TIP_MASS * LENGTH)], SIDE)  # the right wall pushes left

A, B, E = np.eye(4) + STEP * DRIFT, STEP * INPUT, STEP * CONTACT


def cart_pole(damping: float = 0.0, horizon: int = HORIZON) -> Program:
    """Bring the pole upright and the cart to the middle with least effort.

    damping: [s/m] of the walls after Hunt and Crossley: force = STIFFNESS depth (1 + damping rate),
    bilinear in depth and rate; 0 for springs, which leaves a mixed-integer quadratic program.
    horizon: steps of 0.02 s.
    Parameters: `start` (4,) state, `walls` (2,) distances of the right and left wall [m].
    """
    p = Program("cart_pole")
    start, walls = p.parameter("start", (4,)), p.parameter("walls", (2,))

    most = np.array([REACH, np.pi / 2, 2 * REACH / STEP, np.pi / STEP])
    x = p.continuous("state", (horizon + 1, 4), -most, most)
    u = p.continuous("input", (horizon, 1), -MOST_INPUT, MOST_INPUT, unit="N")
    force = p.continuous("force", (horizon, 2), 0.0, MOST_FORCE, unit="N")
    touch = p.binary("touch", (horizon, 2))

    # Dynamics, linear about upright
    p.equal("dynamics.start", x[0] - start)
    p.equal("dynamics.step", x[1:] - x[:-1] @ A.T - u @ B.T - force @ E.T)

    # Depth of the tip in each wall, positive in contact
    tip = x[:-1, 0] - LENGTH * x[:-1, 1]
    depth = tip[:, None] * SIDE - walls
    p.between("tip.reach", tip, -REACH, REACH, unit="m")

    # Soft walls: a spring in contact, nothing otherwise
    law = force - STIFFNESS * depth
    if damping:
        # As variables, so that one product a step serves both walls
        tip_rate = p.continuous("tip_rate", (horizon,), -2 / damping, 2 / damping, unit="m/s")
        place = p.continuous("tip", (horizon,), -REACH, REACH, unit="m")
        p.equal("tip.place", place - tip, unit="m")
        p.equal("tip.rate", tip_rate - x[:-1, 2] + LENGTH * x[:-1, 3], unit="m/s")
        rate = tip_rate[:, None] * SIDE
        law = law - STIFFNESS * damping * (place[:, None] * SIDE - walls) * rate
    p.when("wall.law", touch, law, 0.0, 0.0, unit="N")
    p.when("wall.inside", touch, depth, lower=0.0, unit="m")
    p.when("wall.free", touch, force, upper=0.0, unit="N", value=False)
    p.when("wall.outside", touch, depth, upper=0.0, unit="m", value=False)

    # Cost: as the infinite horizon would have it without walls
    terminal = solve_discrete_are(A, B, Q, R)
    p.minimise("state", sum(row @ Q @ row for row in x[:-1]))
    p.minimise("input", R[0, 0] * np.sum(u**2))
    p.minimise("terminal", x[-1] @ terminal @ x[-1])
    return p


def random_theta(rng: np.random.Generator) -> dict[str, Array]:
    """A tip near one of the walls and moving into it; walls a little off their place."""
    walls = WALLS + rng.uniform(-0.03, 0.03, 2)
    side = int(rng.integers(2))
    tip = SIDE[side] * (walls[side] + rng.uniform(-0.12, 0.06))
    tip_rate = SIDE[side] * rng.uniform(0.0, 1.5)
    theta, v = rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5)
    x = np.clip(tip + LENGTH * theta, -0.9 * REACH, 0.9 * REACH)
    return {"start": np.array([x, theta, v, (v - tip_rate) / LENGTH]), "walls": walls}


def contact_features(theta: dict[str, Array]) -> Array:
    """What decides when the tip is in a wall: its distances, its rate, and how the pole falls."""
    x, angle, v, rate = theta["start"]
    tip = x - LENGTH * angle
    return np.array([*(tip * SIDE - theta["walls"]), v - LENGTH * rate, angle])


def problem() -> Problem:
    """Walls that damp: a mixed-integer bilinear program."""
    return Problem("cart_pole", cart_pole(0.1), random_theta, contact_features, {"tip": 4})


def springs() -> Problem:
    """Walls without damping: a mixed-integer quadratic program."""
    return Problem("cart_pole_springs", cart_pole(), random_theta, contact_features)


def long_springs() -> Problem:
    """The same over 30 steps, where learned integers make branch and bound faster."""
    return Problem("cart_pole_long", cart_pole(horizon=30), random_theta, contact_features)
