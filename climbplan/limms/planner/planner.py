"""From a spec to a plan. Method `modes`: mode sequences best first, then programs, then the way.

Fully automatic: which modules latch where follows from the search, keyframes and motions from the
programs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.errors import Infeasible, LimitReached
from climbplan.limms.attempts.attempts import Attempts
from climbplan.limms.check.verification import verification_of
from climbplan.limms.consensus.planner import plan_by_consensus
from climbplan.limms.courses.courses import courses, relays
from climbplan.limms.courses.direct import Search, legs_misfit, search
from climbplan.limms.courses.refusal import proof, ruled_out
from climbplan.limms.modules.weights import PACES, too_heavy
from climbplan.limms.motion.assembly import initial
from climbplan.limms.motion.moving import Blocked
from climbplan.limms.motion.plan_making import Making, cut_short_warning, make_plan
from climbplan.limms.motion.timeline import PlanSoFar
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.plan.summary import summary_lines
from climbplan.limms.planner.motions import Motions
from climbplan.limms.scene.limms_scene import (
    Scene,
    scene_of,
    stands_at_goal,
    with_box_first,
    without_others,
)
from climbplan.limms.schema.loading import LoadedLimms
from climbplan.progress import Progress

METHOD = "modes"
SOLVERS = {"programs": "IPOPT (CasADi)"}


def plan_limms(loaded: LoadedLimms, report: Progress = lambda stage, share: None) -> LimmsPlan:
    """The plan of a LIMMS spec.

    Raises:
        Infeasible: bounds that no plan escapes rule every mode sequence out.
        LimitReached: none of the sequences led to a plan, or not in time.
    """
    scene = scene_of(loaded)
    if heavy := too_heavy(scene):
        raise Infeasible("no plan exists: modules are too heavy", heavy, stage="modes")
    if loaded.spec.solver.method == "admm":
        return plan_by_consensus(loaded, report)
    solver = loaded.spec.solver
    attempts = Attempts(solver.time_limit, solver.programs)
    if scene.massless:
        return _plan_at_pace(loaded, scene, report, attempts)[0]
    return _calmest(loaded, scene, report, attempts)


def _calmest(loaded: LoadedLimms, scene: Scene, report: Progress, attempts: Attempts) -> LimmsPlan:
    """With masses: ways without the box slower and slower, until all that they ask for is held.

    Arms carry the box as they do at any pace, so that where legs take no part the first pace says
    what can be found. Legs swing slower at calmer ones, so that with them each pace but the last
    gets half of what is left of the budget.

    Raises as `plan_limms`; a plan that fails at every pace is the last one.
    """
    plan: LimmsPlan | None = None
    whole, has_legs = attempts.most, "quadruped" in scene.allow and not legs_misfit(scene)
    for pace in PACES:
        is_last = pace == PACES[-1]
        attempts.most = whole - (attempts.left_of(whole) // 2 if has_legs and not is_last else 0)
        try:
            plan, passed = _plan_at_pace(loaded, replace(scene, pace=pace), report, attempts)
        except LimitReached:
            if attempts.over or attempts.left_of(whole) <= 0 or is_last or not has_legs:
                if plan is None:
                    raise
                break  # the plan of before is written, and marked as failing
        else:
            if passed:
                return plan
    assert plan is not None
    return _cut_short(plan, attempts) if attempts.over else plan


def _cut_short(plan: LimmsPlan, attempts: Attempts) -> LimmsPlan:
    """A plan that time ran out to better."""
    if plan.status == "limit":
        return plan
    warnings = (cut_short_warning(attempts.limit), *plan.warnings)
    return replace(plan, status="limit", warnings=warnings)


def _plan_at_pace(
    loaded: LoadedLimms, scene: Scene, report: Progress, attempts: Attempts
) -> tuple[LimmsPlan, bool]:
    """The plan of a scene within what is left, and whether it passes. Raises as `plan_limms`."""
    began = time.perf_counter()
    report("modes", 0.0)
    found = _possible(scene)
    searched = time.perf_counter() - began
    tried, named = 0, ""

    def made(world: PlanSoFar) -> LimmsPlan:
        seconds = {"search": searched, "total": time.perf_counter() - began}
        sizes = {
            "configurations": found.configurations,
            "sequences": max(len(found.actions), tried),
            "sequences_tried": tried,
        }
        making = Making(METHOD, named, seconds, sizes, dict(SOLVERS))
        plan = make_plan(loaded, scene, world, attempts, making)
        return replace(plan, summary=summary_lines(plan, attempts.notes))

    start = initial(scene)
    rng = np.random.default_rng(loaded.spec.seed)
    judge = _Judge(made)
    motions = Motions(start, attempts, rng, loaded.spec.solver.most_steps, judge)
    listed = courses(start, found.actions) if scene.deliveries == 1 else relays(start, 1)
    try:
        for number, course in enumerate(listed):
            report("plan", number / max(len(found.actions), number + 1))
            tried, named, told = number + 1, course.named(scene), len(attempts.notes)
            attempts.begin(named)
            world = motions.plan(course)
            if world is not None:
                return made(world), judge.passed
            if len(attempts.notes) == told:
                attempts.notes.append(f"{named}: no module can take its part")
        attempts.left()
    except LimitReached:
        if judge.refused is None:
            raise
    if judge.refused is not None:  # better than none: it is written, and marked as failing
        return judge.refused, False
    if not tried:
        raise ruled_out(scene, found.conflicts)
    raise LimitReached(
        f"none of {tried} sequences of modes led to a plan, and none was proved "
        f"impossible. {attempts.story()}",
        stage="motion",
    )


def _possible(scene: Scene) -> Search:
    """What may bring the only box to its goal at once; of several boxes there is no such list.

    Raises:
        Infeasible: it is proved that a box cannot be brought to its goal, were it the only one.
            Other boxes may be anywhere by then, so that what their places rule out is no proof.
    """
    if scene.deliveries == 1:
        found = search(scene)
        if proved := proof(scene, found.conflicts):
            raise proved
        return found
    places = np.column_stack([scene.box_start, scene.start_yaws])
    goals = np.column_stack([scene.goals, scene.goal_yaws])
    each: list[Search] = []
    for box in range(scene.deliveries):
        is_last = box == scene.deliveries - 1
        speed = scene.arrival_speed if is_last else 0.0
        alone = without_others(with_box_first(scene, box, places, goals[box], speed))
        each.append(search(alone))
        proved = proof(alone, each[-1].conflicts)
        if proved is not None and not stands_at_goal(scene, box):
            raise Infeasible(
                f"box {box}, were it the only one: {proved}", proved.conflicts, stage="modes"
            )
    conflicts = tuple(conflict for found in each for conflict in found.conflicts)
    return Search((), conflicts, sum(found.configurations for found in each))


class _Judge:
    """Plans are verified where they end; one that fails is kept, and the search goes on.

    What is too much for the hardware is for slower ways first, as long as there are any.
    """

    def __init__(self, made: Callable[[PlanSoFar], LimmsPlan]) -> None:
        self.made = made
        self.passed = False  # whether the plan of the last world passes as it is
        self.refused: LimmsPlan | None = None  # the first that failed

    def __call__(self, world: PlanSoFar) -> PlanSoFar:
        plan = self.made(world)
        verification = verification_of(plan)
        self.passed = verification.passed
        failed = [check.name for check in verification.failed]
        if not plan.massless and world.scene.pace > min(PACES):
            failed = [name for name in failed if not name.startswith("load.")]
        if not failed:
            return world
        self.refused = self.refused or plan
        raise Blocked(verification.headline())
