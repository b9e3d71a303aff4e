"""LimbSwing paths: how a toe moves clear of the terrain from one contact to the next.

The straight way between two hover points is tried first, then ways over one point aside and ways
drawn aside as a whole, nearest first. A way counts if the toe keeps its clearance, the limb reaches
every point of it within its joint bounds, and its links, as thick as they are, miss the obstacles
from lifting off to setting down.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from climbplan.arrays import Array, BoolArray
from climbplan.climb.clearance.limb_pairs import SelfShortfall, compute_self_shortfall
from climbplan.climb.clearance.limbs import INTERPOLATION_MARGIN, LimbShortfall, find_closest_link
from climbplan.climb.clearance.raw_surface import (
    THE_SCAN,
    ToeContacts,
    find_nearest_raw,
    is_path_clear,
)
from climbplan.climb.clearance.swing_ways import (
    compute_hover_points,
    generate_paths,
    join_path,
    sample_fractions,
    sample_path,
)
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import Conflict, Unresolved
from climbplan.robots.capsules import Capsules, limb_capsules
from climbplan.robots.foot import Sole
from climbplan.robots.kinematics import standing_inverse
from climbplan.robots.model import Robot
from climbplan.robots.rotations import rotation_world_body
from climbplan.terrain.solids import Solid

_OVERLAP_TOLERANCE = 1e-9  # [m] that counts
TOE_CLEARANCE = 0.01  # [m] distance a swinging toe, or the foot round it, keeps from every solid
_CONTACT_TOLERANCE = 1e-6  # [m] by which a foot that stands may seem to be in what it stands on
# [m] what it keeps from a scan where some way does: over a long walk the body is 10 to 15 mm lower
# than planned, and a toe that catches an edge drags the feet that stand
_PREFERRED_CLEARANCE = 0.03
_MAX_LIFT_FRACTION = 0.5  # share of the lift that this is at most


@dataclass(frozen=True)
class LimbSwing:
    """One limb's swing: the toe moves from old to new while the body stands still."""

    limb: int
    com: Array  # (3,) [m]
    rpy: Array  # (3,) [rad]
    old: Array  # (3,) contact left [m]
    new: Array  # (3,) contact reached [m]
    normals: Array  # (2, 3) unit normals at old and new
    where: str  # "round 3, LM lifted"
    toes: Array | None = None  # (N, 3) of all limbs as it begins [m]
    still: BoolArray | None = None  # (N,) limbs that stand meanwhile
    under: Array | None = None  # (N, 3) normals of the surfaces under them all

    @property
    def contacts(self) -> Array:
        """The old and the new contact (2, 3) [m]."""
        return np.stack([self.old, self.new])

    def interpolate_normals(self, path: Array) -> Array:
        """(S, 3) normals that a sole turns with along a way (P, 3), where it is `sampled`."""
        fraction = sample_fractions(path)[:, None]
        return np.asarray((1 - fraction) * self.normals[0] + fraction * self.normals[1])


SWING_REASON = "some ways of a limb are looked at, between postures that the planner chose"


class SwingBlocked(Unresolved):
    """No path was found on which a limb clears the obstacles; states the smallest shortfall."""

    def __init__(self, shortfall: LimbShortfall, message: str) -> None:
        self.shortfall = shortfall
        conflict = Conflict(shortfall.where, (message,), in_words=True)
        super().__init__("no clear swing path", [conflict], because=SWING_REASON, stage="swing")


class SwingCollision(Unresolved):
    """On all paths clear of the terrain a limb collides with another one, or with the body."""

    def __init__(self, limb: int, where: str, message: str) -> None:
        self.limb = limb
        conflict = Conflict(where, (message,), in_words=True)
        super().__init__("no clear swing path", [conflict], because=SWING_REASON, stage="swing")


def list_swings(scene: MotionScene, rounds: Rounds, instants: Instants) -> tuple[LimbSwing, ...]:
    """List all swings of a posture sequence in order, simultaneous ones by limb."""
    names, toes, swings = scene.robot.limb_names, rounds.toes[0], []
    for k in range(0, instants.count, 2):
        new = instants.toes[k + 1]
        pose = instants.com[k], instants.rpy[k]
        where = instants.label(k, names)
        for limb in (int(i) for i in np.flatnonzero(instants.lifted[k])):
            normals = instants.normal[[k, k + 1], limb]
            still = ~instants.lifted[k]
            under = instants.normal[k]
            swings.append(
                LimbSwing(limb, *pose, toes[limb], new[limb], normals, where, toes, still, under)
            )
        toes = new
    return tuple(swings)


