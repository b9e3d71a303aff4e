"""Long climbs a window of rounds at a time, each by exact search, joined into one plan.

A window has W rounds and begins where the one before it was cut. All but the last aim at a point
of the body's way, as far on as W rounds can take it: body and toes are drawn there by the cost of
the posture problem, and need not reach it. Half of a window's rounds are kept, the other half is
planned again in the next, so that a window never ends where nothing goes on. The last window has
the goal as the spec states it.

Which windows may follow is in `window_scenes.py`. What is kept of a window passes the exact
kinematic, clearance and force checks before the next begins.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field

import numpy as np

from climbplan.climb.clearance.body import body_shortfall
from climbplan.climb.clearance.limbs import limb_shortfall
from climbplan.climb.clearance.swing import swing_paths
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.motion.motion import (
    Motion,
    StageClock,
    SupportedMotion,
    plan_motion,
    plan_support,
)
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.least_cost import least_cost
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.scene.climb_scene import ClimbScene, Stance
from climbplan.climb.windows.body_way import BodyWay
from climbplan.climb.windows.window_scenes import (
    LOOSE_GAP,
    Behind,
    by_method,
    next_windows,
    with_rounds,
)
from climbplan.errors import LimitReached, NoPlanFound, NotProved

_KEPT = 0.5  # share of a window's rounds
_PROGRESS = 5e-3  # [m] of the way that the rounds kept cover at least
_NODES = 100  # of a search for a window by branch and bound, at most
_BACKINGS = 6  # times that rounds are given up at most
_METHODS = ("micp", "nlp")  # of `auto`, in turn

_log = logging.getLogger(__name__)


@dataclass
class _Done:
    """What was planned so far."""

    rounds: Rounds
    covered: float  # [m] of the way
    windows: int = 0
    backed: int = 0  # times that rounds were given up because no window went on from them
    nodes: int = 0
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def stance(self) -> Stance:
        """Where the next window begins."""
        r = self.rounds
        return Stance(r.com[-1], r.rpy[-1], r.toes[-1], r.region[-1])

    @property
    def behind(self) -> Behind:
        """What the next window goes on from."""
        return Behind(self.stance, self.rounds.count, self.covered, self.backed)


@dataclass(frozen=True)
class WindowedMotion:
    """A motion found in windows, and the scene with the rounds that it took."""

    scene: ClimbScene
    supported: SupportedMotion


def plan_in_windows(
    scene: ClimbScene, window: int, clock: StageClock, deadline: float
) -> WindowedMotion:
    """Postures, instants and forces of a climb, `window` rounds at a time.

    deadline: `time.monotonic` [s]. Where no window goes on, the last rounds are planned
    again at another pace. Raises NotProved where a window has no plan, with its place, and
    LimitReached.
    """
    way = BodyWay.of(scene)
    start = scene.start
    first = Rounds(start.com[None], start.rpy[None], start.toes[None], start.region[None])
    done = _Done(first, 0.0)
    while True:
        if time.monotonic() > deadline:
            raise LimitReached(f"{_where(done, way)}: no time left", stage="posture")
        try:
            found = _next(scene, way, window, done, clock, deadline)
        except NoPlanFound as failure:
            if done.backed == _BACKINGS or not _back(done, way, window):
                raise
            _log.info("window    back to round %d: %s", done.rounds.count, failure)
            continue
        _append(done, found, way)
        _log.info(
            "window    %d: round %d, %.2f of %.2f m, %d nodes",
            *(done.windows, done.rounds.count, done.covered, way.length, done.nodes),
        )
        if found.last:
            return _joined(scene, done, window, clock)


@dataclass(frozen=True)
class _Window:
    """A window that was planned."""

    motion: Motion  # of the rounds that are kept
    last: bool


def _next(
    scene: ClimbScene, way: BodyWay, window: int, done: _Done, clock: StageClock, deadline: float
) -> _Window:
    """The first of several windows that has a plan; raises the failure of the first."""
    failure: NoPlanFound | None = None
    for method in _METHODS if scene.spec.solver.method == "auto" else (None,):
        for part, last in next_windows(scene, way, window, done.behind):
            chosen = part if method is None else by_method(part, method)
            try:
                count = part.spec.task.round_count
                kept = count if last else max(int(_KEPT * count), 1)
                motion = plan_motion(chosen, clock, None, deadline, kept, _NODES)
                motion = plan_support(chosen, motion, clock, deadline).motion
            except NoPlanFound as error:
                _log.info("window    %s: %s", chosen.spec.solver.method, error)
                failure = failure or error
                continue
            reached = way.nearest(motion.posture.rounds.com[-1], done.covered)
            if last or reached - done.covered >= _PROGRESS:
                return _Window(motion, last)
    place = ", ".join(f"{v:.2f}" for v in done.stance.com)
    detail = "no progress" if failure is None else failure.message
    raise NotProved(
        f"{_where(done, way)}, with the body at ({place}): {detail}",
        [] if failure is None else failure.conflicts,
        because="what was planned before it is kept: other postures there may lead on",
        stage="posture" if failure is None else failure.stage,
    ) from failure


def _back(done: _Done, way: BodyWay, window: int) -> bool:
    """Give up the last rounds, and twice as many when that did not help; False at the start."""
    count = done.rounds.count
    if count == 0:
        return False
    done.backed += 1
    kept = max(count - max(int(_KEPT * window), 1) * ((done.backed + 1) // 2), 0)
    done.rounds = done.rounds.first(kept)
    done.covered = 0.0
    for com in done.rounds.com:
        done.covered = way.nearest(com, done.covered)
    return True


def _append(done: _Done, found: _Window, way: BodyWay) -> None:
    new, old = found.motion.posture.rounds, done.rounds
    done.rounds = Rounds(
        np.concatenate([old.com, new.com[1:]]),
        np.concatenate([old.rpy, new.rpy[1:]]),
        np.concatenate([old.toes, new.toes[1:]]),
        np.concatenate([old.region, new.region[1:]]),
    )
    done.covered = way.nearest(done.rounds.com[-1], done.covered)
    done.windows += 1
    done.nodes += found.motion.posture.nodes
    done.notes += [f"window {done.windows}: {note}" for note in found.motion.tightenings]


def _joined(scene: ClimbScene, done: _Done, window: int, clock: StageClock) -> WindowedMotion:
    """The whole, by the same exact checks as its windows."""
    from climbplan.climb.postures.nlp.check import posture_cost

    whole = with_rounds(scene, done.rounds.count)
    with clock.stage("kinematics"):
        instants = plan_instants(whole, done.rounds)
        short = limb_shortfall(whole, done.rounds, instants)
        too_near = short is not None and short.missing > 1e-9
        if too_near or body_shortfall(whole, done.rounds).max(initial=0.0) > 1e-9:
            what = f"{short.where}, {short.words(whole)}" if short and too_near else "the body"
            raise NotProved(
                f"windows do not join: {what}",
                because="each was checked alone",
                stage="kinematics",
            )
        swings = None if short is None else swing_paths(whole, done.rounds, instants)
    objective, bound = posture_cost(whole, done.rounds), least_cost(whole)
    note = (
        f"planned in {done.windows} windows of at most {window} rounds, each by exact search: "
        f"optimal a window at a time, to {LOOSE_GAP:.0%}, the whole may be done with less; the "
        "bound is that of the straight way"
    )
    posture = PostureResult(
        rounds=done.rounds,
        status="feasible",
        objective=objective,
        bound=bound,
        gap=max(objective - bound, 0.0) / max(abs(objective), 1e-9),
        nodes=done.nodes,
        solver=f"windows of {window} rounds",
        sizes={
            "windows": done.windows,
            "window_rounds": window,
            "bound_holds_for": "the straight way of body and toes in as many rounds",
        },
        warnings=(note,),
    )
    motion = Motion(posture, instants, tuple(done.notes), swings)
    with clock.stage("force"):
        forces = plan_forces(whole, instants)
    return WindowedMotion(whole, SupportedMotion(motion, forces))


def _where(done: _Done, way: BodyWay) -> str:
    return (
        f"window {done.windows + 1}, after {done.rounds.count} rounds and {done.covered:.2f} of "
        f"{way.length:.2f} m"
    )
