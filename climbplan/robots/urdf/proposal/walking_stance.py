"""Search for stances to walk at speed, ranked by the workspace of the toes under load.

`build_walking_body` gives all toes boxes of one size, in which each leg bears its part of the
weight. A posture with a large reach margin for one step at a time may leave small boxes: its toes
may be far to one side of the centre of mass, or just out of each other's way. Toes are taken from
the grid of `search_ground_postures`, and the boxes of the best candidates are measured. The score
is the smallest extent of the boxes times the unused torque, less a cost on the distance of the
centre of mass from the support lines of a trot: a robot tips sideways in proportion to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.proposal.postures import LeggedPosture
from climbplan.robots.urdf.proposal.prepared_robot import PreparedRobot, RobotProposal
from climbplan.robots.urdf.proposal.propose_robot import (
    PRONE_AND_SUPINE_AXES,
    detect_legs,
    prepare_detected_legs,
)
from climbplan.robots.urdf.proposal.weight_shift_stance import search_ground_postures
from climbplan.robots.urdf.toe_boxes import compute_weight_fractions, grow_toe_boxes
from climbplan.robots.urdf.walking_body import TO_WALKING
from climbplan.schema.robots.leg_pairs import order_in_pairs

_EXTENT_WEIGHTS = np.array([1.0, 0.5, 0.4])  # extents of equal value: longitudinal, lateral, up
_DIAGONAL_OFFSET_COST = 0.25  # metres of box per metre of the centre of mass off the diagonals
_MIN_STRENGTH = 1.2  # times its part of the weight, that each leg holds as it stands
_MAX_MEASURED = 20  # candidates whose boxes are measured


@dataclass(frozen=True)
class _WalkingStance:
    """A posture in walking's axes, pairs of legs from front to hind."""

    posture: LeggedPosture
    order: list[int]
    center: Array  # (3,) [m], frame of the chains
    toes: Array  # (N, 3) from it [m]
    min_leg_force: float  # vertical, of the leg that is weakest for its part [N]
    borne_weight: float  # part of the weight on that leg [N]
    diagonal_offset: float  # of the centre of mass from the diagonals [m]

    @property
    def strength(self) -> float:
        """The force of the weakest leg over its part of the weight."""
        return self.min_leg_force / self.borne_weight

    def compute_score(self, extent: float) -> float:
        """Return the score of the stance with boxes of such an extent [m]."""
        return extent * (1 - 1 / self.strength) - _DIAGONAL_OFFSET_COST * self.diagonal_offset


def propose_walking_stances(
    proposal: RobotProposal, max_count: int
) -> tuple[list[RobotProposal], str]:
    """Return the robot in up to `max_count` stances to walk at speed in, best first.

    A robot that stands with its hands on walls walks on hands and feet. Braces between walls are
    not searched for.

    Returns:
        The proposals, and why there are no others.
    """
    if proposal.posture.gap:
        robots = list(_prepare_prone_and_supine(proposal))
    else:
        robots = [proposal.prepared]
    proposals: list[RobotProposal] = []
    reasons = []
    for robot in robots:
        postures, reason = search_walking_stances(robot, max_count - len(proposals))
        proposals += [robot.build_proposal(posture, walls=False) for posture in postures]
        reasons.append(f"with the base's {robot.draft.up} up {reason}" if reason else "")
        if len(proposals) == max_count:
            break
    return proposals, "; ".join(reason for reason in reasons if reason)


def _prepare_prone_and_supine(proposal: RobotProposal) -> Iterator[PreparedRobot]:
    """Yield the robot on hands and feet, with its front and then its back down."""
    draft = proposal.draft
    for axes in PRONE_AND_SUPINE_AXES:
        yield prepare_detected_legs(
            detect_legs(draft.urdf, draft.packages, axes, draft.requested_toes)
        )


