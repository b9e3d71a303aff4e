"""Exact checks of planned postures, and how a failure of each tightens the convex program.

The convex program models workspaces as balls, and rotations and knees to first order. `TIGHTENINGS`
pairs every exact check with the change of margins or scene that follows its failure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.body import compute_body_shortfall, compute_poses_shortfall
from climbplan.climb.clearance.limb_pairs import SelfShortfall, find_standing_overlap
from climbplan.climb.clearance.limbs import LimbShortfall, find_limb_shortfall
from climbplan.climb.clearance.swing import SwingBlocked, SwingCollision, plan_swing_paths
from climbplan.climb.gait.balance import sample_body_path
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Instants, Rounds
from climbplan.climb.postures.coxa_wedges import compute_wedge_normals
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import ReachFailure, Unresolved
from climbplan.terrain.soles import shrink_region
from climbplan.terrain.solids import Solid

if TYPE_CHECKING:
    from climbplan.climb.forces.grips.collision import GripCollision

STANCE_FACTOR = 0.9  # factor on a limb's stance radius when its inverse kinematics failed
_TOLERANCE = 1e-9  # [m] of clearance that may be missing
_WIDENING_FACTOR = 1.2  # of what is missing: by how much a margin grows
_MIN_WIDENING = 2e-3  # [m] by which clearances of limbs grow at least
_LATERAL_GAIN = 4.0  # [m] that toes step aside for each metre that a last link is too close
_MIN_LATERAL_STEP = 5e-3  # [m] the same at least
_MIN_TURN = np.deg2rad(0.3)  # by which first joints are asked to stay within their bounds


@dataclass
class PostureSearch:
    """A posture problem that is tightened after each exact check that fails."""

    scene: ClimbScene  # as stated
    tightened_scene: ClimbScene  # with smaller contact regions and more solids as obstacles
    margins: PostureMargins = field(default_factory=PostureMargins)
    posture: PostureResult | None = None  # of smaller margins, where the next search may start
    notes: list[str] = field(default_factory=list)  # tightenings in words
    failure: ReachFailure | SwingBlocked | SwingCollision | None = None  # the last one
    unshrunk_scene: ClimbScene | None = None  # before contact regions shrank; None if none did
    allow_region_shrinking: bool = True

    @property
    def is_local(self) -> bool:
        """The method is the nonlinear one, whose program has the exact constraints itself."""
        return self.scene.spec.solver.method == "nlp"

    @property
    def has_stance_balls(self) -> bool:
        """The program keeps toes in balls about the limbs' stances."""
        return not self.is_local and self.scene.spec.posture.stance_workspace

    def tighten(self, candidate: CandidateMotion) -> bool:
        """Tighten the program after the first exact check that fails; return whether one did."""
        for find_failure, change in TIGHTENINGS:
            failure = find_failure(candidate)
            if failure is not None:
                self.notes.append(change(self, failure))
                return True
        return False

    def restore_regions(self) -> bool:
        """Undo the shrinking of contact regions, for good; return whether any had shrunk."""
        if self.unshrunk_scene is None:
            return False
        self.tightened_scene, self.unshrunk_scene = self.unshrunk_scene, None
        self.allow_region_shrinking, self.posture = False, None
        return True

    def shrink_stance_ball(self, limb: int) -> None:
        """Shrink the ball about the stance of a limb, in which its toe has to stay."""
        radius = self.margins.stance_radius
        if radius is None:
            radius = np.full(self.scene.robot.limb_count, self.scene.robot.stance_radius)
        radius = radius.copy()
        radius[limb] *= STANCE_FACTOR
        self.margins = replace(self.margins, stance_radius=radius)


@dataclass
class CandidateMotion:
    """Planned postures under exact checks; what follows from them is computed once, when needed."""

    scene: ClimbScene
    rounds: Rounds

    @cached_property
    def instants(self) -> Instants:
        """The instants; raises ReachFailure where a toe or a wrist is out of reach."""
        instants = plan_instants(self.scene, self.rounds)
        if self.scene.grippers is not None:
            from climbplan.climb.forces.grips.plan import require_wrists

            require_wrists(self.scene, instants)
        return instants

    @cached_property
    def standing_shortfall(self) -> LimbShortfall | None:
        """The standing link closest to an obstacle; None without obstacles."""
        return find_limb_shortfall(self.scene, self.rounds, self.instants)

    @cached_property
    def swings(self) -> tuple[Array, ...] | None:
        """Way points of every swing, None without obstacles; raises as `plan_swing_paths`."""
        if self.standing_shortfall is None:
            return None
        return plan_swing_paths(self.scene, self.rounds, self.instants)


