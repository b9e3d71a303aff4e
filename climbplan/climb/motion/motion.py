"""Plan postures, instants and forces that pass the exact checks, by tightening after failures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.body import compute_body_shortfall, compute_poses_shortfall
from climbplan.climb.clearance.limb_pairs import find_standing_overlap
from climbplan.climb.clearance.limbs import LimbShortfall, find_limb_shortfall
from climbplan.climb.clearance.swing import SwingBlocked, SwingCollision, plan_swing_paths
from climbplan.climb.forces.explanation import NoForces
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.balance import sample_body_path
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import InstantForces, Instants, Rounds
from climbplan.climb.postures.coxa_wedges import compute_wedge_normals
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.postures.planner import PostureResult, plan_postures
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.model import COUPLED_METHODS
from climbplan.errors import LimitReached, NoPlanFound, ReachFailure, Unresolved, UsageError
from climbplan.progress import Progress
from climbplan.terrain.soles import shrink_region
from climbplan.terrain.solids import Solid

_Failure = ReachFailure | SwingBlocked | SwingCollision
_MAX_SCAN_TIGHTENINGS = 8  # more times, for parts of a scan that limbs come too close to
_MAX_TIGHTENINGS = 8  # times a posture problem is tightened after an exact check failed
_MIN_WIDENING = 2e-3  # [m] by which limbs are asked to stay further off at least
_LATERAL_GAIN = 4.0  # [m] that toes step aside for each metre that a last link is too close
_MIN_LATERAL_STEP = 5e-3  # [m] the same at least
_STANCE_FACTOR = 0.9  # factor on a limb's stance radius when its inverse kinematics failed
_MIN_TURN = np.deg2rad(0.3)  # by which first joints are asked to stay within their bounds
_MIN_TIME = 0.05  # [s] that a solver is given at least
_MAX_STABILISATIONS = (
    3  # times postures are planned nearer to the stance for a body that is not stable
)


@dataclass
class StageClock:
    """Seconds by stage, adding up repeated stages."""

    report: Progress
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage; what ends inside it says so."""
        self.report(name, 0.0)
        start = time.perf_counter()
        try:
            yield
        except NoPlanFound as error:
            error.stage = error.stage or name
            raise
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
            self.report(name, 1.0)


@dataclass(frozen=True)
class ClimbMotion:
    """Postures and instants that passed the exact kinematic and clearance checks."""

    posture: PostureResult
    instants: Instants
    tightenings: tuple[str, ...]
    swings: tuple[Array, ...] | None  # way points of every limb move, if they were looked for


def replace_time_limit(scene: ClimbScene, seconds: float) -> ClimbScene:
    """Return the scene with a time limit of the posture planner [s]."""
    solver = scene.spec.solver.model_copy(update={"time_limit": max(seconds, _MIN_TIME)})
    return replace(scene, spec=scene.spec.model_copy(update={"solver": solver}))


def plan_motion(
    scene: ClimbScene,
    clock: StageClock,
    save_model: Path | None = None,
    deadline: float | None = None,
    num_kept: int | None = None,
    nodes: float = np.inf,
) -> ClimbMotion:
    """Plan postures whose instants are in reach and whose body and limbs are clear.

    The convex program models workspaces as balls, and rotations and knees to first order. If the
    exact check finds a violated joint bound or clearance, or a swing is blocked, the limb's ball or
    the clearance is tightened and the postures are planned again.

    Args:
        scene: The scene.
        clock: Times the stages.
        save_model: File for the mixed-integer program; None writes none.
        deadline: Time limit in `time.monotonic` seconds; None takes the spec's, from now.
        num_kept: Rounds that are checked and returned; None takes all.
        nodes: Limit on the nodes of each branch and bound.

    Raises:
        NoPostures: The program has no solution.
        SwingBlocked: A swing stays blocked.
        Unresolved: Tightening does not lead to a plan.
        LimitReached: The time limit was reached.
    """
    if deadline is None:
        deadline = time.monotonic() + scene.spec.solver.time_limit
    try:
        return _plan_motion(scene, clock, save_model, deadline, num_kept, nodes)
    except LimitReached:
        raise
    except NoPlanFound:
        if not scene.footing or scene.robot.sole is not None:
            raise  # soles stand whole on their surfaces
    # No room off the edges: toes may stand wherever there is ground
    motion = _plan_motion(replace(scene, footing=()), clock, save_model, deadline, num_kept, nodes)
    edge = 1e3 * scene.spec.margins.edge
    note = f"fragile: toes may stand nearer than {edge:.0f} mm to edges of their regions"
    return replace(motion, tightenings=(*motion.tightenings, note))


