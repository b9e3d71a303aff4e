"""Postures, instants and forces that pass the exact checks: planned again, tighter, where not."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.body import body_shortfall, poses_shortfall
from climbplan.climb.clearance.limb_pairs import standing_overlap
from climbplan.climb.clearance.limbs import LimbShortfall, limb_shortfall
from climbplan.climb.clearance.swing import SwingBlocked, SwingMeets, swing_paths
from climbplan.climb.forces.explanation import NoForces
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.balance import body_way
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Forces, Instants, Rounds
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.postures.planner import PostureResult, plan_postures
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.postures.turning import turn_normals
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.model import COUPLED_METHODS
from climbplan.errors import LimitReached, NoPlanFound, NotProved, ReachFailure, UsageError
from climbplan.progress import Progress
from climbplan.terrain.soles import shrunk
from climbplan.terrain.solids import Solid

_Failure = ReachFailure | SwingBlocked | SwingMeets
_OF_SCANS = 8  # more times, for parts of a scan that limbs come too close to
_TIGHTENINGS = 8  # times a posture problem is tightened after an exact check failed
_LEAST_WIDENING = 2e-3  # [m] by which limbs are asked to stay further off at least
_ASIDE = 4.0  # [m] that toes step aside for each metre that a last link is too close
_LEAST_ASIDE = 5e-3  # [m] the same at least
_STANCE_SHRINK = 0.9  # factor on a limb's stance radius when its inverse kinematics failed
_LEAST_TURN = np.deg2rad(0.3)  # by which first joints are asked to stay within their bounds
_LEAST_TIME = 0.05  # [s] that a solver is given at least
_STEADYINGS = 3  # times postures are planned nearer to the stance for a body that is not stable


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
class Motion:
    """Postures and instants that passed the exact kinematic and clearance checks."""

    posture: PostureResult
    instants: Instants
    tightenings: tuple[str, ...]
    swings: tuple[Array, ...] | None  # way points of every limb move, if they were looked for


def within(scene: ClimbScene, seconds: float) -> ClimbScene:
    """The scene with that much time for the posture planner [s]."""
    solver = scene.spec.solver.model_copy(update={"time_limit": max(seconds, _LEAST_TIME)})
    return replace(scene, spec=scene.spec.model_copy(update={"solver": solver}))


def plan_motion(
    scene: ClimbScene,
    clock: StageClock,
    save_model: Path | None = None,
    deadline: float | None = None,
    kept: int | None = None,
    nodes: float = np.inf,
) -> Motion:
    """Postures whose every instant can be reached and whose body and limbs keep clear.

    The convex statement knows workspaces as balls, rotations and knees to first order. Where the
    exact check finds a joint bound or clearance missed, or a limb cannot swing past an obstacle,
    the limb's ball or the clearance is tightened and the postures are planned again. All of it
    ends at `deadline` (`time.monotonic` [s]), by default as long after the call as the spec allows.
    Raises NoPostures if the statement has no solution, SwingBlocked if a swing stays blocked,
    NotProved if tightening does not lead to a plan and LimitReached if there is no time for it.
    kept: rounds that are checked and returned, where the others only say that it can go on.
    nodes: of each search by branch and bound, at most.
    """
    if deadline is None:
        deadline = time.monotonic() + scene.spec.solver.time_limit
    try:
        return _plan_motion(scene, clock, save_model, deadline, kept, nodes)
    except LimitReached:
        raise
    except NoPlanFound:
        if not scene.footing or scene.robot.sole is not None:
            raise  # soles stand whole on their surfaces
    # No room off the edges: toes may stand wherever there is ground
    motion = _plan_motion(replace(scene, footing=()), clock, save_model, deadline, kept, nodes)
    edge = 1e3 * scene.spec.margins.edge
    note = f"fragile: toes may stand nearer than {edge:.0f} mm to edges of their regions"
    return replace(motion, tightenings=(*motion.tightenings, note))


def _plan_motion(
    scene: ClimbScene,
    clock: StageClock,
    save_model: Path | None,
    deadline: float,
    kept: int | None = None,
    nodes: float = np.inf,
) -> Motion:
    if save_model is not None and _method(scene) != "micp":
        raise UsageError("--save-model writes the mixed-integer program: use it with method micp")
    margins = PostureMargins()
    bound: float | None = None
    posture: PostureResult | None = None
    notes: list[str] = []
    failure: _Failure | None = None
    planned = scene
    step_aside = True  # whether toes are kept farther from what rises beside them
    before_aside: ClimbScene | None = None  # the scene before that
    more = 0 if scene.terrain.scan is None else _OF_SCANS
    for _ in range(_TIGHTENINGS + more):
        left = deadline - time.monotonic()
        if left <= 0:
            raise _out_of_time(scene, notes)
        with clock.stage("posture"):
            if scene.spec.solver.method == "nlp":
                from climbplan.climb.postures.nlp.method import plan_postures_nlp

                posture = plan_postures_nlp(within(planned, left), clock.report)
            else:
                try:
                    inside = within(planned, left)
                    posture = _convex_postures(
                        inside, margins, save_model, posture, nodes, explain=not notes
                    )
                except NoPostures as error:
                    if not notes:
                        raise
                    if before_aside is not None:  # limbs may be moved in place of toes
                        planned, before_aside, step_aside, posture = before_aside, None, False, None
                        continue
                    raise _not_found(scene, notes, failure) from error
                except LimitReached as error:
                    if not notes:
                        raise
                    raise _out_of_time(scene, notes) from error
        rounds = posture.rounds if kept is None else posture.rounds.first(kept)
        # Tightening only adds constraints: the first bound is the one of the statement.
        bound = posture.bound if bound is None else bound
        with clock.stage("kinematics"):
            shortfall = float(body_shortfall(scene, rounds).max(initial=0.0))
            if shortfall > 1e-9 and scene.spec.solver.method != "nlp":
                margins = replace(margins, clearance=margins.clearance + 1.2 * shortfall)
                notes.append(f"body clearance asked {1e3 * margins.clearance:.1f} mm wider")
                continue
            try:
                instants = plan_instants(scene, rounds)
                if scene.grippers is not None:
                    from climbplan.climb.forces.grips.plan import require_wrists

                    require_wrists(scene, instants)
                if scene.spec.posture.steps.shift_max > 0:
                    way = body_way(rounds, instants)
                    shortfall = float(poses_shortfall(scene, *way).max(initial=0.0))
            except ReachFailure as error:
                failure = error
                if scene.spec.solver.method == "nlp" or not scene.spec.posture.stance_workspace:
                    raise
                margins = _shrunk(scene, margins, error)
                notes.append(f"workspace of {error.limb} tightened: {error}")
                continue
            if shortfall > 1e-9 and scene.spec.solver.method != "nlp":
                margins = replace(margins, clearance=margins.clearance + 1.2 * shortfall)
                notes.append(f"body clearance asked {1e3 * margins.clearance:.1f} mm wider")
                continue
            meets = standing_overlap(scene, instants)
            if meets is not None:
                overlap, where = meets
                words = f"{where}, {overlap.words(scene.robot)}"
                if scene.spec.solver.method == "nlp" or not scene.spec.posture.stance_workspace:
                    because = "toes may stand elsewhere than this method puts them"
                    raise NotProved(f"posture planner: {words}", because=because, stage="posture")
                for limb in (overlap.limb, overlap.other):
                    if limb >= 0:
                        margins = _nearer_stance(scene, margins, limb)
                notes.append(f"workspaces of limbs that meet tightened: {words}")
                continue
            grips = None
            if scene.grippers is not None:
                from climbplan.climb.forces.grips.apart import grips_meet

                grips = grips_meet(scene, instants)
            if grips is not None:
                for limb in (grips.limb, grips.other):
                    margins = _nearer_stance(scene, margins, limb)
                notes.append(f"workspaces of limbs whose grippers meet tightened: {grips.words}")
                continue
            try:
                swings = _clear_of_obstacles(scene, rounds, instants)
            except SwingMeets as meeting:
                if scene.spec.solver.method == "nlp" or not scene.spec.posture.stance_workspace:
                    raise
                failure = meeting
                margins = _nearer_stance(scene, margins, meeting.limb)
                name = scene.robot.limb_names[meeting.limb]
                notes.append(f"workspace of {name} tightened: {meeting.conflicts[0]}")
                continue
            except _LimbsTooNear as near:
                if scene.spec.solver.method == "nlp":  # its own exact check is the same
                    words = f"posture planner: {near}"
                    raise near.blocked or NotProved(
                        words, because="method nlp is local", stage="posture"
                    ) from None
                failure = near.blocked
                apart = _stepping_aside(planned, near.short) if step_aside else None
                if apart is not None:
                    before_aside = before_aside or planned
                    planned, posture = apart, None
                    notes.append(f"toes kept farther from {near.short.obstacle!r}: {near}")
                    continue
                wary = _with_solids(planned, near.short.solids)
                if wary is not None:
                    planned, posture = wary, None
                    notes.append(f"planned again past {near.short.obstacle}: {near}")
                    continue
                margins, wider = _widened(margins, near)
                notes.append(f"{wider}: {near}")
                continue
        posture = replace(posture, rounds=rounds)
        return Motion(_bounded_by(posture, bound, scene), instants, tuple(notes), swings)
    raise _not_found(scene, notes, failure)


def _method(scene: ClimbScene) -> str:
    """The method of postures; on its own, without trials of others, `auto` is its first."""
    method = scene.spec.solver.method
    return "micp" if method == "auto" else str(method)


def _with_solids(scene: ClimbScene, solids: tuple[Solid, ...]) -> ClimbScene | None:
    """The scene with solids as obstacles, which postures keep knees off; None if they are already.

    They are parts of a scan, or the material behind surfaces.
    """
    known = {solid.name for solid in scene.terrain.obstacles}
    new = tuple(solid for solid in solids if solid.name not in known)
    if not new:
        return None
    obstacles = (*scene.terrain.obstacles, *new)
    return replace(scene, terrain=replace(scene.terrain, obstacles=obstacles))


def _stepping_aside(scene: ClimbScene, short: LimbShortfall) -> ClimbScene | None:
    """Return the scene with the contact region under a last link that comes too close to a solid
    beside it ending earlier there; None where that is not so, or nothing would be left of it."""
    last = scene.robot.joint_count - 1
    toe = short.toe
    if toe is None or short.link < last or not short.solids:
        return None
    allowed = np.flatnonzero(scene.terrain.allowed[short.limb])
    number = int(min(allowed, key=lambda r: scene.terrain.regions[r].distance(toe)))
    region = scene.standing[number]
    away = short.solids[0].vertices.mean(axis=0) - toe
    edge = int(np.argmax(region.A @ away))
    room = float(region.b[edge] - region.A[edge] @ toe)
    strip = np.zeros(len(region.b))
    strip[edge] = max(room, 0.0) + max(_ASIDE * short.missing, _LEAST_ASIDE)
    vertices = shrunk(region, strip)
    if len(vertices) < 3:
        return None
    standing = list(scene.standing)
    standing[number] = replace(region, vertices=vertices, b=region.b - strip)
    return replace(scene, footing=tuple(standing))


def _widened(margins: PostureMargins, near: _LimbsTooNear) -> tuple[PostureMargins, str]:
    """More room for the knees, or for the whole limb where its first link comes too close."""
    more = max(1.2 * near.short.missing, _LEAST_WIDENING)
    if near.short.link == 0:
        margins = replace(margins, limbs=margins.limbs + more)
        return margins, f"limb clearance asked {1e3 * margins.limbs:.1f} mm wider"
    margins = replace(margins, knees=margins.knees + more)
    return margins, f"knee clearance asked {1e3 * margins.knees:.1f} mm wider"


class _LimbsTooNear(Exception):
    """Links closer to an obstacle than they are thick, standing or on every way of a swing."""

    def __init__(self, words: str, short: LimbShortfall, blocked: SwingBlocked | None) -> None:
        self.short = short
        self.blocked = blocked
        super().__init__(words)


def _clear_of_obstacles(
    scene: ClimbScene, rounds: Rounds, instants: Instants
) -> tuple[Array, ...] | None:
    """Swing paths past the obstacles, None where there are none; raises _LimbsTooNear."""
    standing = limb_shortfall(scene, rounds, instants)
    if standing is None:
        return None
    if standing.missing > 1e-9:
        words = f"{standing.where}, {standing.words(scene)}"
        raise _LimbsTooNear(words, standing, None)
    try:
        return swing_paths(scene, rounds, instants)
    except SwingBlocked as blocked:
        short = blocked.shortfall
        words = f"{short.where}, swinging, {short.words(scene)}"
        raise _LimbsTooNear(words, short, blocked) from blocked


def _convex_postures(
    scene: ClimbScene,
    margins: PostureMargins,
    save_model: Path | None,
    earlier: PostureResult | None,
    nodes: float,
    explain: bool,
) -> PostureResult:
    """Postures alone, or together with forces; earlier: with smaller margins.

    explain: whether what has no solution is looked into.
    """
    if scene.spec.solver.method in COUPLED_METHODS:
        from climbplan.climb.coupled.planner import plan_coupled

        return plan_coupled(scene, margins)
    return plan_postures(scene, margins, save_model, earlier, nodes, explain)


def _not_found(scene: ClimbScene, notes: list[str], failure: _Failure | None) -> NoPlanFound:
    """What to raise when tightening did not lead to a plan, which proves nothing."""
    if isinstance(failure, SwingBlocked | SwingMeets):
        return failure
    last = str(failure) if failure is not None else notes[-1]
    method = _method(scene)
    return NotProved(
        f"method {method} found no postures that pass the exact checks ({len(notes)} tightenings); "
        f"last: {last}",
        because=f"method {method} knows workspaces as balls, and rotations and knees to first "
        "order; it was tightened after each check that failed",
        stage="kinematics",
    )


def _out_of_time(scene: ClimbScene, notes: list[str]) -> LimitReached:
    after = f" after {len(notes)} tightenings; last: {notes[-1]}" if notes else ""
    return LimitReached(
        f"method {_method(scene)}: no time left for postures that pass the exact checks{after}",
        stage="posture",
    )


def _bounded_by(posture: PostureResult, bound: float | None, scene: ClimbScene) -> PostureResult:
    """The result with the bound of the statement that was not tightened, and what that proves."""
    if bound is None:
        return posture
    gap = max(posture.objective - bound, 0.0) / max(abs(posture.objective), 1e-9)
    proved = gap <= scene.spec.solver.gap
    return replace(posture, bound=bound, gap=gap, status="optimal" if proved else "feasible")


def _shrunk(scene: ClimbScene, margins: PostureMargins, failure: ReachFailure) -> PostureMargins:
    """Room within the bounds of the joint that fails, where the statement has it, else a smaller
    ball about the limb's stance."""
    limb = scene.robot.limb_names.index(failure.limb)
    if failure.joint != 0 or not len(turn_normals(scene.robot, limb)):
        return _nearer_stance(scene, margins, limb)
    turn = np.zeros(scene.robot.limb_count) if margins.turn is None else margins.turn.copy()
    turn[limb] += max(1.2 * failure.past, _LEAST_TURN)
    return replace(margins, turn=turn)


