"""How a robot braces between walls: on a grid, and where motors are weak by a second look."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.model import Robot
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal.holding import Lack
from climbplan.robots.urdf.proposal.postures import SHIFTED, Legs, Posture, bracing_postures
from climbplan.robots.urdf.proposal.refining import refined
from climbplan.robots.urdf.workspace import farthest_toes

CLEARANCE = 0.02  # [m] of body and knees from walls
SAFETY = 1.2  # S_mu
IN_HAND = 0.95  # of the friction that may be used
WALLS = {1.0: "rubber on anti-slip tape", 1.5: "climbing rubber on grit; it may not brace on less"}
_BRACES = 16  # postures between walls that are kept, for the planner to choose from
_DOUBTED = 0.5  # of the torque limits, from which on postures between walls are looked at again
_LONGEST = 0.97  # share of reach that `farthest_toes` gives


def braces_of(
    robot: Robot, mirror: tuple[int | None, ...], apart: Callable[[Posture], bool]
) -> tuple[tuple[Posture, ...], str]:
    """Postures between walls in which no parts touch, and what is lacking on the roughest.

    robot: as it would be planned with; mirror: the leg on the other side; apart: whether no parts
    touch in a posture.
    """
    if not isinstance(robot.mechanism, SerialChain):
        raise TypeError("a robot from a URDF has chains")
    chain, low, high = robot.mechanism, robot.joint_lower, robot.joint_upper
    box = robot.body_hull.min(axis=0), robot.body_hull.max(axis=0)
    reach = farthest(chain, low, high)
    legs = Legs(chain, low, high, robot.max_torque, reach, robot.weight, mirror, box)

    def clear(points: Array, posture: Posture) -> bool:
        out = np.abs(points[:, :-1, 0]).max() >= posture.gap / 2 - CLEARANCE
        return not out and apart(posture)

    out: list[Posture] = []
    lacks = ""
    for mu in WALLS:
        usable = IN_HAND * mu / SAFETY
        found, lack = bracing_postures(legs, chain.posture, CLEARANCE, usable)
        lacks = f", on walls of friction {mu:g}{lacking(legs, lack)}"
        doubted = lack.share > _DOUBTED
        own = clear_ones = [one for one in found[: None if doubted else _BRACES] if apart(one)]
        if doubted and clear_ones:
            most = SHIFTED[-1] * float(reach.min())
            own, least = refined(legs, clear_ones, usable, most, clear)
            lacks = (
                f", on walls of friction {mu:g}: the motors need {least:.3g} times their "
                f"torque limits with any one limb lifted, by exact kinematics of the shifted body "
                f"in {len(clear_ones)} postures and others drawn about the best"
            )
        if found and not clear_ones:
            lacks = f": parts touch in all {len(found)} that would hold"
        out += [replace(brace, friction=mu) for brace in own[:_BRACES]]
    return tuple(out), lacks


def farthest(chain: SerialChain, lower: Array, upper: Array) -> Array:
    """(N,) farthest toe of sampled postures from the first joint [m]."""
    low, high = np.clip(lower, -np.pi, np.pi), np.clip(upper, -np.pi, np.pi)
    return farthest_toes(chain, low, high) / _LONGEST


def lacking(legs: Legs, lack: Lack) -> str:
    """What motors lack to hold the robot with any one limb lifted."""
    if np.isnan(lack.share):
        return " no posture is in reach, clear of the body"
    if np.isinf(lack.share):
        return (
            " no posture of those looked at, limbs bent as it stands, holds its weight within the "
            "friction cones"
        )
    name = legs.chain.names[lack.limb][lack.joint]
    has = float(legs.torque[lack.limb, lack.joint])
    return (
        f" the motors need {lack.share:.2g} times their torque limits with any one limb lifted: "
        f"{name} {lack.torque:.3g} N m, and has {has:.3g} N m"
    )
