"""Random search for bracing postures where none holds with the limbs bent as the robot stands.

Inverse kinematics takes the solution nearest to the posture of the robot file. A humanoid that
stands on its feet with its hands on walls braces with its knees and elbows elsewhere. It gets a
robot file of its own, whose posture is the bracing posture. Toes are sampled on the walls, each
pair of limbs at its own height and forward offset, and the angles of each limb start from the best
of many postures nearby. Postures that hold with any one limb lifted are refined with exact
kinematics (`brace_refinement.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import Array
from climbplan.errors import SpecError
from climbplan.robots.urdf.proposal.brace_refinement import refine_braces
from climbplan.robots.urdf.proposal.bracing_grid_search import (
    WALL_CLEARANCE,
    WALL_FRICTIONS,
    compute_usable_friction,
)
from climbplan.robots.urdf.proposal.lift_torque import compute_torque_utilisation
from climbplan.robots.urdf.proposal.posture_quality import evaluate_postures
from climbplan.robots.urdf.proposal.postures import (
    MAX_SHIFT_RATIOS,
    LeggedPosture,
    are_clear_of_body,
    rate_brace,
    select_best_postures,
    solve_toe_positions,
)
from climbplan.robots.urdf.proposal.prepared_robot import PreparedRobot, RobotProposal

_NUM_SAMPLES = 4000
_MAX_FORCE_CHECKS = 300  # best samples whose forces are computed
_MAX_REFINED = 4  # best postures refined by exact kinematics
# Fractions of reach:
_WALL_DISTANCE_RANGE = (0.1, 0.95)  # of walls from first joints
_MAX_COMMON_OFFSET = 0.4  # forward or backward, of all toes
_MAX_PAIR_OFFSET = 0.3  # of each pair in addition
_HEIGHT_RANGE = (-0.8, 0.6)  # of toes above first joints
_BOUND_MARGIN = 0.12  # [rad] from joint bounds, for commands beyond the deflection of limbs
_MIN_LIMB_CLEARANCE = 0.01  # [m] between limbs


def propose_bracing_postures(proposal: RobotProposal, max_count: int) -> list[RobotProposal]:
    """Return the robot in up to `max_count` bracing postures, best first, always the same ones.

    Each returned proposal has its own posture as its only brace.
    """
    robot = proposal.prepared
    legs = robot.legs
    normal = legs.build_wall_normals()
    max_shift = MAX_SHIFT_RATIOS[-1] * float(legs.reach.min())
    holding = []
    for posture in _sample_bracing_postures(robot):
        toes = posture.toes - robot.compute_center(posture.angles)
        for friction in WALL_FRICTIONS:
            usable = compute_usable_friction(friction)
            stance = legs.build_stance(posture.angles, toes, normal, usable, max_shift)
            utilisation, shift = compute_torque_utilisation(stance)
            if utilisation < 1:
                holding.append(replace(rate_brace(posture, utilisation, shift), friction=friction))
                break
    holding.sort(key=lambda posture: -posture.score)
    compute_clearance = robot.build_clearance_function()
    clear = [posture for posture in holding if not robot.has_self_collision(posture)]
    refined: list[LeggedPosture] = []
    for posture in clear[:_MAX_REFINED]:
        refined += _refine_posture(robot, posture, compute_clearance, max_shift)
    refined.sort(key=lambda posture: -posture.score)
    proposals: list[RobotProposal] = []
    for posture in refined:
        if len(proposals) == max_count:
            break
        try:
            proposals.append(_build_bracing_proposal(robot, posture))
        except SpecError:
            continue  # its toes have less room about them than plans need
    return proposals


def place_on_ground(bracing: RobotProposal, standing: RobotProposal) -> RobotProposal:
    """Return a bracing proposal with its toes where the robot stands on the ground.

    Args:
        bracing: One of `propose_bracing_postures`.
        standing: The robot as it stands. Its centre of mass, the origin of the body frame, lies
            elsewhere in the base, as its limbs are bent otherwise.
    """
    robot = bracing.prepared
    (brace,) = bracing.braces
    offset = robot.compute_center(standing.posture.angles) - robot.compute_center(brace.angles)
    replaced = replace(bracing.robot, stance_body=standing.robot.stance_body + offset)
    return replace(bracing, robot=replaced, posture=standing.posture)


def _sample_bracing_postures(robot: PreparedRobot) -> list[LeggedPosture]:
    """Return sampled postures in reach, clear of walls and body, by reach margin.

    Toes are in the frame of the chains.
    """
    legs = robot.legs
    upper = np.maximum(legs.upper, legs.lower + 2 * _BOUND_MARGIN) - _BOUND_MARGIN
    inner = replace(legs, lower=legs.lower + _BOUND_MARGIN, upper=upper)
    rng = np.random.default_rng(0)
    reach, hips = legs.reach, legs.hips
    half = np.abs(hips[:, 0]).max() + rng.uniform(*_WALL_DISTANCE_RANGE, _NUM_SAMPLES) * float(
        reach.min()
    )
    half = half[half > max(-legs.body_box[0][0], legs.body_box[1][0]) + WALL_CLEARANCE]
    count = len(half)
    common = rng.uniform(-_MAX_COMMON_OFFSET, _MAX_COMMON_OFFSET, count)
    toes = np.empty((count, len(hips), 3))
    done: set[int] = set()
    for limb, twin in enumerate(legs.mirrored_legs):
        if twin in done:
            toes[:, limb] = toes[:, twin]
            continue
        forward = common + rng.uniform(-_MAX_PAIR_OFFSET, _MAX_PAIR_OFFSET, count)
        toes[:, limb, 1] = hips[limb, 1] + forward * reach[limb]
        toes[:, limb, 2] = hips[limb, 2] + rng.uniform(*_HEIGHT_RANGE, count) * reach[limb]
        done.add(limb)
    toes[..., 0] = legs.wall_sides * half[:, None]
    no_force = np.zeros((len(hips), 3))
    knees_above_toes = np.zeros(len(hips), bool)
    angles, reached = solve_toe_positions(inner, toes, no_force, knees_above_toes)
    quality = evaluate_postures(legs.chain, angles, no_force, inner.limits)
    within = np.abs(quality.points[..., :-1, 0]).max(axis=-1) < half[:, None] - WALL_CLEARANCE
    feasible = reached & within & are_clear_of_body(legs, quality.points)
    return select_best_postures(quality, angles, toes, feasible, _MAX_FORCE_CHECKS, 2 * half)


def _refine_posture(
    robot: PreparedRobot,
    posture: LeggedPosture,
    compute_clearance: Callable[[Array], Array] | None,
    max_shift: float,
) -> list[LeggedPosture]:
    """Return the posture and better ones nearby by exact kinematics, toes from the centre of mass.

    compute_clearance: distance between limbs (C,) [m] at angles (C, N, J), if it is known.
    """
    center = robot.compute_center(posture.angles)
    chain = robot.legs.chain
    centred = replace(chain, joint_zero=chain.joint_zero - center, toe_zero=chain.toe_zero - center)
    low, high = robot.legs.body_box
    legs = replace(robot.legs, chain=centred, body_box=(low - center, high - center))

    def is_clear(points: Array, candidate: LeggedPosture) -> bool:
        half = candidate.gap / 2 - WALL_CLEARANCE
        if np.abs(points[:, :-1, 0]).max() >= half or robot.has_self_collision(candidate):
            return False
        if compute_clearance is None:
            return True
        return bool(compute_clearance(candidate.angles[None])[0] > _MIN_LIMB_CLEARANCE)

    start = replace(posture, toes=posture.toes - center)
    friction = compute_usable_friction(posture.friction)
    return refine_braces(legs, [start], friction, max_shift, is_clear)[0]


def _build_bracing_proposal(robot: PreparedRobot, posture: LeggedPosture) -> RobotProposal:
    """Return a proposal that stands and braces in one posture, toes on the walls."""
    proposal = robot.build_proposal(posture, walls=False)
    toes = proposal.robot.stance_body.copy()
    toes[:, 0] = np.sign(toes[:, 0]) * posture.gap / 2
    return replace(proposal, braces=(replace(posture, toes=toes),), brace_failure="")
