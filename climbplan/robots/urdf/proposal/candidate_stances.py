"""Candidate stances of a prepared robot, from one search after another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.robots.urdf.proposal.bracing_grid_search import (
    WALL_CLEARANCE,
    compute_usable_friction,
    describe_torque_demand,
)
from climbplan.robots.urdf.proposal.flat_foot_stance import search_flat_foot_stances
from climbplan.robots.urdf.proposal.lift_torque import TorqueDemand
from climbplan.robots.urdf.proposal.postures import (
    LeggedPosture,
    LegModel,
    search_standing_postures,
)
from climbplan.robots.urdf.proposal.prepared_robot import FLOOR_FRICTION, PreparedRobot
from climbplan.robots.urdf.proposal.soles import Soles
from climbplan.robots.urdf.proposal.wall_supported_stance import search_wall_supported_stances
from climbplan.robots.urdf.proposal.weight_shift_stance import search_weight_shift_stances
from climbplan.robots.urdf.robot_builder import MIN_STANCE_RADIUS
from climbplan.robots.urdf.workspace import measure_stance_radii, select_common_reach

_MAX_CANDIDATES = 24  # postures whose stance radius is measured with exact kinematics
_MAX_SWAYED = 40  # postures in which the body sways, of which these are the best
_SWAYS = (0.1, 0.2)  # of the body to every side, over the reach of the legs
_NUM_SWAY_DIRECTIONS = 8
_FULL_CLEARANCE = 0.025  # of links while the body sways, over the reach, that costs no score
_MIN_CLEARANCE_FACTOR = 0.1  # on the score of postures in which links are in each other's way
_REACH_RATIO = 0.97  # of the full reach, that `estimate_reach` returns
_MAX_RANGE_DIFFERENCE = 10.0  # [deg] between joint ranges of mirrored legs
_STRONG_FACTOR = 100.0  # of the torque limits, to quantify what is missing

SelectClear = Callable[[list[LeggedPosture]], list[LeggedPosture]]
"""Returns the postures in which no parts of the robot touch."""


def find_candidate_stances(robot: PreparedRobot, walls: bool = True) -> PreparedRobot:
    """Return the robot with its candidate stances, the largest stance radius first.

    Legs that bear equal loads are tried first, then the shifted body, then hands on walls.

    Args:
        robot: The robot before its stances are known.
        walls: Whether hands may be on walls where the ground alone does not suffice.

    Raises:
        UsageError: It stands in no posture.
    """
    legs, is_arm = robot.legs, robot.naming.is_arm

    def select_clear(postures: list[LeggedPosture]) -> list[LeggedPosture]:
        return [posture for posture in postures if not robot.has_self_collision(posture)]

    if robot.soles is not None:
        stances = _find_flat_foot_stances(robot, robot.soles, select_clear)
        return replace(robot, stances=tuple(stances))
    demand = TorqueDemand()
    postures = _prefer_clear_postures(robot, search_standing_postures(legs, _MAX_SWAYED))
    stances = _rank_by_stance_radius(legs, select_clear(postures[:_MAX_CANDIDATES]))
    friction = compute_usable_friction(FLOOR_FRICTION)
    compute_clearance = None if stances else robot.build_clearance_function()
    if not stances:
        postures = select_clear(
            search_weight_shift_stances(legs, robot.compute_center, friction, compute_clearance)
        )
        stances = _rank_by_stance_radius(legs, postures[:_MAX_CANDIDATES])
    if not stances and walls and any(is_arm):
        postures, demand = search_wall_supported_stances(
            legs,
            np.array(is_arm),
            robot.compute_center,
            WALL_CLEARANCE,
            friction,
            compute_clearance,
        )
        postures = select_clear([replace(posture, friction=FLOOR_FRICTION) for posture in postures])
        stances = _rank_by_stance_radius(legs, postures[:_MAX_CANDIDATES])
    if not stances:
        raise UsageError(_describe_failure(robot, demand, select_clear))
    return replace(robot, stances=tuple(stances))


def _describe_failure(robot: PreparedRobot, demand: TorqueDemand, select_clear: SelectClear) -> str:
    """Return the message for a robot that stands in no posture."""
    legs, names = robot.legs, robot.naming
    strong = replace(legs, torque=_STRONG_FACTOR * legs.torque)
    held_by_strong = select_clear(search_standing_postures(strong, _MAX_CANDIDATES))
    reasons = f"; on level ground{_describe_weak_motor(legs, held_by_strong)}"
    if any(names.is_arm):
        reasons += (
            f"; standing on its feet with its hands on walls{describe_torque_demand(legs, demand)}"
        )
    reasons += _describe_unequal_ranges(legs)
    return (
        f"{robot.tree.path}: found no posture in which it stands with {', '.join(names.names)} "
        f"(toes {', '.join(toe.link for toe in robot.toes)}): `climbplan new robot --example "
        f"robot_walker` shows what to write by hand{reasons}"
    )


def _find_flat_foot_stances(
    robot: PreparedRobot, soles: Soles, select_clear: SelectClear
) -> list[LeggedPosture]:
    """Return the stances of a biped; raises UsageError where there are none."""
    legs, level = robot.legs, np.swapaxes(soles.axes_zero, -1, -2)
    postures = select_clear(search_flat_foot_stances(legs, soles, robot.compute_center))
    postures = _prefer_clear_postures(robot, postures, level)
    stances = _rank_by_stance_radius(legs, postures, level)
    if stances:
        return stances
    strong = replace(legs, torque=_STRONG_FACTOR * legs.torque)
    held_by_strong = select_clear(search_flat_foot_stances(strong, soles, robot.compute_center))
    reason = " none is in reach with its soles level, clear of itself, however strong the motors"
    if held_by_strong:
        required = _STRONG_FACTOR * min(posture.utilisation for posture in held_by_strong)
        reason = f" the motors need {required:.3g} times their torque limits on one leg"
        if required < 1:
            radius = 1e3 * MIN_STANCE_RADIUS
            reason = f" soles that stay level have less than {radius:.0f} mm to every side"
    raise UsageError(
        f"{robot.tree.path}: found no posture in which it stands on two flat feet "
        f"({', '.join(toe.link for toe in soles.toes)}), the body going over either;{reason}"
    )


def _rank_by_stance_radius(
    legs: LegModel, postures: list[LeggedPosture], level: Array | None = None
) -> list[LeggedPosture]:
    """Return postures by stance radius, exact kinematics, times the unused torque; best first.

    level: rotations (N, 3, 3) of last links with which soles are level. Postures without any
    stance radius are left out.
    """
    scored = []
    for posture in postures:
        chain = replace(legs.chain, posture=posture.angles)
        reach = select_common_reach(legs.reach) * _REACH_RATIO
        radii = measure_stance_radii(chain, posture.toes, reach, legs.lower, legs.upper, level)
        radius = float(radii.min())
        if level is not None:
            # Balls leave out points beyond reach, of which nearly straight legs have many
            is_enough = radius >= MIN_STANCE_RADIUS
            radius = float(np.sqrt(radius * posture.reach_margin)) if is_enough else 0.0
        score = radius * (1 - posture.utilisation) * _compute_clearance_factor(legs, posture)
        if score > 0:
            scored.append((score, posture))
    return [posture for _, posture in sorted(scored, key=lambda pair: -pair[0])]


def _prefer_clear_postures(
    robot: PreparedRobot, postures: list[LeggedPosture], level: Array | None = None
) -> list[LeggedPosture]:
    """Return postures with their clearance while the body sways; best first by score and clearance.

    A robot that walks with one limb at a time has its body over the others, and links that are
    clear as it stands come near the body or other limbs there. Links are as thick as in planning.

    Args:
        robot: The robot.
        postures: Toes in the frame of the chains.
        level: Rotations (N, 3, 3) of last links with which soles are level; None for other feet.
    """
    compute_clearance = robot.build_clearance_function(to_body=True)
    if compute_clearance is None or not postures:
        return postures
    legs = robot.legs
    angle = 2 * np.pi * np.arange(_NUM_SWAY_DIRECTIONS) / _NUM_SWAY_DIRECTIONS
    direction = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    sways = float(legs.reach.min()) * np.concatenate([size * direction for size in _SWAYS])
    angles = []
    for posture in postures:
        chain = replace(legs.chain, posture=posture.angles)
        solution = chain.inverse(posture.toes - sways[:, None], legs.lower, legs.upper, level)
        swayed = np.where(solution.valid[..., None], solution.best(), posture.angles)
        angles.append(np.concatenate([posture.angles[None], swayed]))
    clearances = compute_clearance(np.concatenate(angles)).reshape(len(postures), -1).min(axis=1)
    rated = [
        replace(posture, sway_clearance=float(clearance))
        for posture, clearance in zip(postures, clearances, strict=True)
    ]
    return sorted(rated, key=lambda p: -p.score * _compute_clearance_factor(legs, p))


def _compute_clearance_factor(legs: LegModel, posture: LeggedPosture) -> float:
    """Return the factor on a posture's score for its clearance while the body sways, up to 1."""
    full = _FULL_CLEARANCE * float(legs.reach.min())
    factor = 0.5 * (1.0 + posture.sway_clearance / full)
    return float(np.clip(factor, _MIN_CLEARANCE_FACTOR, 1.0))


