"""Room between the limbs of a robot, and between limbs and its body, in planning.

What is compared, and what is left out, is as in `climbplan/climb/check/self_collision.py`, which
measures it again by other means.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from climbplan.arrays import Array, BoolArray, IntArray
from climbplan.climb.clearance.limbs import compute_link_distances
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.kinematics import standing_inverse
from climbplan.robots.model import Robot
from climbplan.robots.self_clearance import compute_limb_clearance, list_clearance_pairs
from climbplan.terrain.solids import Solid

_MAX_MEASURED = 2e-3  # [m] room up to which it is measured
_OVERLAP_TOLERANCE = 1e-9  # [m] that counts
_STEPS = 6  # poses along a push
_JOINT_FRACTION = 0.2  # of a radius: what of a second link counts as its joint with the first


@dataclass(frozen=True)
class SelfShortfall:
    """The parts of a robot that come closest to one another."""

    missing: float  # [m] by which they overlap, <= 0 if they are apart
    pose: int
    limb: int
    link: int
    other_limb: int  # limb, or -1 for the body
    other_link: int

    def describe(self, robot: Robot) -> str:
        """Describe the overlapping parts and the depth, with the robot's names."""
        first = f"{robot.limb_names[self.limb]}'s {robot.joint_name(self.limb, self.link)}"
        second = "the body"
        if self.other_limb >= 0:
            name = robot.joint_name(self.other_limb, self.other_link)
            second = f"{robot.limb_names[self.other_limb]}'s {name}"
        return f"{first} would be {1e3 * self.missing:.1f} mm deep in {second}"


def compute_self_shortfall(
    robot: Robot, links: Capsules, of_limb: int | None = None, still: BoolArray | None = None
) -> SelfShortfall:
    """Compute where parts come closest, of links (P, N, C) in the body frame; NaN are left out.

    of_limb: check that limb alone, against the body and the limbs of `still` (N,).
    """
    body, limbs = list_clearance_pairs(robot, links)
    if of_limb is not None:
        assert still is not None
        body = body[body[:, 0] == of_limb]
        limb_pairs = np.where(limbs[:, 0] == of_limb, limbs[:, 2], limbs[:, 0])
        limbs = limbs[(limbs[:, [0, 2]] == of_limb).any(axis=1) & still[limb_pairs]]
    distance = np.concatenate(
        [compute_body_distances(robot, links, body), compute_limb_clearance(links, limbs)], axis=-1
    )
    if not distance.size:
        return SelfShortfall(-np.inf, 0, 0, 0, -1, 0)
    is_known = np.where(np.isnan(distance), np.inf, distance)
    pose, pair = (int(i) for i in np.unravel_index(int(np.argmin(is_known)), is_known.shape))
    limb, is_body_pair, other_limb, behind = (int(i) for i in np.concatenate([body, limbs])[pair])
    return SelfShortfall(
        -float(is_known[pose, pair]),
        pose,
        limb,
        int(links.link[limb, is_body_pair]),
        other_limb,
        int(links.link[other_limb, behind]) if other_limb >= 0 else 0,
    )


def find_standing_overlap(
    scene: MotionScene, instants: Instants
) -> tuple[SelfShortfall, str] | None:
    """The worst overlap of parts at the instants and along every push, and where; None without."""
    robot = scene.robot
    lift, push = np.arange(0, instants.count, 2), np.arange(1, instants.count, 2)
    fraction = np.linspace(0.0, 1.0, _STEPS)[1:-1, None]
    com, rpy = (
        x[lift, None] + fraction * (x[push] - x[lift])[:, None]
        for x in (instants.com, instants.rpy)
    )
    toes = np.broadcast_to(instants.toes[push, None], (*com.shape[:2], robot.limb_count, 3))
    normal = np.broadcast_to(instants.normal[push, None], toes.shape)
    between = (v.reshape(-1, *v.shape[2:]) for v in (com, rpy, toes, normal))
    angles = np.concatenate([instants.joint_angles, standing_inverse(robot, *between).best()])
    worst = compute_self_shortfall(robot, limb_capsules(robot, angles))
    if worst.missing <= _OVERLAP_TOLERANCE:
        return None
    k = worst.pose
    if k >= instants.count:
        k = int(push[(k - instants.count) // (_STEPS - 2)])
    return worst, instants.label(k, robot.limb_names)


def compute_body_distances(robot: Robot, links: Capsules, pairs: IntArray) -> Array:
    """Room (P, B) [m] of links beside the body; below zero where they touch."""
    limb_link = pairs[:, 0].astype(int), pairs[:, 1].astype(int)
    starts, ends = (v[..., limb_link[0], limb_link[1], :] for v in (links.starts, links.ends))
    radius = links.radius[limb_link]
    if robot.capsules is None:
        second = links.link[limb_link] == robot.has_joint.argmax(axis=1)[limb_link[0]] + 1
        cut = np.where(second, _JOINT_FRACTION * radius, 0.0)
        along = ends - starts
        length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
        starts = starts + np.minimum(cut / length, 1.0)[..., None] * along
        radius = np.hypot(radius, cut / 2)
    enough = float(radius.max(initial=0.0)) + _MAX_MEASURED
    away = [
        compute_link_distances(solid, starts, ends, enough) for solid in build_body_solids(robot)
    ]
    return np.asarray(np.min(away, axis=0) - radius)


def build_body_solids(robot: Robot) -> list[Solid]:
    """Convex parts of the body that limbs keep off, body frame."""
    body_parts = robot.body_parts or (robot.body_hull,)
    return [_solid(np.ascontiguousarray(body_part).tobytes()) for body_part in body_parts]


@lru_cache(maxsize=64)
def _solid(corners: bytes) -> Solid:
    return Solid.from_points("body", np.frombuffer(corners).reshape(-1, 3))