def _nearer_stance(scene: ClimbScene, margins: PostureMargins, limb: int) -> PostureMargins:
    """A smaller ball about the stance of a limb, in which its toe has to stay."""
    radius = margins.stance_radius
    if radius is None:
        radius = np.full(scene.robot.limb_count, scene.robot.stance_radius)
    radius = radius.copy()
    radius[limb] *= _STANCE_SHRINK
    return replace(margins, stance_radius=radius)


@dataclass(frozen=True)
class SupportedMotion:
    """A motion with contact forces that carry it at every instant."""

    motion: Motion
    forces: Forces


def plan_support(
    scene: ClimbScene,
    motion: Motion,
    clock: StageClock,
    deadline: float | None = None,
    nodes: float = np.inf,
) -> SupportedMotion:
    """Forces for a motion; where the braced body would buckle, for one nearer to the stance.

    Postures are planned without regard to stability. Limbs nearer to their stance are stiffer
    against the body's sway, so that where stability is part of all that stands against the forces,
    postures are planned again with smaller stance workspaces. The motion keeps the bound of the
    first. Raises NoForces and LimitReached of `plan_forces`, about the first motion. deadline and
    nodes: of planning again, as those of `plan_motion`.
    """
    try:
        with clock.stage("force"):
            return SupportedMotion(motion, plan_forces(scene, motion.instants))
    except NoForces as error:
        if not (error.unsteady and scene.spec.posture.stance_workspace):
            raise
        first = error
    if deadline is None:
        deadline = time.monotonic() + scene.spec.solver.time_limit
    for number in range(1, _STEADYINGS + 1):
        if time.monotonic() > deadline:
            break
        radius = scene.robot.stance_radius * _STANCE_SHRINK**number
        near = replace(scene, robot=replace(scene.robot, stance_radius=radius))
        try:
            steadier = plan_motion(near, clock, deadline=deadline, nodes=nodes)
            with clock.stage("force"):
                forces = plan_forces(scene, steadier.instants)
        except NoPlanFound:
            continue
        reason = str(first.conflicts[0]).split(";", maxsplit=1)[0]
        note = f"stance workspaces tightened to {1e3 * radius:.0f} mm: {reason}"
        posture = _bounded_by(steadier.posture, motion.posture.bound, scene)
        notes = (*steadier.tightenings, note)
        return SupportedMotion(replace(steadier, posture=posture, tightenings=notes), forces)
    raise first
