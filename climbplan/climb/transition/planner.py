"""The transition planner: contact sequences, balanced poses and a verified motion (ch. 5.3)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.arrays import IntArray
from climbplan.climb.gait.balance import find_balancing_shifts
from climbplan.climb.motion.motion import StageClock
from climbplan.climb.plan.climb_plan import (
    ClimbPlan,
    Sequences,
)
from climbplan.climb.scene.climb_scene import apply_scan
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.climb.transition.following_climb import plan_following_climb
from climbplan.climb.transition.footholds import CandidateBodyPoses
from climbplan.climb.transition.homotopy import run_from_start
from climbplan.climb.transition.infeasibility_report import OutOfReach, explain_no_sequence
from climbplan.climb.transition.pose_paths import ContactSequence
from climbplan.climb.transition.remedies import find_remedies
from climbplan.climb.transition.scene import TransitionScene, build_transition
from climbplan.climb.transition.search import SequenceSearch
from climbplan.climb.transition.sequence_planning import (
    MARGIN_FRACTIONS,
    CompleteMotion,
    TransitionResult,
    TransitionRun,
    assemble_plan,
    compute_cost,
    plan_and_verify_sequence,
)
from climbplan.climb.transition.stance_forces import SearchTables, build_stance_instants
from climbplan.errors import Infeasible, NoPlanFound, Unresolved, UsageError
from climbplan.progress import Progress

_MAX_BALANCE_PROGRAMS = 800  # cone programs
_POSE_TOLERANCE = 1e-3  # [m] between poses that differ


def find_balanced_poses(scene: TransitionScene, deadline: float) -> CandidateBodyPoses:
    """Find poses off the straight path that balance the stance sets of all reachable sequences.

    A robot with many limbs braces, so the place of its body matters little. A quadruped on three
    legs has to shift its body: for each stance set, at heights along the path, a cone program finds
    the smallest level shift that balances it.

    Args:
        scene: The scene.
        deadline: Time limit in `time.monotonic` seconds.
    """
    kinematic = SequenceSearch(scene, forces=False, deadline=deadline)
    kinematic.list_sequences()
    fraction = np.linspace(0.0, 1.0, scene.spec.search.heights)
    start, goal = scene.start, scene.goal
    straight_path = CandidateBodyPoses(
        start.com + fraction[:, None] * (goal.com - start.com),
        start.rpy + fraction[:, None] * (goal.rpy - start.rpy),
    )
    pairs = list(itertools.product(kinematic.list_stances(), range(straight_path.count)))[
        :_MAX_BALANCE_PROGRAMS
    ]
    if not pairs:
        return CandidateBodyPoses(np.zeros((0, 3)), np.zeros((0, 3)))
    stance: IntArray = np.array([stance_set for stance_set, _ in pairs], np.int64)
    pose_index: IntArray = np.array([k for _, k in pairs], np.int64)
    lifts = build_stance_instants(kinematic.tables.with_poses(straight_path), stance, pose_index)
    # The search's friction pyramids are inscribed in the cones of the balance
    cone_scale = float(np.cos(np.pi / scene.spec.force.facets))
    max_shift = scene.spec.posture.steps.com_max
    com = straight_path.com[pose_index] + find_balancing_shifts(
        scene, lifts, max_shift, cone_scale, allow_sequence=False
    )
    rows: dict[tuple[int, ...], int] = {}
    for row, cell in enumerate(np.rint(com / _POSE_TOLERANCE).astype(int).tolist()):
        rows.setdefault(tuple(cell), row)
    selected = sorted(rows.values())
    return CandidateBodyPoses(com[selected], straight_path.rpy[pose_index[selected]])


_SEARCH_TIME_FRACTION = 0.6  # of the time limit, that `auto` gives to the search
_PLANNING_TIME_FRACTION = 0.8  # for plans of the spec as it is; the rest is for remedies


def plan_transition(
    loaded: LoadedTransition,
    report: Progress | None = None,
    margin_fractions: tuple[float, ...] = MARGIN_FRACTIONS,
    *,
    seek_remedies: bool = True,
) -> ClimbPlan:
    """Plan a transition for a loaded spec; the plan has passed its verification.

    Args:
        loaded: The spec.
        report: Called with a stage and the fraction that is done.
        margin_fractions: Fractions of the margins that the motion of a sequence is planned with,
            in turn until there is one.
        seek_remedies: Whether method `auto` plans changed specs where it finds no plan, to name
            changes with which there is one.

    Raises:
        Unresolved: No sequence exists on the poses searched; the message names slipping contacts.
        LimitReached: The time limit was reached before any sequence was found.
    """
    clock = StageClock(report or (lambda stage, fraction: None))
    begin = time.monotonic()
    loaded = apply_scan(loaded)
    options = loaded.spec.solver
    try:
        scene = build_transition(loaded)
        tail = plan_following_climb(loaded, scene, clock)
        run = TransitionRun(loaded, scene, clock, tail, margin_fractions)
        return assemble_plan(run, _METHODS[options.method](run))
    except NoPlanFound as error:
        if options.method != "auto" or isinstance(error, Infeasible) or not seek_remedies:
            raise
        failure = find_remedies(loaded, error, plan_transition, begin + options.time_limit)
        raise failure from error


def search_sequences(
    scene: TransitionScene, deadline: float
) -> tuple[SequenceSearch, list[ContactSequence]]:
    """Search sequences on the grid of poses; if there are none, also on poses that balance stances.

    Raises:
        Unresolved: There are no sequences.
    """
    search = SequenceSearch(scene, deadline=deadline)
    sequences = search.list_sequences()
    if not sequences:
        extra_poses = find_balanced_poses(scene, deadline)
        search = SequenceSearch(scene, deadline=deadline, extra_poses=extra_poses)
        sequences = search.list_sequences()
    if not sequences:
        raise explain_no_sequence(scene, deadline, search.extra_poses)
    return search, sequences


def _plan_by_search(run: TransitionRun, time_fraction: float = 1.0) -> TransitionResult:
    """Enumerate sequences and plan the best one whose motion passes its verification."""
    scene, clock = run.scene, run.clock
    with clock.stage("search"):
        deadline = time.monotonic() + time_fraction * scene.spec.solver.time_limit
        search, candidates = search_sequences(scene, deadline)
    outcomes = [""] * len(candidates)
    motion: CompleteMotion | None = None
    iterations = num_tried = 0
    for sequence in candidates[: scene.spec.search.max_planned]:
        if time.monotonic() > deadline:
            outcomes[num_tried] = "time limit"
            break
        attempt = plan_and_verify_sequence(run, search.tables, sequence)
        iterations += attempt.iterations
        outcomes[num_tried] = attempt.reason or "chosen"
        num_tried += 1
        if attempt.motion is not None:
            motion = attempt.motion
            break
    if motion is None:
        failures = [
            f"{search.format_name(s)}: {o}" for s, o in zip(candidates, outcomes, strict=True) if o
        ]
        raise Unresolved(
            "\n".join(["no sequence could be planned to the end", *failures[:5]]),
            because="the motion of a sequence is found by a local method, for the sequences tried",
            stage="motion",
        )
    sizes = {
        "search": {
            "sequences": len(candidates),
            "stance sets": search.statistics.stances,
            "force problems": search.statistics.problems,
            "poses": search.tables.poses.count,
        },
        "motion": {"iterations": iterations, "tried": num_tried},
    }
    sequences = Sequences(
        name=tuple(search.format_name(s) for s in candidates),
        cost=np.array([s.cost for s in candidates]),
        safety_torque=np.array([s.safety_torque for s in candidates]),
        safety_friction=np.array([s.safety_friction for s in candidates]),
        outcome=tuple(outcomes),
    )
    return TransitionResult(motion, sizes, sequences, _list_warnings(search))


def _plan_by_complementarity(run: TransitionRun, seconds: float | None = None) -> TransitionResult:
    """Plan from random starts by complementarity and select the cheapest verified motion."""
    scene, clock = run.scene, run.clock
    if scene.spec.task.sequence is not None:
        raise UsageError(
            "method mpcc finds a sequence of its own: leave `task.sequence` out, or use "
            "--method stance-search"
        )
    options = scene.spec.solver
    deadline = time.monotonic() + (options.time_limit if seconds is None else seconds)
    motions: list[CompleteMotion] = []
    reasons: list[str] = []
    iterations = 0

    def try_sequence(tables: SearchTables, sequence: ContactSequence) -> str:
        attempt = plan_and_verify_sequence(run, tables, sequence)
        if attempt.motion is not None:
            motions.append(attempt.motion)
        return attempt.reason

    for number in range(options.starts):
        if time.monotonic() > deadline:
            reasons.append("time limit")
            break
        with clock.stage("homotopy"):
            start = run_from_start(scene, scene.spec.seed + number, try_sequence, deadline)
        iterations += start.iterations
        reasons += [start.reason] if start.reason else []
    if not motions:
        raise Unresolved(
            "\n".join(["no start of method mpcc led to a plan", *reasons[:5]]),
            because="method mpcc is local",
            stage="homotopy",
        )
    best = min(motions, key=lambda done: compute_cost(scene, done.rounds, done.forces))
    return TransitionResult(
        best, {"homotopy": {"iterations": iterations, "starts that hold": len(motions)}}
    )


def _plan_automatically(run: TransitionRun) -> TransitionResult:
    """Plan by search; if that fails, by the complementarity program, which finds its sequence."""
    began = time.monotonic()
    try:
        return _plan_by_search(run, _SEARCH_TIME_FRACTION)
    except NoPlanFound as error:
        elapsed = time.monotonic() - began
        task = run.scene.spec.task
        remaining = _PLANNING_TIME_FRACTION * run.scene.spec.solver.time_limit - elapsed
        if task.sequence is not None or remaining <= 0 or isinstance(error, OutOfReach):
            raise
        first, seconds = error, elapsed
    try:
        result = _plan_by_complementarity(run, remaining)
    except NoPlanFound as error:
        missing = error.message.partition("\n")[0]
        raise Unresolved(
            f"{first.message}\ntried: stance-search ({seconds:.1f} s), mpcc "
            f"({time.monotonic() - began - elapsed:.1f} s): {missing}",
            first.conflicts,
            because=first.because if isinstance(first, Unresolved) else "a limit was reached",
            stage=first.stage,
            remedies=first.remedies,
        ) from first
    missing = first.message.partition("\n")[0].partition(";")[0]
    return replace(
        result,
        notes=(f"found by mpcc; by stance-search not: {missing}", *result.notes),
    )


_METHODS: dict[str, Callable[[TransitionRun], TransitionResult]] = {
    "auto": _plan_automatically,
    "stance-search": _plan_by_search,
    "mpcc": _plan_by_complementarity,
}


def _list_warnings(search: SequenceSearch) -> tuple[str, ...]:
    if not search.statistics.truncated:
        return ()
    if search.statistics.timed_out:
        return ("the time limit ended the search: there may be more sequences than those listed",)
    max_sequences = search.scene.spec.search.max_sequences
    return (
        f"more sequences exist than the {max_sequences} listed: search.max_sequences asks for more",
    )
