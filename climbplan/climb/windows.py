"""Long climbs a window of rounds at a time, each by exact search, joined into one plan.

A window has W rounds and begins where the one before it was cut. All but the last aim at a point
of the body's way, as far on as W rounds can take it: body and toes are drawn there by the cost of
the posture problem, and need not reach it. Half of a window's rounds are kept, the other half is
planned again in the next, so that a window never ends where nothing goes on. The last window has
the goal as the spec states it.

Only regions and free space that a limb can come to within the window are alternatives in it, so
that its size does not grow with the terrain. What is kept of a window passes the exact kinematic,
clearance and force checks before the next begins.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.climb.body_way import BodyWay
from climbplan.climb.clearance import body_shortfall
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait import plan_instants
from climbplan.climb.limb_clearance import limb_shortfall
from climbplan.climb.motion import Motion, StageClock, SupportedMotion, plan_motion, plan_support
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.nlp.check import posture_cost
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.postures.ways import ways_too_long
from climbplan.climb.scene import ClimbScene, Stance
from climbplan.climb.swing import swing_paths
from climbplan.climb.within_reach import reachable, within_rounds
from climbplan.errors import LimitReached, NoPlanFound, NotProved
from climbplan.robots.rotations import Array, rotation_world_body
from climbplan.spec.climb.model import MOST_ROUNDS

WINDOW = 4  # rounds, where the spec leaves both them and their number open
_KEPT = 0.5  # share of a window's rounds
_PACES = (1.0, 0.5)  # shares of what a window's rounds can cover, aimed at in turn
_PROGRESS = 5e-3  # [m] of the way that the rounds kept cover at least
_DRAWN = 0.1  # factor on the weights of toes and angles at a window's end that is not the goal
_CATCHING_UP = 4.0  # factor on the relative lag behind an even pace
_ANYWHERE = 1e3  # [m] tolerance of such an end
_NODES = 100  # of a search for a window by branch and bound, at most
_BACKINGS = 6  # times that rounds are given up at most
_GAP = 0.02  # relative, of windows that are not the last: half of them is planned again
_BEYOND = 2e-3  # [m]
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


@dataclass(frozen=True)
class WindowedMotion:
    """A motion found in windows, and the scene with the rounds that it took."""

    scene: ClimbScene
    supported: SupportedMotion


def window_of(scene: ClimbScene) -> int | None:
    """Rounds of a window; None where all rounds are planned at once."""
    window, rounds = scene.spec.solver.window, scene.spec.task.rounds
    if rounds == "auto":
        return WINDOW if window is None else window
    return None if window is None or window >= rounds else window


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
        for part, last in _windows(scene, way, window, done):
            chosen = part if method is None else _by(part, method)
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


def _windows(
    scene: ClimbScene, way: BodyWay, window: int, done: _Done
) -> Iterator[tuple[ClimbScene, bool]]:
    """Windows to try from where the plan is, and whether they are the last."""
    here = replace(scene, start=done.stance)
    asked = scene.spec.task.rounds
    most = MOST_ROUNDS if asked == "auto" else int(asked)
    left = most - done.rounds.count
    if left <= 0:
        return
    com_max = scene.spec.posture.steps.com_max
    ahead = way.length - done.covered
    if asked != "auto":
        if left <= window:
            yield _part(here, left), True
            return
        # Windows fall short of what they are drawn to: who is behind is drawn further
        needed, even = ahead / left, max(way.length / most, 1e-9)
        pace = min(needed * (1.0 + _CATCHING_UP * max(needed / even - 1.0, 0.0)), com_max)
        yield _towards(here, way, done.covered + window * pace, window), False
        return
    least = max([1, *(one.needed for one in ways_too_long(_with_rounds(here, 1)))])
    least = max(least, int(np.ceil((ahead - scene.spec.task.goal.tolerance) / com_max - 1e-6)))
    for count in range(least, min(window, left) + 1):
        yield _part(here, count), True
    for pace in _PACES if done.backed % 2 == 0 else _PACES[::-1]:
        aim = min(done.covered + pace * window * com_max, way.length)
        yield _towards(here, way, aim, min(window, left)), False


def _by(scene: ClimbScene, method: str) -> ClimbScene:
    solver = scene.spec.solver.model_copy(update={"method": method})
    return replace(scene, spec=scene.spec.model_copy(update={"solver": solver}))


def _with_rounds(scene: ClimbScene, count: int) -> ClimbScene:
    task = scene.spec.task.model_copy(update={"rounds": count})
    return replace(scene, spec=scene.spec.model_copy(update={"task": task}))


def _part(scene: ClimbScene, count: int) -> ClimbScene:
    """A scene of so many rounds, with what of the terrain they can come to.

    Rotations are linearised about each window's own start, so that toes which the window before it
    left at the edge of their stance workspace may be some mm outside it: it is that much larger.
    """
    radius = max(scene.robot.stance_radius, _farthest_of_stance(scene) + _BEYOND)
    robot = replace(scene.robot, stance_radius=radius)
    scene = replace(scene, robot=robot)
    near = within_rounds(scene, count)
    part = replace(_with_rounds(scene, count), terrain=near, robot=robot)
    if near.curved:
        return part
    found = reachable(part, count)
    nowhere = ~found.any(axis=2)  # the program says what is out of reach
    found[nowhere] = np.broadcast_to(near.allowed, found.shape)[nowhere]
    return replace(part, by_round=found)


def _farthest_of_stance(scene: ClimbScene) -> float:
    """Largest distance of a toe from its nominal stance at the scene's start [m]."""
    start = scene.start
    nominal = start.com + scene.robot.stance_body @ rotation_world_body(start.rpy).T
    return float(np.linalg.norm(start.toes - nominal, axis=1).max())