def search_walking_stances(robot: PreparedRobot, max_count: int) -> tuple[list[LeggedPosture], str]:
    """Search for postures on level ground whose toes have boxes to walk in.

    Returns:
        Up to `max_count` postures, best first, toes in the frame of the chains; and the reason if
        there are none.
    """
    reached = search_ground_postures(robot.legs, robot.build_clearance_function(), None)
    stances = [
        stance
        for posture in reached
        if (stance := _build_walking_stance(robot, posture)) is not None
    ]
    strong = [stance for stance in stances if stance.strength > _MIN_STRENGTH]
    strong.sort(key=lambda stance: -stance.compute_score(stance.posture.reach_margin))
    postures: list[LeggedPosture] = []
    reason = ""
    for stance in strong[:_MAX_MEASURED]:
        if robot.has_self_collision(stance.posture):
            continue
        extent = _measure_extent(robot, stance)
        if isinstance(extent, str):
            reason = reason or extent
            continue
        score = stance.compute_score(extent)
        postures.append(replace(stance.posture, score=score, utilisation=1 / stance.strength))
    if postures:
        return sorted(postures, key=lambda posture: -posture.score)[:max_count], ""
    return [], _describe_failure(reached, stances, strong, reason)


def _measure_extent(robot: PreparedRobot, stance: _WalkingStance) -> float | str:
    """Return the weighted extent of the boxes of a stance [m], or why it has none."""
    legs, order = robot.legs, stance.order
    chain = replace(
        legs.chain,
        posture=stance.posture.angles,
        joint_zero=legs.chain.joint_zero - stance.center,
        toe_zero=legs.chain.toe_zero - stance.center,
    )
    chain = chain.rotate(TO_WALKING).select_limbs(order)
    limits = legs.lower[order], legs.upper[order], legs.torque[order]
    boxes = grow_toe_boxes(chain, stance.toes, *limits, legs.weight)
    return boxes if isinstance(boxes, str) else float((boxes.half / _EXTENT_WEIGHTS).min())


def _describe_failure(
    reached: list[LeggedPosture],
    stances: list[_WalkingStance],
    strong: list[_WalkingStance],
    reason: str,
) -> str:
    """Return why no posture is a walking stance.

    reason: why the first measured stance has no boxes; empty where none was measured.
    """
    if not reached:
        return "no posture in reach keeps limbs out of each other's way with room about the toes"
    if not stances:
        return (
            f"{len(reached)} postures have room about their toes, and none has toes in pairs "
            "before and behind its centre of mass"
        )
    if not strong:
        best = max(stances, key=lambda stance: stance.strength)
        required = _MIN_STRENGTH * best.borne_weight
        return (
            f"a leg holds at most {best.min_leg_force:.0f} N upright of the {required:.0f} N "
            f"asked for, {_MIN_STRENGTH:g} times its part of the weight, in {len(stances)} postures"
        )
    return reason or f"parts touch in all of {len(strong)} postures that would hold"


def _build_walking_stance(robot: PreparedRobot, posture: LeggedPosture) -> _WalkingStance | None:
    """Return the posture as a walking stance; None where toes are no pairs about its centre."""
    legs, center = robot.legs, robot.compute_center(posture.angles)
    toes = (posture.toes - center) @ TO_WALKING.T
    order = order_in_pairs(toes.tolist())
    if order is None:
        return None
    toes = toes[order]
    if not toes[:2, 0].mean() > 0 > toes[-2:, 0].mean():
        return None
    lever = np.abs(legs.chain.jacobian(posture.angles)[order][:, 2])  # (N, J) of vertical forces
    force = (legs.torque[order] / np.maximum(lever, 1e-9)).min(axis=1)
    borne = compute_weight_fractions(toes) * legs.weight
    leg = int(np.argmin(force / borne))
    return _WalkingStance(
        posture=posture,
        order=order,
        center=center,
        toes=toes,
        min_leg_force=float(force[leg]),
        borne_weight=float(borne[leg]),
        diagonal_offset=_measure_diagonal_offset(toes),
    )


def _measure_diagonal_offset(toes: Array) -> float:
    """Return the largest distance of the centre of mass from the support lines of a trot [m].

    toes: (N, 3) from the centre of mass. Zero for more than four legs, which have three on the
    ground.
    """
    if len(toes) != 4:
        return 0.0
    front, rear = toes[:2, :2], toes[:1:-1, :2]
    line = rear - front
    moment = np.abs(line[:, 0] * front[:, 1] - line[:, 1] * front[:, 0])
    return float((moment / np.maximum(np.linalg.norm(line, axis=1), 1e-9)).max())
