"""Plan long climbs by a receding horizon: windows of rounds, each solved exactly, joined to a plan.

A window has W rounds and begins where the one before it was cut. All but the last approach a point
of the body's path that W rounds can cover, by the cost of the posture problem. Half of a window's
rounds are committed, the other half is planned again in the next window, which avoids dead ends.
The last window has the goal of the spec.

`window_scenes.py` lists possible windows. Committed rounds pass the exact kinematic, clearance and
force checks before the next window begins.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field, replace

import numpy as np

from climbplan.climb.clearance.body import compute_body_shortfall
from climbplan.climb.clearance.limbs import find_limb_shortfall
from climbplan.climb.clearance.swing import plan_swing_paths
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.motion.motion import (
    ClimbMotion,
    StageClock,
    SupportedMotion,
    plan_motion,
    plan_support,
)
from climbplan.climb.motion.open_rounds import OpenRoundsMotion, PartialClimb
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.cost_bound import bound_posture_cost
from climbplan.climb.postures.planner import PostureResult
from climbplan.climb.scene.climb_scene import ClimbScene, ClimbStance
from climbplan.climb.windows.body_way import BodyPath
from climbplan.climb.windows.window_scenes import (
    LOOSE_GAP,
    WindowStart,
    list_windows,
    replace_method,
    replace_rounds,
)
from climbplan.errors import LimitReached, NoPlanFound, Unresolved

_COMMITTED_FRACTION = 0.5  # of a window's rounds
_MIN_PROGRESS = 5e-3  # [m] of the path that committed rounds cover
_MAX_NODES = 100  # of a window's branch and bound
_MAX_BACKTRACKS = 6  # times that rounds are discarded
_METHODS = ("micp", "nlp")  # of `auto`, in turn

_log = logging.getLogger(__name__)


@dataclass
class _Progress:
    """The rounds planned so far."""

    rounds: Rounds
    covered: float  # [m] of the way
    windows: int = 0
    num_backtracks: int = 0  # times that rounds were given up because no window went on from them
    nodes: int = 0
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    furthest: Rounds | None = None  # of those that were discarded
    furthest_covered: float = 0.0  # [m] of the way

    def keep_furthest(self) -> None:
        """Keep the rounds where they come further than any before."""
        if self.covered > self.furthest_covered:
            self.furthest, self.furthest_covered = self.rounds, self.covered

    @property
    def stance(self) -> ClimbStance:
        """Stance at which the next window begins."""
        r = self.rounds
        return ClimbStance(r.com[-1], r.rpy[-1], r.toes[-1], r.region[-1])

    @property
    def window_start(self) -> WindowStart:
        """State from which the next window continues."""
        return WindowStart(self.stance, self.rounds.count, self.covered, self.num_backtracks)


def plan_in_windows(
    scene: ClimbScene, window: int, clock: StageClock, deadline: float
) -> OpenRoundsMotion:
    """Plan postures, instants and forces of a climb, `window` rounds at a time.

    If no window continues a plan, its last rounds are planned again at another pace.

    Args:
        scene: The scene.
        window: Rounds of a window.
        clock: Times the stages.
        deadline: Time limit in `time.monotonic` seconds.

    Raises:
        Unresolved: A window has no plan; the message names its place.
        LimitReached: The time limit was reached.
    """
    path = BodyPath.from_scene(scene)
    start = scene.start
    first_rounds = Rounds(start.com[None], start.rpy[None], start.toes[None], start.region[None])
    progress = _Progress(first_rounds, 0.0)
    while True:
        if time.monotonic() > deadline:
            limit = LimitReached(
                f"{_format_place(progress, path)}: `solver.time_limit` ended the search",
                stage="posture",
            )
            limit.partial = _keep_furthest(progress, path, window, clock)
            raise limit
        try:
            planned = _plan_next_window(scene, path, window, progress, clock, deadline)
        except NoPlanFound as failure:
            progress.keep_furthest()
            if progress.num_backtracks == _MAX_BACKTRACKS or not _backtrack(progress, path, window):
                failure.partial = _keep_furthest(progress, path, window, clock)
                raise
            _log.info("window    back to round %d: %s", progress.rounds.count, failure)
            continue
        _append_window(progress, planned, path)
        _log.info(
            "window    %d: round %d, %.2f of %.2f m, %d nodes",
            *(
                progress.windows,
                progress.rounds.count,
                progress.covered,
                path.length,
                progress.nodes,
            ),
        )
        if planned.last:
            return _join_windows(scene, progress, window, clock)


@dataclass(frozen=True)
class _Window:
    """A window that was planned."""

    motion: ClimbMotion  # of the rounds that are kept
    last: bool


def _plan_next_window(
    scene: ClimbScene,
    path: BodyPath,
    window: int,
    progress: _Progress,
    clock: StageClock,
    deadline: float,
) -> _Window:
    """Plan the first of several windows that has a plan; raise the failure of the first."""
    failure: NoPlanFound | None = None
    for method in _METHODS if scene.spec.solver.method == "auto" else (None,):
        for window_scene, last in list_windows(scene, path, window, progress.window_start):
            chosen = window_scene if method is None else replace_method(window_scene, method)
            try:
                count = window_scene.spec.task.round_count
                committed = count if last else max(int(_COMMITTED_FRACTION * count), 1)
                motion = plan_motion(chosen, clock, None, deadline, committed, _MAX_NODES)
                motion = plan_support(chosen, motion, clock, deadline).motion
            except NoPlanFound as error:
                _log.info("window    %s: %s", chosen.spec.solver.method, error)
                failure = failure or error
                continue
            covered = path.project(motion.posture.rounds.com[-1], progress.covered)
            if last or covered - progress.covered >= _MIN_PROGRESS:
                return _Window(motion, last)
    place = ", ".join(f"{v:.2f}" for v in progress.stance.com)
    detail = "no progress" if failure is None else failure.message
    raise Unresolved(
        f"{_format_place(progress, path)}, with the body at ({place}): {detail}",
        [] if failure is None else failure.conflicts,
        because="what was planned before it is kept: other postures there may lead on",
        stage="posture" if failure is None else failure.stage,
    ) from failure


def _backtrack(progress: _Progress, path: BodyPath, window: int) -> bool:
    """Discard the last rounds, twice as many if that did not help; return False at the start."""
    count = progress.rounds.count
    if count == 0:
        return False
    progress.num_backtracks += 1
    committed = max(
        count - max(int(_COMMITTED_FRACTION * window), 1) * ((progress.num_backtracks + 1) // 2), 0
    )
    progress.rounds = progress.rounds.first(committed)
    progress.covered = 0.0
    for com in progress.rounds.com:
        progress.covered = path.project(com, progress.covered)
    return True


def _keep_furthest(
    progress: _Progress, path: BodyPath, window: int, clock: StageClock
) -> PartialClimb | None:
    """Return the rounds that came furthest; None without any."""
    progress.keep_furthest()
    rounds = progress.furthest
    if rounds is None:
        return None
    furthest = replace(progress, rounds=rounds, covered=progress.furthest_covered)
    return PartialClimb(
        end=furthest.stance,
        num_rounds=rounds.count,
        covered=furthest.covered,
        length=path.length,
        build=lambda scene: _join_windows(scene, furthest, window, clock),
    )


def _append_window(progress: _Progress, planned: _Window, path: BodyPath) -> None:
    added, previous = planned.motion.posture.rounds, progress.rounds
    progress.rounds = Rounds(
        np.concatenate([previous.com, added.com[1:]]),
        np.concatenate([previous.rpy, added.rpy[1:]]),
        np.concatenate([previous.toes, added.toes[1:]]),
        np.concatenate([previous.region, added.region[1:]]),
    )
    progress.covered = path.project(progress.rounds.com[-1], progress.covered)
    progress.windows += 1
    progress.nodes += planned.motion.posture.nodes
    progress.notes += [f"window {progress.windows}: {note}" for note in planned.motion.tightenings]


def _join_windows(
    scene: ClimbScene, progress: _Progress, window: int, clock: StageClock
) -> OpenRoundsMotion:
    """Join the windows, with the same exact checks of the whole."""
    from climbplan.climb.postures.nlp.check import compute_posture_cost

    whole_scene = replace_rounds(scene, progress.rounds.count)
    with clock.stage("kinematics"):
        instants = plan_instants(whole_scene, progress.rounds)
        shortfall = find_limb_shortfall(whole_scene, progress.rounds, instants)
        is_too_near = shortfall is not None and shortfall.missing > 1e-9
        if (
            is_too_near
            or compute_body_shortfall(whole_scene, progress.rounds).max(initial=0.0) > 1e-9
        ):
            place = (
                f"{shortfall.where}, {shortfall.describe(whole_scene)}"
                if shortfall and is_too_near
                else "the body"
            )
            raise Unresolved(
                f"windows do not join: {place}",
                because="each was checked alone",
                stage="kinematics",
            )
        swings = (
            None if shortfall is None else plan_swing_paths(whole_scene, progress.rounds, instants)
        )
    objective, bound = (
        compute_posture_cost(whole_scene, progress.rounds),
        bound_posture_cost(whole_scene),
    )
    note = (
        f"planned in {progress.windows} windows of at most {window} rounds, each by exact search: "
        f"optimal a window at a time, to {LOOSE_GAP:.0%}, the whole may be done with less; the "
        "bound is that of the straight way"
    )
    posture = PostureResult(
        rounds=progress.rounds,
        status="feasible",
        objective=objective,
        bound=bound,
        gap=max(objective - bound, 0.0) / max(abs(objective), 1e-9),
        nodes=progress.nodes,
        solver=f"windows of {window} rounds",
        sizes={
            "windows": progress.windows,
            "window_rounds": window,
            "bound_holds_for": "the straight way of body and toes in as many rounds",
        },
        warnings=(note,),
    )
    motion = ClimbMotion(posture, instants, tuple(progress.notes), swings)
    with clock.stage("force"):
        forces = plan_forces(whole_scene, instants)
    return OpenRoundsMotion(whole_scene, SupportedMotion(motion, forces))


def _format_place(progress: _Progress, path: BodyPath) -> str:
    return (
        f"window {progress.windows + 1}, after {progress.rounds.count} rounds and "
        f"{progress.covered:.2f} of {path.length:.2f} m"
    )