def _towards(scene: ClimbScene, way: BodyWay, aim: float, count: int) -> ClimbScene:
    """A window that is drawn to a place of the way and need not reach it."""
    part = _part(scene, count)
    share = aim / way.length if way.length > 0 else 1.0
    com = way.at(aim)
    first, last = np.array(scene.spec.task.start.rpy_deg), np.array(scene.spec.task.goal.rpy_deg)
    rpy = np.deg2rad(first + share * (last - first))
    goal = _standing_at(part, com, rpy)
    spec = part.spec
    solver = spec.solver.model_copy(update={"gap": max(spec.solver.gap, _GAP)})
    loose = spec.task.goal.model_copy(
        update={"tolerance": _ANYWHERE, "rotation_tolerance_deg": 360.0}
    )
    weights = spec.posture.weights
    weights = weights.model_copy(
        update={
            "goal": _DRAWN * weights.goal,
            "goal_rotation": _DRAWN * weights.goal_rotation,
            "goal_com": max(weights.goal_com, weights.goal),
        }
    )
    task = spec.task.model_copy(update={"goal": loose})
    posture = spec.posture.model_copy(update={"weights": weights})
    drawn = spec.model_copy(update={"task": task, "posture": posture, "solver": solver})
    return replace(part, spec=drawn, goal=goal)


def _standing_at(scene: ClimbScene, com: Array, rpy: Array) -> Stance:
    """Toes on the surface points nearest to the nominal stance of a body pose."""
    nominal = com + scene.robot.stance_body @ rotation_world_body(rpy).T
    region = np.array(
        [scene.terrain.nearest_surface(i, point) for i, point in enumerate(nominal)], np.int64
    )
    toes = [scene.terrain.surfaces[r].project(p) for r, p in zip(region, nominal, strict=True)]
    return Stance(com, rpy, np.array(toes), region)


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
    whole = _with_rounds(scene, done.rounds.count)
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
        f"optimal a window at a time, to {_GAP:.0%}, the whole may be done with less; the bound is "
        "that of the straight way"
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


def least_cost(scene: ClimbScene) -> float:
    """A lower bound [m^2] on the posture cost of a scene's rounds: straight ways in equal steps.

    Of M steps that cover a length l the squares sum up to l^2 / M at least. A goal missed by d, of
    which its tolerance is the most, costs W d^2 and leaves l = L - d to cover.
    """
    spec, start, goal = scene.spec, scene.start, scene.goal
    weights, m = spec.posture.weights, spec.task.round_count
    turn = float(np.deg2rad(spec.task.goal.rotation_tolerance_deg))
    far = spec.task.goal.tolerance
    toes = np.linalg.norm(goal.toes - start.toes, axis=1)
    terms = [
        (weights.goal, weights.toe, toes, far),
        (weights.goal_com, weights.com, np.linalg.norm(goal.com - start.com), far),
        (weights.goal_rotation, weights.rotation, np.abs(goal.rpy - start.rpy), turn),
    ]
    total = 0.0
    for missing, step, length, most in terms:
        way = np.atleast_1d(np.asarray(length, float))
        each = step / m
        missed = np.minimum(np.minimum(each * way / (missing + each), most), way)
        total += float((missing * missed**2 + each * (way - missed) ** 2).sum())
    return total


def _where(done: _Done, way: BodyWay) -> str:
    return (
        f"window {done.windows + 1}, after {done.rounds.count} rounds and {done.covered:.2f} of "
        f"{way.length:.2f} m"
    )
