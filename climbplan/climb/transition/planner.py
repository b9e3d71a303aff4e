"""The transition planner: sequences, balanced poses, and the motion that holds (chapter 5.3)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.gait.balance import balancing_shifts
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.plan.climb_plan import (
    ClimbPlan,
    Sequences,
)
from climbplan.climb.scene.climb_scene import on_scan
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.climb.transition.carrying import (
    Complete,
    Found,
    Run,
    assemble,
    carry_through,
    transition_cost,
)
from climbplan.climb.transition.footholds import Poses
from climbplan.climb.transition.homotopy import run_start
from climbplan.climb.transition.mission import climb_after
from climbplan.climb.transition.pose_ways import Sequence
from climbplan.climb.transition.refusal import OutOfReach, no_sequence
from climbplan.climb.transition.remedies import with_remedies
from climbplan.climb.transition.scene import TransitionScene, build_transition
from climbplan.climb.transition.search import Search
from climbplan.climb.transition.stances import Laboratory, stance_instants
from climbplan.errors import Infeasible, NoPlanFound, NotProved, UsageError
from climbplan.progress import Progress

_MOST = 800  # cone programs, of a millisecond each
_SAME = 1e-3  # [m] between poses that are looked at


def balanced_poses(scene: TransitionScene, deadline: float) -> Poses:
    """Poses that balance the stance sets of all sequences within reach, beside the straight way.

    A robot of many limbs braces: where its body is matters little. A quadruped stands on three
    legs, and has to have its body where these hold it: for each stance set, at heights along the
    way, the least level shift that balances it is a cone program.
    """
    kinematic = Search(scene, forces=False, deadline=deadline)
    kinematic.sequences()
    share = np.linspace(0.0, 1.0, scene.spec.search.heights)
    start, goal = scene.start, scene.goal
    way = Poses(
        start.com + share[:, None] * (goal.com - start.com),
        start.rpy + share[:, None] * (goal.rpy - start.rpy),
    )
    pairs = list(itertools.product(kinematic.stances(), range(way.count)))[:_MOST]
    if not pairs:
        return Poses(np.zeros((0, 3)), np.zeros((0, 3)))
    stance: IntArray = np.array([own for own, _ in pairs], np.int64)
    number: IntArray = np.array([k for _, k in pairs], np.int64)
    lifts = stance_instants(kinematic.lab.at(way), stance, number)
    # The search's friction pyramids are inscribed in the cones of the balance
    narrower = float(np.cos(np.pi / scene.spec.force.facets))
    most = scene.spec.posture.steps.com_max
    com = way.com[number] + balancing_shifts(scene, lifts, most, narrower, follow=False)
    rows: dict[tuple[int, ...], int] = {}
    for row, place in enumerate(np.rint(com / _SAME).astype(int).tolist()):
        rows.setdefault(tuple(place), row)
    kept = sorted(rows.values())
    return Poses(com[kept], way.rpy[number[kept]])


_FOR_SEARCH = 0.6  # share of the time limit that `auto` gives to the search
_FOR_PLANS = 0.8  # share that it uses for plans of the spec as it is; the rest is for remedies


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