def plan_swing_paths(scene: MotionScene, rounds: Rounds, instants: Instants) -> tuple[Array, ...]:
    """Plan the way points of all swings of a posture sequence.

    Raises as `plan_swing_path`; if links block several swings, for the largest shortfall.
    """
    paths: list[Array] = []
    worst: SwingBlocked | None = None
    for swing in list_swings(scene, rounds, instants):
        try:
            paths.append(plan_swing_path(scene, swing))
        except SwingBlocked as blocked:
            if worst is None or blocked.shortfall.missing > worst.shortfall.missing:
                worst = blocked
    if worst is not None:
        raise worst
    return tuple(paths)


def plan_swing_path(scene: MotionScene, swing: LimbSwing) -> Array:
    """Plan way points (P, 3) from above the old contact to above the new one [m].

    Raises:
        SwingBlocked: The limb's links cannot clear the obstacles.
        SwingCollision: The limb collides with another one or the body on all clear paths.
        Unresolved: Something blocks the toe; the message names it.
    """
    solids = scene.terrain.solids
    lift = scene.spec.trajectory.swing_clearance
    ends = compute_hover_points(swing.contacts, swing.normals, lift)
    robot = scene.robot.one_limb(swing.limb)
    _require_clear_ends(scene, swing, ends)
    size = 0.0 if robot.foot is None else robot.foot.radius
    standing_robot = _StandingRobot.from_swing(scene.robot, swing)
    blocker: str | None = None
    closest: LimbShortfall | None = None
    num_tried, first_overlap = 0, None
    for path in _order_by_clearance(scene, generate_paths(swing.contacts, swing.normals, lift)):
        whole_path = path if np.array_equal(path[[0, -1]], ends) else join_path(ends, path)
        normals = swing.interpolate_normals(whole_path)
        checked_points = sample_path(path)
        if robot.sole is not None:
            checked_points = _compute_sole_points(robot.sole, sample_path(whole_path), normals)
        close_solid = _find_close_solid(checked_points, solids, TOE_CLEARANCE + size)
        if close_solid is not None:
            blocker = blocker or close_solid.name
            continue
        if scene.terrain.scan is not None and not is_path_clear(
            scene.terrain.scan, sample_path(path), TOE_CLEARANCE + size
        ):
            blocker = blocker or THE_SCAN
            continue
        links = _compute_links(robot, swing, sample_path(whole_path), normals)
        if links is None:
            continue
        close_link = _find_close_link(scene, swing, links)
        if close_link is None:
            overlap = None if standing_robot is None else standing_robot.find_overlap(links)
            if overlap is None:
                return whole_path
            first_overlap = first_overlap or overlap
            continue
        num_tried += 1
        if closest is None or close_link.missing < closest.missing:
            closest = close_link
    if closest is not None:
        raise SwingBlocked(
            closest, f"{closest.describe(scene)} on the clearest of {num_tried} ways"
        )
    if first_overlap is not None:
        message = f"{first_overlap.describe(scene.robot)} on the nearest way"
        raise SwingCollision(swing.limb, swing.where, message)
    raise _build_failure(
        swing, f"past {blocker!r}" if blocker is not None else "within the limb's reach"
    )


def _require_clear_ends(scene: MotionScene, swing: LimbSwing, ends: Array) -> None:
    """Raise where lifting off or setting down, which are parts of every path, are blocked.

    ends: (2, 3) hover points above both contacts [m].
    """
    solids, robot = scene.terrain.solids, scene.robot.one_limb(swing.limb)
    segments = [
        sample_path(np.stack(segment)) for segment in zip(swing.contacts, ends, strict=True)
    ]
    normals = [
        np.broadcast_to(n, segment.shape)
        for n, segment in zip(swing.normals, segments, strict=True)
    ]
    closest = _find_close_link(
        scene,
        swing,
        _compute_links(robot, swing, np.concatenate(segments), np.concatenate(normals)),
    )
    if closest is not None:
        raise SwingBlocked(closest, f"{closest.describe(scene)} as its toe is lifted or set down")
    if robot.foot is not None and (size := robot.foot.radius):
        for segment_points in segments:
            close_solid = _find_close_solid(segment_points, solids, size - _CONTACT_TOLERANCE)
            if close_solid is not None:
                blocker = f"to where its foot of {1e3 * size:.0f} mm clears {close_solid.name!r}"
                raise _build_failure(swing, blocker)
    if robot.sole is not None:
        for segment_points, under in zip(segments, normals, strict=True):
            close_solid = _find_close_solid(
                _compute_sole_points(robot.sole, segment_points, under), solids, -_CONTACT_TOLERANCE
            )
            if close_solid is not None:
                raise _build_failure(swing, f"to where its sole clears {close_solid.name!r}")


def _build_failure(swing: LimbSwing, where: str) -> Unresolved:
    conflict = Conflict(swing.where, (f"swing path of the toe {where}",))
    return Unresolved("no clear swing path", [conflict], because=SWING_REASON, stage="swing")


