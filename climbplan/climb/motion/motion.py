"""Plan postures, instants and forces that pass the exact checks, by tightening after failures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from climbplan.arrays import Array
from climbplan.climb.clearance.swing import SwingBlocked, SwingCollision
from climbplan.climb.forces.explanation import NoForces
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.motion.tightening import STANCE_FACTOR, CandidateMotion, PostureSearch
from climbplan.climb.plan.climb_plan import InstantForces, Instants
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.postures.planner import PostureResult, plan_postures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.model import COUPLED_METHODS
from climbplan.errors import LimitReached, NoPlanFound, Unresolved, UsageError
from climbplan.progress import Progress

_MAX_SCAN_TIGHTENINGS = 8  # more times, for parts of a scan that limbs come too close to
_MAX_TIGHTENINGS = 8  # times a posture problem is tightened after an exact check failed
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
    posture = replace(motion.posture, warnings=(*motion.posture.warnings, note))
    return replace(motion, posture=posture)


def _plan_motion(
    scene: ClimbScene,
    clock: StageClock,
    save_model: Path | None,
    deadline: float,
    num_kept: int | None,
    nodes: float,
) -> ClimbMotion:
    """Plan a motion by tightening the posture problem until its solution passes all checks."""
    if save_model is not None and _select_method(scene) != "micp":
        raise UsageError("--save-model writes the mixed-integer program: use it with method micp")
    search = PostureSearch(scene, scene)
    bound: float | None = None
    num_scan_tightenings = 0 if scene.terrain.scan is None else _MAX_SCAN_TIGHTENINGS
    for _ in range(_MAX_TIGHTENINGS + num_scan_tightenings):
        remaining = deadline - time.monotonic()
        if remaining <= 0:
            raise _build_time_failure(search)
        with clock.stage("posture"):
            timed_scene = replace_time_limit(search.tightened_scene, remaining)
            try:
                posture = _plan_postures(search, timed_scene, clock.report, save_model, nodes)
            except NoPostures as error:
                if search.is_local or not search.notes:
                    raise
                if search.restore_regions():  # limbs may be moved in place of toes
                    continue
                raise _build_failure(search) from error
            except LimitReached as error:
                if search.is_local or not search.notes:
                    raise
                raise _build_time_failure(search) from error
        search.posture = posture
        rounds = posture.rounds if num_kept is None else posture.rounds.first(num_kept)
        # Tightening only adds constraints: the first bound is the one of the statement.
        bound = posture.bound if bound is None else bound
        candidate = CandidateMotion(scene, rounds)
        with clock.stage("kinematics"):
            if search.tighten(candidate):
                continue
        posture = _replace_bound(replace(posture, rounds=rounds), bound, scene)
        return ClimbMotion(posture, candidate.instants, tuple(search.notes), candidate.swings)
    raise _build_failure(search)


def _plan_postures(
    search: PostureSearch,
    scene: ClimbScene,
    report: Progress,
    save_model: Path | None,
    nodes: float,
) -> PostureResult:
    """Plan the postures of a tightened scene by its method, alone or together with forces."""
    if search.is_local:
        from climbplan.climb.postures.nlp.method import plan_postures_nlp

        return plan_postures_nlp(scene, report)
    if scene.spec.solver.method in COUPLED_METHODS:
        from climbplan.climb.coupled.planner import plan_coupled

        return plan_coupled(scene, search.margins)
    is_first = not search.notes  # an infeasible program is explained as the spec states it
    return plan_postures(scene, search.margins, save_model, search.posture, nodes, explain=is_first)


def _select_method(scene: ClimbScene) -> str:
    """Select the posture method; `auto` is its first method here."""
    method = scene.spec.solver.method
    return "micp" if method == "auto" else str(method)


def _build_failure(search: PostureSearch) -> NoPlanFound:
    """Build the error of tightening that did not lead to a plan, which proves nothing."""
    failure, notes = search.failure, search.notes
    if isinstance(failure, SwingBlocked | SwingCollision):
        return failure
    last = str(failure) if failure is not None else notes[-1]
    method = _select_method(search.scene)
    return Unresolved(
        f"method {method} found no postures that pass the exact checks ({len(notes)} tightenings); "
        f"last: {last}",
        because=f"method {method} knows workspaces as balls, and rotations and knees to first "
        "order; it was tightened after each check that failed",
        stage="kinematics",
    )


def _build_time_failure(search: PostureSearch) -> LimitReached:
    notes = search.notes
    after = f" after {len(notes)} tightenings; last: {notes[-1]}" if notes else ""
    return LimitReached(
        f"no postures that pass the exact checks found within the time limit, by method "
        f"{_select_method(search.scene)}{after}; a larger `solver.time_limit` may help",
        stage="posture",
    )


def _replace_bound(posture: PostureResult, bound: float | None, scene: ClimbScene) -> PostureResult:
    """Replace a result's bound by that of the program without tightening, and its status."""
    if bound is None:
        return posture
    gap = max(posture.objective - bound, 0.0) / max(abs(posture.objective), 1e-9)
    proved = gap <= scene.spec.solver.gap
    return replace(posture, bound=bound, gap=gap, status="optimal" if proved else "feasible")


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
        radius = scene.robot.stance_radius * STANCE_FACTOR**number
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
