"""Bracing postures of a robot between two walls, by grid search and refinement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.model import Robot
from climbplan.robots.self_clearance import compute_limb_clearance, list_clearance_pairs
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal.brace_refinement import refine_braces
from climbplan.robots.urdf.proposal.lift_torque import TorqueDemand
from climbplan.robots.urdf.proposal.postures import (
    MAX_SHIFT_RATIOS,
    LeggedPosture,
    LegModel,
    keep_off_bounds,
    search_bracing_postures,
)
from climbplan.robots.urdf.workspace import estimate_reach

WALL_CLEARANCE = 0.02  # [m] of body and knees from walls
# Of links as thick as in planning from walls and from other limbs:
_LINK_CLEARANCE = 0.02  # [m], of robots that are not small
_LINK_CLEARANCE_RATIO = 0.05  # over the distance of the nearest wall, of small robots
_AT_TOE = 3.0  # radii of a last link from its toe, within which it is at the wall
FRICTION_SAFETY = 1.2  # S_mu
_USED_FRICTION = 0.95  # fraction of the admissible friction that the search relies on
WALL_FRICTIONS = {
    1.0: "rubber on anti-slip tape",
    1.5: "climbing rubber on grit; it may not brace on less",
}
_MAX_BRACES = 16  # postures that the planner chooses from
_REFINE_ABOVE = 0.5  # utilisation from which on postures are evaluated again
_REACH_RATIO = 0.97  # of the full reach, that `estimate_reach` returns


def compute_usable_friction(friction: float) -> float:
    """Return the friction coefficient that a search relies on, below the surface's own."""
    return _USED_FRICTION * friction / FRICTION_SAFETY


def find_braces(
    robot: Robot,
    mirrored_legs: tuple[int | None, ...],
    is_collision_free: Callable[[LeggedPosture], bool],
) -> tuple[tuple[LeggedPosture, ...], str]:
    """Find bracing postures between walls in which no parts of the robot collide.

    Args:
        robot: As it would be planned with.
        mirrored_legs: For each leg the leg on the other side; None where there is none.
        is_collision_free: Whether no parts of the robot touch in a posture.

    Returns:
        The postures for each wall friction, best first, and why there are none on the roughest
        walls: the end of a sentence.
    """
    if not isinstance(robot.mechanism, SerialChain):
        raise TypeError("a robot from a URDF has chains")
    chain, low, high = robot.mechanism, robot.joint_lower, robot.joint_upper
    box = robot.body_hull.min(axis=0), robot.body_hull.max(axis=0)
    reach = estimate_full_reach(chain, low, high)
    low, high = keep_off_bounds(low, high)
    legs = LegModel(chain, low, high, robot.max_torque, reach, robot.weight, mirrored_legs, box)

    def is_clear(points: Array, posture: LeggedPosture) -> bool:
        hits_wall = np.abs(points[:, :-1, 0]).max() >= posture.gap / 2 - WALL_CLEARANCE
        return (
            not hits_wall
            and is_collision_free(posture)
            and bool(are_links_clear(robot, posture.angles[None], np.array([posture.gap / 2]))[0])
        )

    def select_clear(angles: Array, half: Array) -> BoolArray:
        return are_links_clear(robot, angles, half)

    braces: list[LeggedPosture] = []
    failure = ""
    for friction in WALL_FRICTIONS:
        usable = compute_usable_friction(friction)
        candidates, demand = search_bracing_postures(
            legs, chain.posture, WALL_CLEARANCE, usable, select_clear
        )
        failure = f", on walls of friction {friction:g}{describe_torque_demand(legs, demand)}"
        is_weak = demand.utilisation > _REFINE_ABOVE
        considered = candidates[: None if is_weak else _MAX_BRACES]
        selected = clear = [brace for brace in considered if is_collision_free(brace)]
        if is_weak and clear:
            max_shift = MAX_SHIFT_RATIOS[-1] * float(reach.min())
            selected, utilisation = refine_braces(legs, clear, usable, max_shift, is_clear)
            failure = (
                f", on walls of friction {friction:g}: the motors need {utilisation:.3g} times "
                "their torque limits with any one limb lifted, by exact kinematics of the shifted "
                f"body in {len(clear)} postures and others drawn about the best"
            )
        if candidates and not clear:
            failure = f": parts touch in all {len(candidates)} that would hold"
        braces += [replace(brace, friction=friction) for brace in selected[:_MAX_BRACES]]
    return tuple(braces), failure


def are_links_clear(robot: Robot, angles: Array, half: Array) -> BoolArray:
    """Return whether links as thick as in planning keep off both walls and other limbs, (C,).

    Args:
        robot: As it would be planned with.
        angles: (C, N, J) [rad].
        half: (C,) half distances between walls, in whose middle the body is [m].
    """
    links = limb_capsules(robot, angles)
    last = links.link == robot.joint_count - 1
    lateral = np.maximum(np.abs(links.starts[..., 0]), np.abs(links.ends[..., 0]))
    length = np.linalg.norm(links.ends - links.starts, axis=-1)
    at_toe = last & (links.to_toe + length < _AT_TOE * links.radius)
    lateral = np.where(last, np.abs(links.starts[..., 0]), lateral)  # the other end is at the wall
    extent = np.where(at_toe, 0.0, lateral + links.radius).max(axis=(-1, -2))
    _, pairs = list_clearance_pairs(robot, links)
    apart = compute_limb_clearance(links, pairs).min(axis=-1, initial=np.inf)
    clearance = np.minimum(_LINK_CLEARANCE, _LINK_CLEARANCE_RATIO * half)
    return np.asarray((extent < half - clearance) & (apart > clearance))


def estimate_full_reach(chain: SerialChain, lower: Array, upper: Array) -> Array:
    """Return the largest distance (N,) of sampled toes from their legs' first joints [m].

    Args:
        chain: N legs of J joints.
        lower: Lower joint bounds (N, J) [rad].
        upper: Upper joint bounds (N, J) [rad].
    """
    low, high = np.clip(lower, -np.pi, np.pi), np.clip(upper, -np.pi, np.pi)
    return estimate_reach(chain, low, high) / _REACH_RATIO


def describe_torque_demand(legs: LegModel, demand: TorqueDemand) -> str:
    """Return the end of a sentence on why no posture holds with any one limb lifted."""
    if np.isnan(demand.utilisation):
        return " no posture is in reach, clear of the body"
    if np.isinf(demand.utilisation):
        return (
            " no posture of those looked at, limbs bent as it stands, holds its weight within the "
            "friction cones"
        )
    name = legs.chain.names[demand.limb][demand.joint]
    limit = float(legs.torque[demand.limb, demand.joint])
    return (
        f" the motors need {demand.utilisation:.2g} times their torque limits with any one limb "
        f"lifted: {name} {demand.torque:.3g} N m, and has {limit:.3g} N m"
    )
