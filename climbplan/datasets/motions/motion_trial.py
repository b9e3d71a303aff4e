"""One motion: a spec planned, verified from its file, simulated in MuJoCo, and measured."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.errors import UsageError
from climbplan.motions.tracked_motion import TrackedMotion
from climbplan.schema.loaded import LoadedSpec
from climbplan.schema.overrides import Override
from climbplan.simulation.conditions import NOMINAL
from climbplan.walking.schema.loading import LoadedMpc

_PACE_RATIO = 1.5  # between paces that are simulated


@dataclass(frozen=True)
class SimulatedEnd:
    """How a plan ends in MuJoCo."""

    fall: float | None  # [s] when it fell; None: it stands
    num_slips: int
    num_lost_contacts: int

    @property
    def stands_firmly(self) -> bool:
        """Return whether it stands without a slip or a lost contact."""
        return self.fall is None and not self.num_slips and not self.num_lost_contacts


@dataclass(frozen=True)
class VerifiedMotionPlan:
    """A plan that was made of a spec: its file, its verification, its motion."""

    path: Path
    status: str  # "optimal", "feasible"
    objection: str  # of its verification; empty if it passed
    cpu: float  # [s] of planning and verification


def plan_motion(loaded: LoadedSpec, path: Path) -> VerifiedMotionPlan:
    """Plan a spec, write the plan, and verify it from its file.

    Args:
        loaded: A climb, transition or walk.
        path: Of the plan file.

    Raises:
        NoPlanFound: There is no plan, or none was found.
        UsageError: The spec is of another kind.
    """
    begin = time.process_time()
    match loaded:
        case LoadedClimb() | LoadedTransition():
            status, objection = _plan_climb(loaded, path)
        case LoadedMpc():
            status, objection = _plan_walk(loaded, path)
        case _:
            raise UsageError(
                f"{loaded.name}: expected a spec of kind `climb`, `transition` or `mpc`, which a "
                "robot moves by"
            )
    return VerifiedMotionPlan(path, status, objection, time.process_time() - begin)


def time_by_dynamics(loaded: LoadedSpec) -> LoadedSpec:
    """Return a climb or transition that is as fast as its dynamics allow; others unchanged."""
    if not isinstance(loaded, LoadedClimb | LoadedTransition):
        return loaded
    return loaded.with_overrides([Override("trajectory.pace", "fastest", "problem.pace")])


def _plan_climb(loaded: LoadedClimb | LoadedTransition, path: Path) -> tuple[str, str]:
    from climbplan.climb.check.verification import verify_and_mark
    from climbplan.climb.plan.file import write_climb
    from climbplan.climb.planner.planner import plan_climb
    from climbplan.climb.transition.planner import plan_transition

    plan = plan_climb(loaded) if isinstance(loaded, LoadedClimb) else plan_transition(loaded)
    write_climb(plan, path)
    return plan.status, verify_and_mark(path).objection


def _plan_walk(loaded: LoadedMpc, path: Path) -> tuple[str, str]:
    from climbplan.walking.check.verification import verify_and_mark
    from climbplan.walking.plan.file import write_walk_plan
    from climbplan.walking.planner.planner import plan_walk

    plan = plan_walk(loaded)
    write_walk_plan(plan, path)
    return plan.status, verify_and_mark(path).objection


def simulate_motion(loaded: LoadedSpec, path: Path, pace: float = 1.0) -> SimulatedEnd:
    """Replay a plan file in MuJoCo, in the world that it was planned for.

    Args:
        loaded: The spec that it was planned from.
        path: The plan file.
        pace: Factor on the speed of climbs.

    Raises:
        MissingSolver: MuJoCo is not installed.
        UsageError: There is no model of its robot.
    """
    if isinstance(loaded, LoadedMpc):
        return _simulate_walk(path)
    from climbplan.climb.plan.file import read_climb
    from climbplan.climb.simulation.comparison import find_losses, find_slips
    from climbplan.climb.simulation.replay import simulate

    plan = read_climb(path)
    run = simulate(plan, replace(NOMINAL, speed=pace))
    fall = float(run.time[-1]) if run.fallen else None
    return SimulatedEnd(fall, len(find_slips(plan, run)), len(find_losses(plan, run)))


def _simulate_walk(path: Path) -> SimulatedEnd:
    from climbplan.walking.plan.file import read_walk_plan
    from climbplan.walking.simulation.comparison import compare_walk
    from climbplan.walking.simulation.whole_body_replay import simulate_whole_body

    plan = read_walk_plan(path)
    run = simulate_whole_body(plan, NOMINAL)
    compared = compare_walk(plan, run)
    fall = float(run.time[-1]) if run.fallen else None
    return SimulatedEnd(fall, len(compared.slips), 0)


def find_fast_motion(
    loaded: LoadedSpec, path: Path, rate: float, name: str
) -> tuple[TrackedMotion, SimulatedEnd] | None:
    """Return a climb's motion at the fastest pace at which it stands firmly in MuJoCo.

    The pace is at most the fastest by inverse dynamics, and is lowered by a third at a time.

    Args:
        loaded: The spec that it was planned from.
        path: The plan file.
        rate: Sample rate [Hz].
        name: Of the motion.

    Returns:
        The motion, with its contact forces solved again, and how it ends; None where no pace
        beyond the planned one does, or no forces can be solved for.
    """
    if isinstance(loaded, LoadedMpc):
        return None
    from climbplan.climb.exports.paced_motion import (
        build_paced_motion,
        find_plan_pace,
        has_pace,
        read_plan_robot,
    )
    from climbplan.climb.plan.file import read_climb

    plan = read_climb(path)
    robot = read_plan_robot(plan)
    if robot is None or not has_pace(plan, robot):
        return None
    pace = find_plan_pace(plan, robot)
    while pace > 1:
        end = simulate_motion(loaded, path, pace)
        motion = build_paced_motion(plan, robot, rate, pace) if end.stands_firmly else None
        if motion is not None:
            return replace(motion, name=name, is_verified=True), end
        pace /= _PACE_RATIO
    return None


def read_motion(loaded: LoadedSpec, path: Path, rate: float, name: str) -> TrackedMotion:
    """Return the motion of a verified plan file under a name.

    Args:
        loaded: The spec that it was planned from.
        path: The plan file.
        rate: Sample rate [Hz].
        name: Of the motion.

    Raises:
        UsageError: The links of the robot are unknown.
    """
    if isinstance(loaded, LoadedMpc):
        from climbplan.walking.exports.tracked_motion import read_tracked_motion as read_walk

        motion = read_walk(path, rate)
    else:
        from climbplan.climb.exports.tracked_motion import read_tracked_motion as read_climb

        motion = read_climb(path, rate)
    return replace(motion, name=name, is_verified=True)