def _plan_motion(
    scene: ClimbScene,
    clock: StageClock,
    save_model: Path | None,
    deadline: float,
    num_kept: int | None = None,
    nodes: float = np.inf,
) -> ClimbMotion:
    if save_model is not None and _select_method(scene) != "micp":
        raise UsageError("--save-model writes the mixed-integer program: use it with method micp")
    margins = PostureMargins()
    bound: float | None = None
    posture: PostureResult | None = None
    notes: list[str] = []
    failure: _Failure | None = None
    planned = scene
    step_aside = True  # whether toes are kept farther from what rises beside them
    before_aside: ClimbScene | None = None  # the scene before that
    num_scan_tightenings = 0 if scene.terrain.scan is None else _MAX_SCAN_TIGHTENINGS
    for _ in range(_MAX_TIGHTENINGS + num_scan_tightenings):
        remaining = deadline - time.monotonic()
        if remaining <= 0:
            raise _build_time_failure(scene, notes)
        with clock.stage("posture"):
            if scene.spec.solver.method == "nlp":
                from climbplan.climb.postures.nlp.method import plan_postures_nlp

                posture = plan_postures_nlp(replace_time_limit(planned, remaining), clock.report)
            else:
                try:
                    timed_scene = replace_time_limit(planned, remaining)
                    posture = _plan_convex_postures(
                        timed_scene, margins, save_model, posture, nodes, explain=not notes
                    )
                except NoPostures as error:
                    if not notes:
                        raise
                    if before_aside is not None:  # limbs may be moved in place of toes
                        planned, before_aside, step_aside, posture = before_aside, None, False, None
                        continue
                    raise _build_failure(scene, notes, failure) from error
                except LimitReached as error:
                    if not notes:
                        raise
                    raise _build_time_failure(scene, notes) from error
        rounds = posture.rounds if num_kept is None else posture.rounds.first(num_kept)
        # Tightening only adds constraints: the first bound is the one of the statement.
        bound = posture.bound if bound is None else bound
        with clock.stage("kinematics"):
            shortfall = float(compute_body_shortfall(scene, rounds).max(initial=0.0))
            if shortfall > 1e-9 and scene.spec.solver.method != "nlp":
                margins = replace(margins, clearance=margins.clearance + 1.2 * shortfall)
                notes.append(f"body clearance asked {1e3 * margins.clearance:.1f} mm wider")
                continue
            try:
                instants = plan_instants(scene, rounds)
                if scene.grippers is not None:
                    from climbplan.climb.forces.grips.plan import require_wrists

                    require_wrists(scene, instants)
                if scene.spec.posture.steps.com_shift_max > 0:
                    path = sample_body_path(rounds, instants)
                    shortfall = float(compute_poses_shortfall(scene, *path).max(initial=0.0))
            except ReachFailure as error:
                failure = error
                if scene.spec.solver.method == "nlp" or not scene.spec.posture.stance_workspace:
                    raise
                margins = _tighten_reach(scene, margins, error)
                notes.append(f"workspace of {error.limb} tightened: {error}")
                continue
            if shortfall > 1e-9 and scene.spec.solver.method != "nlp":
                margins = replace(margins, clearance=margins.clearance + 1.2 * shortfall)
                notes.append(f"body clearance asked {1e3 * margins.clearance:.1f} mm wider")
                continue
            overlap_found = find_standing_overlap(scene, instants)
            if overlap_found is not None:
                overlap, where = overlap_found
                message = f"{where}, {overlap.describe(scene.robot)}"
                if scene.spec.solver.method == "nlp" or not scene.spec.posture.stance_workspace:
                    because = "toes may stand elsewhere than this method puts them"
                    raise Unresolved(
                        f"no postures found without collisions: {message}",
                        because=because,
                        stage="posture",
                    )
                for limb in (overlap.limb, overlap.other_limb):
                    if limb >= 0:
                        margins = _shrink_stance_ball(scene, margins, limb)
                notes.append(f"workspaces of limbs that meet tightened: {message}")
                continue
            grips = None
            if scene.grippers is not None:
                from climbplan.climb.forces.grips.collision import find_grip_collision

                grips = find_grip_collision(scene, instants)
            if grips is not None:
                for limb in (grips.limb, grips.other_limb):
                    margins = _shrink_stance_ball(scene, margins, limb)
                notes.append(
                    f"workspaces of limbs whose grippers meet tightened: {grips.description}"
                )
                continue
            try:
                swings = _plan_clear_swings(scene, rounds, instants)
            except SwingCollision as swing_collision:
                if scene.spec.solver.method == "nlp" or not scene.spec.posture.stance_workspace:
                    raise
                failure = swing_collision
                margins = _shrink_stance_ball(scene, margins, swing_collision.limb)
                name = scene.robot.limb_names[swing_collision.limb]
                notes.append(f"workspace of {name} tightened: {swing_collision.conflicts[0]}")
                continue
            except _LinkCollision as collision:
                if scene.spec.solver.method == "nlp":  # its own exact check is the same
                    message = f"no postures found without collisions: {collision}"
                    raise collision.blocked or Unresolved(
                        message, because="method nlp is local", stage="posture"
                    ) from None
                failure = collision.blocked
                aside_scene = (
                    _shrink_contact_region(planned, collision.shortfall) if step_aside else None
                )
                if aside_scene is not None:
                    before_aside = before_aside or planned
                    planned, posture = aside_scene, None
                    notes.append(
                        f"toes kept farther from {collision.shortfall.obstacle!r}: {collision}"
                    )
                    continue
                scene_with_solids = _add_solids(planned, collision.shortfall.solids)
                if scene_with_solids is not None:
                    planned, posture = scene_with_solids, None
                    notes.append(f"planned again past {collision.shortfall.obstacle}: {collision}")
                    continue
                margins, note = _widen_clearance(margins, collision)
                notes.append(f"{note}: {collision}")
                continue
        posture = replace(posture, rounds=rounds)
        return ClimbMotion(_replace_bound(posture, bound, scene), instants, tuple(notes), swings)
    raise _build_failure(scene, notes, failure)


