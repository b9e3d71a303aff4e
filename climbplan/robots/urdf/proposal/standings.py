"""How a robot whose legs are settled may stand: its postures, one kind after another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.robots.urdf.building import LEAST_BALL
from climbplan.robots.urdf.proposal.braces import CLEARANCE, IN_HAND, SAFETY, lacking
from climbplan.robots.urdf.proposal.corridor import corridor_postures
from climbplan.robots.urdf.proposal.holding import Lack
from climbplan.robots.urdf.proposal.leaning import leaning_postures
from climbplan.robots.urdf.proposal.postures import Legs, Posture, standing_postures
from climbplan.robots.urdf.proposal.settled import FLOOR, Settled
from climbplan.robots.urdf.proposal.soled import soled_postures
from climbplan.robots.urdf.proposal.soles import Soles
from climbplan.robots.urdf.workspace import common_reach, stance_balls

_TRIED = 24  # postures whose room is measured with exact kinematics
_LONGEST = 0.97  # share of reach that `farthest_toes` gives
_UNLIKE = 10.0  # [deg] by which ranges of joints on both sides differ where a URDF mixes them up
_STRONG = 100.0  # times the torque limits, to see what is missing


def standing(found: Settled, walls: bool = True) -> Settled:
    """The robot with its standing postures, roomiest first.

    walls: whether hands may be on walls where the ground alone does not do.

    Raises UsageError where it stands in no posture.
    """
    legs, names = found.legs, found.named

    def fine(tried: list[Posture]) -> list[Posture]:
        return [one for one in tried if not found.touching(one)]

    if found.soles is not None:
        return replace(found, standings=tuple(_on_soles(found, found.soles, fine)))
    lack = Lack()
    standings = _roomiest(legs, fine(standing_postures(legs, _TRIED)))
    usable = IN_HAND * FLOOR / SAFETY
    beside = None if standings else found.beside()
    if not standings:
        tried = fine(leaning_postures(legs, found.center, usable, beside))
        standings = _roomiest(legs, tried[:_TRIED])
    if not standings and walls and any(names.arms):
        tried, lack = corridor_postures(
            legs, np.array(names.arms), found.center, CLEARANCE, usable, beside
        )
        tried = fine([replace(one, friction=FLOOR) for one in tried])
        standings = _roomiest(legs, tried[:_TRIED])
    if not standings:
        strong = replace(legs, torque=_STRONG * legs.torque)
        lacks = f"; on level ground{_too_weak(legs, fine(standing_postures(strong, _TRIED)))}"
        if any(names.arms):
            lacks += f"; standing on its feet with its hands on walls{lacking(legs, lack)}"
        lacks += _unlike(legs)
        raise UsageError(
            f"{found.tree.path}: found no posture in which it stands with {', '.join(names.names)} "
            f"(toes {', '.join(toe.link for toe in found.toes)}): `climbplan new robot --example "
            f"robot_walker` shows what to write by hand{lacks}"
        )
    return replace(found, standings=tuple(standings))


def _on_soles(
    found: Settled, soles: Soles, fine: Callable[[list[Posture]], list[Posture]]
) -> list[Posture]:
    """Standing postures of a biped; raises UsageError where there are none."""
    legs, level = found.legs, np.swapaxes(soles.axes_zero, -1, -2)
    standings = _roomiest(legs, fine(soled_postures(legs, soles, found.center)), level)
    if standings:
        return standings
    strong = replace(legs, torque=_STRONG * legs.torque)
    held = fine(soled_postures(strong, soles, found.center))
    lacks = " none is in reach with its soles level, clear of itself, however strong the motors"
    if held:
        least = _STRONG * min(posture.use for posture in held)
        lacks = f" the motors need {least:.3g} times their torque limits on one leg"
        if least < 1:
            lacks = f" soles that stay level have less than {1e3 * LEAST_BALL:.0f} mm to every side"
    raise UsageError(
        f"{found.tree.path}: found no posture in which it stands on two flat feet "
        f"({', '.join(toe.link for toe in soles.toes)}), the body going over either;{lacks}"
    )


def _roomiest(legs: Legs, found: list[Posture], level: Array | None = None) -> list[Posture]:
    """Postures by their room by exact kinematics, less what motors have not left; best first.

    level: turns (N, 3, 3) of last links with which soles are level.
    """
    by_worth = []
    for posture in found:
        chain = replace(legs.chain, posture=posture.angles)
        ball = stance_balls(
            chain, posture.toes, common_reach(legs.reach) * _LONGEST, legs.lower, legs.upper, level
        )
        room = float(ball.min())
        if level is not None:  # balls leave out what is beyond reach: nearly straight legs have all
            room = float(np.sqrt(room * posture.room)) if room >= LEAST_BALL else 0.0
        worth = room * (1 - posture.use)
        if worth > 0:
            by_worth.append((worth, posture))
    return [posture for _, posture in sorted(by_worth, key=lambda pair: -pair[0])]


def _unlike(legs: Legs) -> str:
    """Joints of legs on both sides that turn by different angles; empty where there are none."""
    span = np.rad2deg(np.minimum(legs.upper - legs.lower, 2 * np.pi))
    told = [
        f"{legs.chain.names[i][j]} {span[i, j]:.0f} and {legs.chain.names[k][j]} {span[k, j]:.0f}"
        for i, k in enumerate(legs.mirror)
        if k is not None and i < k
        for j in range(span.shape[1])
        if abs(span[i, j] - span[k, j]) > _UNLIKE
    ]
    if not told:
        return ""
    return f"; joints on its two sides turn by different angles [deg]: {', '.join(told)}"


def _too_weak(legs: Legs, found: list[Posture]) -> str:
    """What motors lack in the best of postures that stronger ones would hold."""
    if not found:
        return " none is in reach, clear of the ground and of itself, however strong the motors"
    best = min(found, key=lambda posture: posture.use)
    force = np.zeros((len(best.toes), 3))
    force[:, 2] = legs.weight / min(3, len(force))
    needed = np.abs(np.einsum("nij,ni->nj", legs.chain.jacobian(best.angles), force))
    leg, joint = np.unravel_index(int(np.argmax(needed / legs.torque)), needed.shape)
    name, has = legs.chain.names[leg][joint], float(legs.torque[leg, joint])
    return (
        f" the motors need {_STRONG * best.use:.2g} times their torque limits on three legs: "
        f"{name} {needed[leg, joint]:.3g} N m, and has {has:.3g} N m"
    )
