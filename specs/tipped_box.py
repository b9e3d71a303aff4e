"""A box that is tipped over its edge by pushing at its upper left corner: a program of one's own.

The plane, seen from the side: x to the right, z up, angle to the left. The box stands on the
ground, turns about its lower right corner and is laid down on its right side. Rotations and corners
are smooth blocks, moments products, contacts implications of one binary a corner and knot:

    climbplan solve specs/tipped_box.yaml --problem specs/tipped_box.py:problem

`problem` leaves the contacts open (pinned, mpcc, mccormick), `scheduled` has them given (nlp).
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from climbplan.program import Problem, Program
from climbplan.program.smooth import over_knots

Array = NDArray[np.float64]

KNOTS, STEP = 16, 0.08  # [s]
MASS, HALF = 1.0, np.array([0.1, 0.2])  # [kg], half width and height [m]
INERTIA = MASS * float(HALF @ HALF) / 3  # [kg m^2]
GRAVITY, FRICTION, MOST_PUSH, MOST_FORCE = 9.81, 0.8, 12.0, 40.0
CORNERS = HALF * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # left low, right low, ... [m]
PIVOT, LANDS, PUSHED = 1, 2, 3  # corners
GOAL = np.array([HALF.sum(), HALF[0], -np.pi / 2])  # pose (x, z, angle) on its right side


def corner_positions() -> ca.Function:
    """Pose (3,) -> the four corners, world frame (8,)."""
    pose = ca.SX.sym("pose", 3)
    c, s = ca.cos(pose[2]), ca.sin(pose[2])
    places = [pose[:2] + ca.vertcat(c * x - s * z, s * x + c * z) for x, z in CORNERS]
    return ca.Function("corners", [pose], [ca.vertcat(*places)])


def tipped_box(schedule: NDArray[np.bool_] | None = None) -> Program:
    """Lay the box on its side with least push.

    schedule: (KNOTS + 1, 4) which corner touches when; binaries if left out.
    Parameter: `start` (3,), the pose at the beginning, where the box is at rest.
    """
    p = Program("tipped_box")
    start = p.parameter("start", (3,))
    low, high = np.array([-0.3, 0.05, -2.0]), np.array([0.7, 0.3, 0.3])
    pose = p.continuous("pose", (KNOTS + 1, 3), low, high, unit="m, m, rad")
    rate = p.continuous("rate", (KNOTS + 1, 3), -8.0, 8.0, unit="m/s, m/s, rad/s")
    corner = p.continuous("corner", (KNOTS + 1, 4, 2), [-0.6, 0.0], [1.0, 0.5], unit="m")
    ground = p.continuous("ground", (KNOTS + 1, 4, 2), [-MOST_FORCE, 0.0], MOST_FORCE, unit="N")
    push = p.continuous("push", (KNOTS + 1, 2), -MOST_PUSH, MOST_PUSH, unit="N")

    # Where corners are: a rotation, the same function at every knot
    places = over_knots(corner_positions(), [pose])
    p.smooth("corner.place", corner.reshape(KNOTS + 1, 8) - places, unit="m")

    # From rest to rest
    p.equal("start.pose", pose[0] - start)
    p.equal("start.rate", rate[0])
    p.between("goal.pose", pose[-1], GOAL - 1e-3, GOAL + 1e-3)
    p.between("goal.rate", rate[-1], -0.05, 0.05)

    # Newton and Euler, implicit: forces at the end of a step act through it
    p.equal("dynamics.pose", pose[1:] - pose[:-1] - STEP * rate[1:])
    force = ground.sum(axis=1) + push - np.array([0.0, MASS * GRAVITY])
    p.equal("dynamics.force", MASS * (rate[1:, :2] - rate[:-1, :2]) - STEP * force[1:], unit="N s")
    arm = corner - pose[:, None, :2]
    moment = (arm[:, :, 0] * ground[:, :, 1] - arm[:, :, 1] * ground[:, :, 0]).sum(axis=1)
    moment = moment + arm[:, PUSHED, 0] * push[:, 1] - arm[:, PUSHED, 1] * push[:, 0]
    turn = INERTIA * (rate[1:, 2] - rate[:-1, 2])
    p.equal("dynamics.moment", turn - STEP * moment[1:], unit="N m s")

    # Contacts hold: a corner that touches stays where it is, within the friction cone
    slide = corner[1:, :, 0] - corner[:-1, :, 0]
    cone = ground[..., [0]] * [1.0, -1.0] - FRICTION * ground[..., [1]]  # (KNOTS + 1, 4, 2)
    if schedule is None:
        touch = p.binary("touch", (KNOTS + 1, 4))
        p.when("contact.height", touch[1:], corner[1:, :, 1], 0.0, 0.0, unit="m")
        p.when("contact.slide", touch[:-1], slide, 0.0, 0.0, unit="m")
        p.when("contact.friction", touch[..., None], cone, upper=0.0, unit="N")
        p.when("contact.none", touch[..., None], ground, 0.0, 0.0, unit="N", value=False)
    else:
        p.equal("contact.height", corner[1:][schedule[1:]][:, 1], unit="m")
        p.equal("contact.slide", slide[schedule[:-1]], unit="m")
        p.between("contact.friction", cone[schedule], -np.inf, 0.0, unit="N")
        p.equal("contact.none", ground[~schedule], unit="N")
    p.minimise("push", STEP * np.sum(push**2))
    p.minimise("smooth", 0.01 * np.sum((rate[1:] - rate[:-1]) ** 2))
    return p


def turning() -> NDArray[np.bool_]:
    """Which corner touches when: both low ones, the pivot alone, then the right side."""
    touch = np.zeros((KNOTS + 1, 4), bool)
    touch[:, PIVOT] = True
    touch[0, 0], touch[-1, LANDS] = True, True
    return touch


def guess(theta: dict[str, Array]) -> dict[str, Array]:
    """The box turning evenly about its lower right corner, carried by it."""
    angle = np.linspace(0.0, GOAL[2], KNOTS + 1)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]]).transpose(2, 0, 1)  # (KNOTS + 1, 2, 2)
    centre = np.array([HALF[0], 0.0]) - turn @ CORNERS[PIVOT]
    ground = np.zeros((KNOTS + 1, 4, 2))
    ground[:, PIVOT, 1] = MASS * GRAVITY
    found = {
        "pose": np.column_stack([centre, angle]),
        "corner": centre[:, None] + np.einsum("kij,nj->kni", turn, CORNERS),
        "ground": ground,
        "touch": turning().astype(float),
    }
    return found


def _drawn(rng: np.random.Generator) -> dict[str, Array]:
    return {"start": np.array([0.0, HALF[1], 0.0])}


problem = Problem("tipped_box", tipped_box(), sample=_drawn, start=guess)
scheduled = Problem(
    "tipped_box_scheduled",
    tipped_box(turning()),
    sample=_drawn,
    start=lambda theta: {k: v for k, v in guess(dict(theta)).items() if k != "touch"},
)