@dataclass(frozen=True)
class _LinkCollision:
    """A link collides with an obstacle, standing or on every path of a swing."""

    message: str
    shortfall: LimbShortfall
    blocked: SwingBlocked | None  # None for a limb that stands


def _find_body_shortfall(candidate: CandidateMotion) -> float | None:
    """Return the body clearance that postures lack [m], if any."""
    shortfall = compute_body_shortfall(candidate.scene, candidate.rounds)
    return _require_shortfall(candidate.scene, shortfall)


def _find_reach_failure(candidate: CandidateMotion) -> ReachFailure | None:
    """Return the toe or wrist that is out of reach, if any."""
    try:
        _ = candidate.instants
    except ReachFailure as failure:
        return failure
    return None


def _find_path_shortfall(candidate: CandidateMotion) -> float | None:
    """Return the body clearance that is lacking between postures [m], if the body shifts there."""
    scene = candidate.scene
    if scene.spec.posture.steps.com_shift_max <= 0:
        return None
    path = sample_body_path(candidate.rounds, candidate.instants)
    return _require_shortfall(scene, compute_poses_shortfall(scene, *path))


def _require_shortfall(scene: ClimbScene, shortfall: Array) -> float | None:
    """Return the largest shortfall [m]; None within tolerance, or where method nlp judges it."""
    worst = float(shortfall.max(initial=0.0))
    return worst if worst > _TOLERANCE and scene.spec.solver.method != "nlp" else None


def _find_overlap(candidate: CandidateMotion) -> tuple[SelfShortfall, str] | None:
    """Return the parts of the robot that overlap most, and where, if any do."""
    return find_standing_overlap(candidate.scene, candidate.instants)


def _find_gripper_overlap(candidate: CandidateMotion) -> GripCollision | None:
    """Return the grippers that overlap most, if any do."""
    if candidate.scene.grippers is None:
        return None
    from climbplan.climb.forces.grips.collision import find_grip_collision

    return find_grip_collision(candidate.scene, candidate.instants)


def _find_standing_collision(candidate: CandidateMotion) -> _LinkCollision | None:
    """Return the link of a standing limb that is too close to an obstacle, if any."""
    standing = candidate.standing_shortfall
    if standing is None or standing.missing <= _TOLERANCE:
        return None
    message = f"{standing.where}, {standing.describe(candidate.scene)}"
    return _LinkCollision(message, standing, None)


def _find_swing_collision(candidate: CandidateMotion) -> _LinkCollision | SwingCollision | None:
    """Return what a limb collides with on every path of a swing, if anything."""
    try:
        _ = candidate.swings
    except SwingCollision as collision:
        return collision
    except SwingBlocked as blocked:
        shortfall = blocked.shortfall
        message = f"{shortfall.where}, swinging, {shortfall.describe(candidate.scene)}"
        return _LinkCollision(message, shortfall, blocked)
    return None


def _widen_body_clearance(search: PostureSearch, shortfall: float) -> str:
    clearance = search.margins.clearance + _WIDENING_FACTOR * shortfall
    search.margins = replace(search.margins, clearance=clearance)
    return f"body clearance asked {1e3 * clearance:.1f} mm wider"


def _tighten_reach(search: PostureSearch, failure: ReachFailure) -> str:
    """Narrow the bounds of the joint that fails, where the statement has it, else the ball about
    the limb's stance."""
    search.failure = failure
    if not search.has_stance_balls:
        raise failure
    robot, margins = search.scene.robot, search.margins
    limb = robot.limb_names.index(failure.limb)
    if failure.joint != 0 or not len(compute_wedge_normals(robot, limb)):
        search.shrink_stance_ball(limb)
    else:
        turn = np.zeros(robot.limb_count) if margins.turn is None else margins.turn.copy()
        turn[limb] += max(_WIDENING_FACTOR * failure.past, _MIN_TURN)
        search.margins = replace(margins, turn=turn)
    return f"workspace of {failure.limb} tightened: {failure}"


def _separate_limbs(search: PostureSearch, overlap_found: tuple[SelfShortfall, str]) -> str:
    overlap, where = overlap_found
    message = f"{where}, {overlap.describe(search.scene.robot)}"
    if not search.has_stance_balls:
        because = "toes may stand elsewhere than this method puts them"
        raise Unresolved(
            f"no postures found without collisions: {message}", because=because, stage="posture"
        )
    for limb in (overlap.limb, overlap.other_limb):
        if limb >= 0:
            search.shrink_stance_ball(limb)
    return f"workspaces of limbs that meet tightened: {message}"


def _separate_grippers(search: PostureSearch, collision: GripCollision) -> str:
    for limb in (collision.limb, collision.other_limb):
        search.shrink_stance_ball(limb)
    return f"workspaces of limbs whose grippers meet tightened: {collision.description}"


