"""The transition planner: sequences, motion, instants, forces, trajectory (chapter 5.3)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from climbplan.climb.check.verification import verification_of
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.looks import plan_looks
from climbplan.climb.motion import StageClock
from climbplan.climb.plan.climb_plan import (
    Array,
    ClimbPlan,
    Forces,
    Instants,
    Mask,
    Rounds,
    Sequences,
    Trajectory,
)
from climbplan.climb.planner import deflection_warnings, step_limits
from climbplan.climb.scene import Stance, on_scan
from climbplan.climb.trajectory import plan_trajectory
from climbplan.climb.transition.balanced_poses import balanced_poses
from climbplan.climb.transition.clear_standing import standing_trouble
from climbplan.climb.transition.gait import plan_instants
from climbplan.climb.transition.homotopy import run_start
from climbplan.climb.transition.mission import Tail, climb_after, joined_instants, joined_rounds
from climbplan.climb.transition.motion import plan_motion
from climbplan.climb.transition.pose_ways import Sequence
from climbplan.climb.transition.refusal import OutOfReach, no_sequence
from climbplan.climb.transition.remedies import with_remedies
from climbplan.climb.transition.scene import TransitionScene, build_transition
from climbplan.climb.transition.search import Search
from climbplan.climb.transition.stances import Laboratory
from climbplan.climb.transition.summary import summary_lines
from climbplan.errors import Infeasible, NoPlanFound, NotProved, UsageError
from climbplan.plans.verification import Verification
from climbplan.progress import Progress
from climbplan.robots.any_robot import assumptions
from climbplan.spec.climb.transition_loading import LoadedTransition
from climbplan.spec.robots.stored import robot_texts

_FOR_SEARCH = 0.6  # share of the time limit that `auto` gives to the search
_FOR_PLANS = 0.8  # share that it uses for plans of the spec as it is; the rest is for remedies
# Of the margins, tried in turn; forces of the body that goes on, after each lift, take some
_SHARES = (1.2, 0.9, 0.6, 0.3, 0.0)
# Checks that rows for limbs and body may mend
_TOO_CLOSE = frozenset(
    f"{part}.{what}"
    for part in ("limbs", "body", "trajectory")
    for what in ("clearance", "capsules", "self_collision")
)
_FIRMER = (1.0, 1.15, 1.35, 1.6)  # factors on S_tau tried in turn for one sequence


@dataclass(frozen=True)
class Complete:
    """A motion with everything that follows from it."""

    rounds: Rounds
    instants: Instants
    forces: Forces
    trajectory: Trajectory


@dataclass(frozen=True)
class Run:
    """One planning run."""

    loaded: LoadedTransition
    scene: TransitionScene
    clock: StageClock
    tail: Tail | None = None  # the climb that follows


class LimbsMeet(NotProved):
    """Limbs meet the terrain, the body or one another."""

    def __init__(self, words: str) -> None:
        because = "the motion of a sequence is found by a local method"
        super().__init__(f"limbs meet: {words}", because=because, stage="motion")


def complete(run: Run, rounds: Rounds, moved: Mask, first: Array) -> Complete:
    """Instants, forces and trajectory of postures; raises what each of them raises.

    first: (3,) where the body is at the first lift.
    """
    scene, clock = run.scene, run.clock
    with clock.stage("kinematics"):
        instants = plan_instants(scene, rounds, moved, first)
        trouble = standing_trouble(scene, instants)
        if trouble is not None:
            raise LimbsMeet(trouble)
    if run.tail is not None:
        rounds = joined_rounds(rounds, run.tail.rounds)
        instants = joined_instants(instants, run.tail.instants)
    with clock.stage("force"):
        forces = plan_forces(scene, instants)
    with clock.stage("trajectory"):
        trajectory = plan_trajectory(scene, rounds, instants, forces)
    return Complete(rounds, instants, forces, trajectory)


def verified(run: Run, rounds: Rounds, moved: Mask, first: Array) -> tuple[Complete, Verification]:
    """What follows from postures, and all checks of their plan; raises what `complete` raises."""
    done = complete(run, rounds, moved, first)
    with run.clock.stage("check"):
        return done, verification_of(assemble(run, Found(done, {})))


def transition_cost(
    scene: TransitionScene, rounds: Rounds, forces: Forces, goal: Stance | None = None
) -> float:
    """Body, turn and toe steps, and 1 / S_tau at every lift, weighted as in the spec.

    Where a climb follows, also what it misses of its goal.
    """
    w = scene.spec.posture.weights
    off_com = off_toes = off_turn = np.zeros(3)
    if goal is not None:
        off_com, off_turn = rounds.com[-1] - goal.com, rounds.rpy[-1] - goal.rpy
        off_toes = rounds.toes[-1] - goal.toes
    cost = (
        w.goal * np.sum(off_toes**2)
        + w.goal_com * np.sum(off_com**2)
        + w.goal_rotation * np.sum(off_turn**2)
        + w.com * np.sum(np.diff(rounds.com, axis=0) ** 2)
        + w.rotation * np.sum(np.diff(rounds.rpy, axis=0) ** 2)
        + w.toe * np.sum(np.diff(rounds.toes, axis=0) ** 2)
        + w.effort * np.sum(1 / forces.safety_torque[::2])
    )
    return float(cost)


@dataclass(frozen=True)
class Attempt:
    """What became of a sequence: a whole motion, or why there is none."""

    complete: Complete | None
    iterations: int  # of IPOPT
    reason: str = ""


def carry_through(run: Run, lab: Laboratory, sequence: Sequence) -> Attempt:
    """The verified motion of a sequence, planned firmer where it does not hold.

    The program of the motion knows neither buckling nor links that hit a box: where the forces, the
    trajectory or the verification fail it is asked for a larger S_tau, which leaves room for them.
    It is asked for all margins first, and for less where it finds no motion with them. Where limbs
    or body come too close to anything it is planned again with rows that keep them off.
    """
    scene, parted = run.scene, False
    reason, iterations = "", 0
    shares = (0.0,) if not scene.spec.margins.asked else _SHARES
    beyond = 0.0  # share of the margins for which there is no motion
    for share, factor in product(shares, _FIRMER):
        asked = factor * scene.spec.force.safety_torque
        if asked > sequence.safety_torque or share == beyond > 0:
            continue
        for with_rows in (False, True):
            if parted and not with_rows:
                continue
            with run.clock.stage("motion"):
                motion = plan_motion(lab, sequence, asked, share, with_rows)
            iterations += motion.iterations
            if not motion.accepted:
                beyond = share
                reason = reason or f"no motion: {motion.block} off by {motion.violation:.2g}"
                break
            try:
                done, verification = verified(run, motion.rounds, sequence.moved, motion.first)
            except NoPlanFound as error:
                reason = " ".join(str(error).split())
                parted |= isinstance(error, LimbsMeet)
            else:
                if verification.passed:
                    return Attempt(done, iterations)
                reason = f"fails its verification: {verification.headline()}"
                failed = {check.name for check in verification.checks if not check.passed}
                parted |= not failed.isdisjoint(_TOO_CLOSE)
            if not parted:
                break
    return Attempt(None, iterations, reason or "no room for a safety margin")


@dataclass(frozen=True)
class Found:
    """What a method found."""

    complete: Complete
    sizes: dict[str, dict[str, int]]
    sequences: Sequences | None = None
    warnings: tuple[str, ...] = ()


def plan_transition(loaded: LoadedTransition, report: Progress | None = None) -> ClimbPlan:
    """A transition plan for a loaded spec.

    Raises NotProved where no sequence exists on the poses searched, saying which contacts slip,
    and LimitReached where none of the sequences or starts tried led to a plan. Every plan was
    verified as it stands in memory; the file is verified on its own.
    """
    clock = StageClock(report or (lambda stage, fraction: None))
    begin = time.monotonic()
    loaded = on_scan(loaded)
    options = loaded.spec.solver
    try:
        scene = build_transition(loaded)
        run = Run(loaded, scene, clock, climb_after(loaded, scene, clock))
        return assemble(run, _METHODS[options.method](run))
    except NoPlanFound as error:
        if options.method != "auto" or isinstance(error, Infeasible):
            raise
        refused = with_remedies(loaded, error, plan_transition, begin + options.time_limit)
        raise refused from error


def assemble(run: Run, found: Found) -> ClimbPlan:
    """The plan of what a method found."""
    loaded, scene, done = run.loaded, run.scene, found.complete
    limits, assumed = step_limits(scene), assumptions(loaded.robot, scene.robot)
    goal = run.tail.goal if run.tail is not None else scene.goal
    if run.tail is not None:
        last = scene.spec.last_goal
        limits = replace(
            limits,
            goal_com=goal.com,
            goal_toes=goal.toes,
            goal_rpy=goal.rpy,
            goal_tolerance=last.tolerance,
            goal_rotation_tolerance=float(np.deg2rad(last.rotation_tolerance_deg)),
        )
    plan = ClimbPlan(
        name=loaded.name,
        robot=scene.robot,
        terrain=scene.terrain,
        rounds=done.rounds,
        instants=done.instants,
        forces=done.forces,
        trajectory=done.trajectory,
        limits=limits,
        status="feasible",
        objective=transition_cost(scene, done.rounds, done.forces, goal),
        bound=None,
        gap=None,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=scene.spec.seed,
        timings=dict(run.clock.seconds),
        solvers={"motion": "ipopt (mumps)", "force": scene.spec.solver.force},
        sizes={**found.sizes, "force": {"instants": done.instants.count}},
        warnings=(*assumed, *found.warnings, *deflection_warnings(done.forces), *done.forces.notes),
        kind="transition",
        sequences=found.sequences,
        robot_texts=robot_texts(loaded.spec.robot, loaded.directory, loaded.robot),
        looks=plan_looks(loaded.robot, scene.robot),
    )
    return replace(plan, summary=summary_lines(plan))


def searched(scene: TransitionScene, deadline: float) -> tuple[Search, list[Sequence]]:
    """Sequences on the grid of poses, or where that has none on poses that balance stances too.

    Raises NotProved where there are none.
    """
    search = Search(scene, deadline=deadline)
    found = search.sequences()
    if not found:
        beside = balanced_poses(scene, deadline)
        search = Search(scene, deadline=deadline, beside=beside)
        found = search.sequences()
    if not found:
        raise no_sequence(scene, deadline, search.beside)
    return search, found


def _by_search(run: Run, share: float = 1.0) -> Found:
    """All sequences, and the motion of the best that holds; share: of the time limit."""
    scene, clock = run.scene, run.clock
    with clock.stage("search"):
        deadline = time.monotonic() + share * scene.spec.solver.time_limit
        search, found = searched(scene, deadline)
    outcome = [""] * len(found)
    done: Complete | None = None
    iterations = tried = 0
    for sequence in found[: scene.spec.search.tried]:
        if time.monotonic() > deadline:
            outcome[tried] = "time limit"
            break
        attempt = carry_through(run, search.lab, sequence)
        iterations += attempt.iterations
        outcome[tried] = attempt.reason or "chosen"
        tried += 1
        if attempt.complete is not None:
            done = attempt.complete
            break
    if done is None:
        refused = [f"{search.name(s)}: {o}" for s, o in zip(found, outcome, strict=True) if o]
        raise NotProved(
            "\n".join(["no sequence could be planned to the end", *refused[:5]]),
            because="the motion of a sequence is found by a local method, for the sequences tried",
            stage="motion",
        )
    sizes = {
        "search": {
            "sequences": len(found),
            "stance sets": search.tally.stances,
            "force problems": search.tally.problems,
            "poses": search.lab.poses.count,
        },
        "motion": {"iterations": iterations, "tried": tried},
    }
    sequences = Sequences(
        name=tuple(search.name(s) for s in found),
        cost=np.array([s.cost for s in found]),
        safety_torque=np.array([s.safety_torque for s in found]),
        safety_friction=np.array([s.safety_friction for s in found]),
        outcome=tuple(outcome),
    )
    return Found(done, sizes, sequences, _warnings(search))


def _by_complementarity(run: Run, seconds: float | None = None) -> Found:
    """The cheapest motion of several random starts that holds to the end, in so many seconds."""
    scene, clock = run.scene, run.clock
    if scene.spec.task.sequence is not None:
        raise UsageError(
            "method complementarity finds a sequence of its own: leave `task.sequence` out, or use "
            "--method enumerate"
        )
    options = scene.spec.solver
    deadline = time.monotonic() + (options.time_limit if seconds is None else seconds)
    found: list[Complete] = []
    reasons: list[str] = []
    iterations = 0

    def carry(lab: Laboratory, sequence: Sequence) -> str:
        attempt = carry_through(run, lab, sequence)
        if attempt.complete is not None:
            found.append(attempt.complete)
        return attempt.reason

    for number in range(options.starts):
        if time.monotonic() > deadline:
            reasons.append("time limit")
            break
        with clock.stage("homotopy"):
            start = run_start(scene, scene.spec.seed + number, carry, deadline)
        iterations += start.iterations
        reasons += [start.reason] if start.reason else []
    if not found:
        raise NotProved(
            "\n".join(["no start of complementarity led to a plan", *reasons[:5]]),
            because="method complementarity is local",
            stage="homotopy",
        )
    best = min(found, key=lambda done: transition_cost(scene, done.rounds, done.forces))
    return Found(best, {"homotopy": {"iterations": iterations, "starts that hold": len(found)}})


def _automatic(run: Run) -> Found:
    """By search, and where that finds nothing by one program that finds its own sequence."""
    began = time.monotonic()
    try:
        return _by_search(run, _FOR_SEARCH)
    except NoPlanFound as error:
        spent = time.monotonic() - began
        task = run.scene.spec.task
        left = _FOR_PLANS * run.scene.spec.solver.time_limit - spent
        if task.sequence is not None or left <= 0 or isinstance(error, OutOfReach):
            raise
        first, seconds = error, spent
    try:
        found = _by_complementarity(run, left)
    except NoPlanFound as error:
        lacked = error.message.partition("\n")[0]
        raise NotProved(
            f"{first.message}\ntried: enumerate ({seconds:.1f} s), complementarity "
            f"({time.monotonic() - began - spent:.1f} s): {lacked}",
            first.conflicts,
            because=first.because if isinstance(first, NotProved) else "a limit was reached",
            stage=first.stage,
            remedies=first.remedies,
        ) from first
    lacked = first.message.partition("\n")[0].partition(";")[0]
    return replace(
        found, warnings=(f"found by complementarity; by enumerate not: {lacked}", *found.warnings)
    )


_METHODS: dict[str, Callable[[Run], Found]] = {
    "auto": _automatic,
    "enumerate": _by_search,
    "complementarity": _by_complementarity,
}


def _warnings(search: Search) -> tuple[str, ...]:
    if not search.tally.truncated:
        return ()
    if search.tally.late:
        return ("the time limit ended the search: there may be more sequences than those listed",)
    most = search.scene.spec.search.most
    return (f"more sequences exist than the {most} listed: search.most asks for more",)