@dataclass(frozen=True)
class _StandingRobot:
    """The robot during a swing, with all limbs but one at rest."""

    robot: Robot
    swing: LimbSwing
    still: BoolArray  # (N,)
    standing: Capsules  # (1, N, C), world; NaN of limbs out of reach

    @classmethod
    def from_swing(cls, robot: Robot, swing: LimbSwing) -> _StandingRobot | None:
        """Build it from a swing; None if the swing does not state the other limbs' toes."""
        if swing.toes is None or swing.still is None:
            return None
        pose = swing.com[None], swing.rpy[None]
        under = np.zeros_like(swing.toes) if swing.under is None else swing.under
        angles = standing_inverse(robot, *pose, swing.toes[None], under[None]).best()
        standing = limb_capsules(robot, angles).to_world(swing.com, rotation_world_body(swing.rpy))
        return cls(robot, swing, swing.still, standing)

    def find_overlap(self, links: Capsules) -> SelfShortfall | None:
        """Find the worst overlap of links (S, 1, C) with another limb or the body, if any."""
        swing, count = self.swing, len(links.starts)
        rotation = rotation_world_body(swing.rpy)

        def merge_poses(standing: Array, moving: Array) -> Array:
            all_points = np.repeat(standing, count, axis=0)
            all_points[:, swing.limb] = moving[:, 0]
            return np.asarray((all_points - swing.com) @ rotation)  # in the body frame

        starts = merge_poses(self.standing.starts, links.starts)
        ends = merge_poses(self.standing.ends, links.ends)
        all_points = replace(self.standing, starts=starts, ends=ends)
        worst = compute_self_shortfall(self.robot, all_points, swing.limb, self.still)
        return worst if worst.missing > _OVERLAP_TOLERANCE else None


def _find_close_link(
    scene: MotionScene, swing: LimbSwing, links: Capsules | None
) -> LimbShortfall | None:
    """Find the link closest to an obstacle, if it violates its clearance."""
    if links is None:
        return None
    if scene.terrain.scan is not None:
        contacts = ToeContacts(np.stack([swing.old, swing.new]), swing.normals)
        raw = find_nearest_raw(scene.terrain.scan, links, contacts, INTERPOLATION_MARGIN)
        if raw.missing > 1e-9:
            return LimbShortfall(
                raw.missing, swing.where, swing.limb, raw.link, raw.radius, THE_SCAN, raw.solids
            )
    solids = scene.terrain.link_solids
    if not solids:
        return None
    closest = find_closest_link(scene, links, swing.limb)
    if closest.distance >= INTERPOLATION_MARGIN - 1e-9:
        return None
    solid = solids[closest.solid]
    return LimbShortfall(
        INTERPOLATION_MARGIN - closest.distance,
        swing.where,
        swing.limb,
        closest.link,
        closest.radius,
        solid.name,
        (solid,) if isinstance(solid, Solid) else (),
    )


def _order_by_clearance(scene: MotionScene, paths: Iterator[Array]) -> Iterator[Array]:
    """Order paths: first those with extra toe clearance from a scan, then all others."""
    scan = scene.terrain.scan
    size = 0.0 if scene.robot.foot is None else scene.robot.foot.radius
    preferred = min(
        _PREFERRED_CLEARANCE, _MAX_LIFT_FRACTION * scene.spec.trajectory.swing_clearance
    )
    if scan is None or preferred <= TOE_CLEARANCE:
        yield from paths
        return
    remaining = []
    for path in paths:
        if is_path_clear(scan, sample_path(path), preferred + size):
            yield path
        else:
            remaining.append(path)
    yield from remaining


def _find_close_solid(
    points: Array, solids: tuple[Solid, ...], min_distance: float
) -> Solid | None:
    """Find a solid closer to toes at points (S, 3) than a minimum distance [m], if any.

    The face distance is a lower bound of the true distance, so accepted points are clear.
    """
    for solid in solids:
        if solid.face_distance(points).min() < min_distance - 1e-9:
            return solid
    return None


def _compute_sole_points(sole: Sole, toes: Array, normals: Array) -> Array:
    """Compute corners and centers (P, 3) of soles about toes (S, 3) with normals (S, 3)."""
    unit = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.concatenate([toes, (toes[:, None] + sole.arms(unit)).reshape(-1, 3)])


def _compute_links(robot: Robot, swing: LimbSwing, toes: Array, normals: Array) -> Capsules | None:
    """Compute the limb's links (S, 1, C) along a path, or None if a point is out of reach.

    normals: (S, 3) that soles turn with.
    """
    pose = np.broadcast_to(swing.com, toes.shape), np.broadcast_to(swing.rpy, toes.shape)
    solution = standing_inverse(robot, *pose, toes[:, None], normals[:, None])
    if not solution.valid.all():
        return None
    links = limb_capsules(robot, solution.best())
    return links.to_world(swing.com, rotation_world_body(swing.rpy))