def _clear_swing(search: PostureSearch, collision: _LinkCollision | SwingCollision) -> str:
    if isinstance(collision, _LinkCollision):
        return _clear_obstacle(search, collision)
    if not search.has_stance_balls:
        raise collision
    search.failure = collision
    search.shrink_stance_ball(collision.limb)
    name = search.scene.robot.limb_names[collision.limb]
    return f"workspace of {name} tightened: {collision.conflicts[0]}"


def _clear_obstacle(search: PostureSearch, collision: _LinkCollision) -> str:
    """Shrink the contact region beside the obstacle, else add solids that limbs have to miss, else
    widen the clearance of limbs."""
    shortfall, planned = collision.shortfall, search.tightened_scene
    if search.is_local:  # its own exact check is the same
        raise collision.blocked or Unresolved(
            f"no postures found without collisions: {collision.message}",
            because="method nlp is local",
            stage="posture",
        )
    search.failure = collision.blocked
    if search.allow_region_shrinking:
        shrunk_scene = _shrink_contact_region(planned, shortfall)
        if shrunk_scene is not None:
            search.unshrunk_scene = search.unshrunk_scene or planned
            search.tightened_scene, search.posture = shrunk_scene, None
            return f"toes kept farther from {shortfall.obstacle!r}: {collision.message}"
    scene_with_solids = _add_solids(planned, shortfall.solids)
    if scene_with_solids is not None:
        search.tightened_scene, search.posture = scene_with_solids, None
        return f"planned again past {shortfall.obstacle}: {collision.message}"
    return f"{_widen_limb_clearance(search, shortfall)}: {collision.message}"


def _shrink_contact_region(scene: ClimbScene, shortfall: LimbShortfall) -> ClimbScene | None:
    """Return the scene with the contact region under a last link that comes too close to a solid
    beside it ending earlier there; None where that is not so, or nothing would be left of it."""
    last_link = scene.robot.joint_count - 1
    toe = shortfall.toe
    if toe is None or shortfall.link < last_link or not shortfall.solids:
        return None
    allowed = np.flatnonzero(scene.terrain.allowed[shortfall.limb])
    number = int(min(allowed, key=lambda r: scene.terrain.regions[r].distance(toe)))
    region = scene.standing[number]
    direction = shortfall.solids[0].vertices.mean(axis=0) - toe
    edge = int(np.argmax(region.A @ direction))
    edge_distance = float(region.b[edge] - region.A[edge] @ toe)
    strip = np.zeros(len(region.b))
    strip[edge] = max(edge_distance, 0.0) + max(
        _LATERAL_GAIN * shortfall.missing, _MIN_LATERAL_STEP
    )
    vertices = shrink_region(region, strip)
    if len(vertices) < 3:
        return None
    standing = list(scene.standing)
    standing[number] = replace(region, vertices=vertices, b=region.b - strip)
    return replace(scene, footing=tuple(standing))


def _add_solids(scene: ClimbScene, solids: tuple[Solid, ...]) -> ClimbScene | None:
    """Return the scene with solids as obstacles, which knees avoid; None if they are already.

    They are parts of a scan, or the material behind surfaces.
    """
    existing = {solid.name for solid in scene.terrain.obstacles}
    new = tuple(solid for solid in solids if solid.name not in existing)
    if not new:
        return None
    obstacles = (*scene.terrain.obstacles, *new)
    return replace(scene, terrain=replace(scene.terrain, obstacles=obstacles))


def _widen_limb_clearance(search: PostureSearch, shortfall: LimbShortfall) -> str:
    """Widen the clearance of knees, or of the whole limb if its first link comes too close."""
    margins = search.margins
    widening = max(_WIDENING_FACTOR * shortfall.missing, _MIN_WIDENING)
    if shortfall.link == 0:
        search.margins = replace(margins, limbs=margins.limbs + widening)
        return f"limb clearance asked {1e3 * search.margins.limbs:.1f} mm wider"
    search.margins = replace(margins, knees=margins.knees + widening)
    return f"knee clearance asked {1e3 * search.margins.knees:.1f} mm wider"


# In order, as later checks use what earlier ones computed: a check that returns its failure or
# None, and the change that follows a failure and returns a note
TIGHTENINGS: tuple[
    tuple[Callable[[CandidateMotion], Any], Callable[[PostureSearch, Any], str]], ...
] = (
    (_find_body_shortfall, _widen_body_clearance),
    (_find_reach_failure, _tighten_reach),
    (_find_path_shortfall, _widen_body_clearance),
    (_find_overlap, _separate_limbs),
    (_find_gripper_overlap, _separate_grippers),
    (_find_standing_collision, _clear_obstacle),
    (_find_swing_collision, _clear_swing),
)