def _describe_unequal_ranges(legs: LegModel) -> str:
    """Return the joints of mirrored legs whose ranges differ; empty where there are none."""
    span = np.rad2deg(np.minimum(legs.upper - legs.lower, 2 * np.pi))
    unequal = [
        f"{legs.chain.names[i][j]} {span[i, j]:.0f} and {legs.chain.names[k][j]} {span[k, j]:.0f}"
        for i, k in enumerate(legs.mirrored_legs)
        if k is not None and i < k
        for j in range(span.shape[1])
        if abs(span[i, j] - span[k, j]) > _MAX_RANGE_DIFFERENCE
    ]
    if not unequal:
        return ""
    return f"; joints on its two sides turn by different angles [deg]: {', '.join(unequal)}"


def _describe_weak_motor(legs: LegModel, held_by_strong: list[LeggedPosture]) -> str:
    """Return what motors lack in the best of the postures that stronger ones would hold."""
    if not held_by_strong:
        return " none is in reach, clear of the ground and of itself, however strong the motors"
    best = min(held_by_strong, key=lambda posture: posture.utilisation)
    force = np.zeros((len(best.toes), 3))
    force[:, 2] = legs.weight / min(3, len(force))
    needed = np.abs(np.einsum("nij,ni->nj", legs.chain.jacobian(best.angles), force))
    leg, joint = np.unravel_index(int(np.argmax(needed / legs.torque)), needed.shape)
    name, limit = legs.chain.names[leg][joint], float(legs.torque[leg, joint])
    return (
        f" the motors need {_STRONG_FACTOR * best.utilisation:.2g} times their torque limits on "
        f"three legs: {name} {needed[leg, joint]:.3g} N m, and has {limit:.3g} N m"
    )
