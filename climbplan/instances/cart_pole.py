"""The published cart-pole between soft walls: arXiv 1912.01110, section VI, without terminal set.

A pole on a cart is kept upright by a weak force on the cart, and by pushing the pole's tip against
one of two walls. A wall acts as a spring with a damper and never pulls. That takes two binaries for
each wall and step: whether the tip is in the wall, and whether spring and damper push. With 20
steps there are 80 binaries.

The state is (q, theta, v, omega): cart to the right [m], pole to the left [rad], and their rates.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_discrete_are

from climbplan.arrays import Array
from climbplan.program.problem import Problem
from climbplan.program.statement import Program

HORIZON = 20
STEP = 0.05  # [s]
CART, TIP, LENGTH = 1.0, 1.0, 1.0  # [kg], [kg], [m]
WALL = 0.5  # distance of a wall from the center [m]
STIFFNESS, DAMPING = 100.0, 30.0  # [N/m], [N s/m]
GRAVITY = 10.0  # [m/s^2]
MAX_STATE = np.array([WALL, np.pi / 10, 1.0, 1.0])  # limits of the state
MAX_INPUT = 1.0  # limit of the input [N]
PUSHED = np.array([0.0, 0.0, 1.0, 0.0])  # towards the right wall: where all runs begin
SIDE = np.array([-1.0, 1.0])  # left wall, right wall

# CART dv/dt = u + TIP GRAVITY theta
# LENGTH domega/dt = dv/dt + GRAVITY theta - push / TIP, push: force on the tip to the right
_DRIFT = np.array(
    [
        [0, 0, 1, 0],
        [0, 0, 0, 1],
        [0, GRAVITY * TIP / CART, 0, 0],
        [0, GRAVITY * (CART + TIP) / (CART * LENGTH), 0, 0],
    ]
)
A = np.eye(4) + STEP * _DRIFT
B = STEP * np.array([[0], [0], [1 / CART], [1 / (CART * LENGTH)]])
E = STEP * np.outer([0, 0, 0, 1 / (TIP * LENGTH)], SIDE)  # a wall pushes back


def build_walled_cart_pole(horizon: int = HORIZON) -> Problem:
    """Build the problem: move pole and cart to the center, with parameter `start` (4,).

    `horizon` is the number of steps, 20 as published, with four binaries each.
    """
    p = Program("walled_cart_pole")
    start = p.parameter("start", (4,))
    x = p.continuous("state", (horizon + 1, 4), -MAX_STATE, MAX_STATE)
    u = p.continuous("input", (horizon, 1), -MAX_INPUT, MAX_INPUT, unit="N")
    # Bounded by the force where the tip is deepest and fastest
    deepest = MAX_STATE[0] + LENGTH * MAX_STATE[1] - WALL
    fastest = MAX_STATE[2] + LENGTH * MAX_STATE[3]
    push = p.continuous("push", (horizon, 2), 0.0, STIFFNESS * deepest + DAMPING * fastest, "N")
    inside = p.binary("inside", (horizon, 2))
    pushing = p.binary("pushing", (horizon, 2))

    p.equal("dynamics.start", x[0] - start)
    p.equal("dynamics.step", x[1:] - x[:-1] @ A.T - u @ B.T - push @ E.T)

    tip = x[:-1, 0] - LENGTH * x[:-1, 1]
    rate = x[:-1, 2] - LENGTH * x[:-1, 3]
    depth = tip[:, None] * SIDE - WALL
    law = STIFFNESS * depth + DAMPING * rate[:, None] * SIDE
    p.when("wall.inside", inside, depth, lower=0.0, unit="m")
    p.when("wall.outside", inside, depth, upper=0.0, unit="m", value=False)
    p.when("wall.pushes", pushing, law, lower=0.0, unit="N")
    p.when("wall.would_pull", pushing, law, upper=0.0, unit="N", value=False)
    # Both: the law. Otherwise: nothing.
    p.when("wall.least", inside, push - law, lower=0.0, unit="N")
    p.when("wall.most", pushing, push - law, upper=0.0, unit="N")
    p.when("wall.apart", inside, push, upper=0.0, unit="N", value=False)
    p.when("wall.idle", pushing, push, upper=0.0, unit="N", value=False)

    Q, R = STEP**2 * np.eye(4), STEP**2 * np.eye(1)
    terminal = solve_discrete_are(A, B, Q, R)
    p.minimise("state", sum(row @ Q @ row for row in x[:-1]))
    p.minimise("input", R[0, 0] * np.sum(u**2))
    p.minimise("terminal", x[-1] @ terminal @ x[-1])
    return Problem("walled_cart_pole", p, sample_push)


def sample_push(rng: np.random.Generator) -> dict[str, Array]:
    """Draw the state after a push of random strength towards the right wall."""
    start = rng.uniform(0.2, 0.9) * PUSHED + 0.05 * rng.normal(size=4) * MAX_STATE
    return {"start": np.clip(start, -MAX_STATE, MAX_STATE)}