def _select_method(scene: ClimbScene) -> str:
    """Select the posture method; `auto` is its first method here."""
    method = scene.spec.solver.method
    return "micp" if method == "auto" else str(method)


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


def _widen_clearance(
    margins: PostureMargins, collision: _LinkCollision
) -> tuple[PostureMargins, str]:
    """Widen the clearance of knees, or of the whole limb if its first link comes too close."""
    widening = max(1.2 * collision.shortfall.missing, _MIN_WIDENING)
    if collision.shortfall.link == 0:
        margins = replace(margins, limbs=margins.limbs + widening)
        return margins, f"limb clearance asked {1e3 * margins.limbs:.1f} mm wider"
    margins = replace(margins, knees=margins.knees + widening)
    return margins, f"knee clearance asked {1e3 * margins.knees:.1f} mm wider"


class _LinkCollision(Exception):
    """A link collides with an obstacle, standing or on every path of a swing."""

    def __init__(
        self, message: str, shortfall: LimbShortfall, blocked: SwingBlocked | None
    ) -> None:
        self.shortfall = shortfall
        self.blocked = blocked
        super().__init__(message)


def _plan_clear_swings(
    scene: ClimbScene, rounds: Rounds, instants: Instants
) -> tuple[Array, ...] | None:
    """Plan swing paths past the obstacles, None without obstacles; raise _LimbCollision."""
    standing = find_limb_shortfall(scene, rounds, instants)
    if standing is None:
        return None
    if standing.missing > 1e-9:
        message = f"{standing.where}, {standing.describe(scene)}"
        raise _LinkCollision(message, standing, None)
    try:
        return plan_swing_paths(scene, rounds, instants)
    except SwingBlocked as blocked:
        shortfall = blocked.shortfall
        message = f"{shortfall.where}, swinging, {shortfall.describe(scene)}"
        raise _LinkCollision(message, shortfall, blocked) from blocked


def _plan_convex_postures(
    scene: ClimbScene,
    margins: PostureMargins,
    save_model: Path | None,
    earlier: PostureResult | None,
    nodes: float,
    explain: bool,
) -> PostureResult:
    """Plan postures alone, or together with forces.

    earlier: postures with smaller margins. explain: whether to explain an infeasible program.
    """
    if scene.spec.solver.method in COUPLED_METHODS:
        from climbplan.climb.coupled.planner import plan_coupled

        return plan_coupled(scene, margins)
    return plan_postures(scene, margins, save_model, earlier, nodes, explain)


def _build_failure(scene: ClimbScene, notes: list[str], failure: _Failure | None) -> NoPlanFound:
    """Build the error of tightening that did not lead to a plan, which proves nothing."""
    if isinstance(failure, SwingBlocked | SwingCollision):
        return failure
    last = str(failure) if failure is not None else notes[-1]
    method = _select_method(scene)
    return Unresolved(
        f"method {method} found no postures that pass the exact checks ({len(notes)} tightenings); "
        f"last: {last}",
        because=f"method {method} knows workspaces as balls, and rotations and knees to first "
        "order; it was tightened after each check that failed",
        stage="kinematics",
    )


def _build_time_failure(scene: ClimbScene, notes: list[str]) -> LimitReached:
    after = f" after {len(notes)} tightenings; last: {notes[-1]}" if notes else ""
    return LimitReached(
        f"no postures that pass the exact checks found within the time limit, by method "
        f"{_select_method(scene)}{after}; a larger `solver.time_limit` may help",
        stage="posture",
    )


def _replace_bound(posture: PostureResult, bound: float | None, scene: ClimbScene) -> PostureResult:
    """Replace a result's bound by that of the program without tightening, and its status."""
    if bound is None:
        return posture
    gap = max(posture.objective - bound, 0.0) / max(abs(posture.objective), 1e-9)
    proved = gap <= scene.spec.solver.gap
    return replace(posture, bound=bound, gap=gap, status="optimal" if proved else "feasible")


def _tighten_reach(
    scene: ClimbScene, margins: PostureMargins, failure: ReachFailure
) -> PostureMargins:
    """Room within the bounds of the joint that fails, where the statement has it, else a smaller
    ball about the limb's stance."""
    limb = scene.robot.limb_names.index(failure.limb)
    if failure.joint != 0 or not len(compute_wedge_normals(scene.robot, limb)):
        return _shrink_stance_ball(scene, margins, limb)
    turn = np.zeros(scene.robot.limb_count) if margins.turn is None else margins.turn.copy()
    turn[limb] += max(1.2 * failure.past, _MIN_TURN)
    return replace(margins, turn=turn)


def _shrink_stance_ball(scene: ClimbScene, margins: PostureMargins, limb: int) -> PostureMargins:
    """Shrink the ball about the stance of a limb, in which its toe has to stay."""
    radius = margins.stance_radius
    if radius is None:
        radius = np.full(scene.robot.limb_count, scene.robot.stance_radius)
    radius = radius.copy()
    radius[limb] *= _STANCE_FACTOR
    return replace(margins, stance_radius=radius)


@dataclass(frozen=True)
class SupportedMotion:
    """A motion with contact forces that support it at every instant."""

    motion: ClimbMotion
    forces: InstantForces


def plan_support(
    scene: ClimbScene,
    motion: ClimbMotion,
    clock: StageClock,
    deadline: float | None = None,
    nodes: float = np.inf,
) -> SupportedMotion:
    """Plan the forces of a motion; if the braced body would buckle, of one nearer to the stance.

    Posture planning ignores stability. Limbs nearer to their stance are stiffer against the body's
    sway. If stability conflicts with the forces, postures are planned again with smaller stance
    workspaces; the motion keeps the bound of the first.

    Args:
        scene: The scene.
        motion: The motion.
        clock: Times the stages.
        deadline: Time limit in `time.monotonic` seconds; None takes the spec's, from now.
        nodes: Limit on the nodes of each branch and bound.

    Raises:
        NoForces: There are no forces for the first motion.
        LimitReached: The time limit was reached.
    """
    try:
        with clock.stage("force"):
            return SupportedMotion(motion, plan_forces(scene, motion.instants))
    except NoForces as error:
        if not (error.is_unstable and scene.spec.posture.stance_workspace):
            raise
        first_error = error
    if deadline is None:
        deadline = time.monotonic() + scene.spec.solver.time_limit
    for number in range(1, _MAX_STABILISATIONS + 1):
        if time.monotonic() > deadline:
            break
        radius = scene.robot.stance_radius * _STANCE_FACTOR**number
        nearer_scene = replace(scene, robot=replace(scene.robot, stance_radius=radius))
        try:
            steadier = plan_motion(nearer_scene, clock, deadline=deadline, nodes=nodes)
            with clock.stage("force"):
                forces = plan_forces(scene, steadier.instants)
        except NoPlanFound:
            continue
        reason = str(first_error.conflicts[0]).split(";", maxsplit=1)[0]
        note = f"stance workspaces tightened to {1e3 * radius:.0f} mm: {reason}"
        posture = _replace_bound(steadier.posture, motion.posture.bound, scene)
        notes = (*steadier.tightenings, note)
        return SupportedMotion(replace(steadier, posture=posture, tightenings=notes), forces)
    raise first_error
