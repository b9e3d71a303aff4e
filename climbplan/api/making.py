"""Run the planner of a loaded spec, whatever its kind."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.api.mistakes import placed_mistakes
from climbplan.errors import NoPlanFound, UsageError
from climbplan.progress import Progress
from climbplan.schema.loaded import LoadedSpec

if TYPE_CHECKING:
    from climbplan.bookshelf.schema.loading import LoadedShelf
    from climbplan.climb.plan.climb_plan import ClimbPlan
    from climbplan.climb.schema.loading import LoadedClimb
    from climbplan.climb.schema.transition_loading import LoadedTransition
    from climbplan.limms.schema.loading import LoadedLimms
    from climbplan.walking.schema.loading import LoadedMpc

LIBRARY_FILE = "library.h5"


@dataclass(frozen=True)
class PlannedResult:
    """The outcome of a planner, and the functions that write its files."""

    summary: Sequence[str]  # lines about the run
    warnings: Sequence[str]
    status: str  # "optimal", "feasible", "infeasible", "limit"; of files of scenes all in one
    write: Callable[[Path], None]  # the plan file
    write_beside: Callable[[Path], None] | None = None  # further files of the run, into a directory
    notes: Sequence[str] = ()  # what the planner changed on its way; nothing is to be done


@dataclass(frozen=True)
class PlanningOptions:
    """Options of a planner run that are not in the spec.

    Attributes:
        progress: called with the name of a stage and the fraction of it that is done.
        jobs: worker processes of a study or a file of scenes.
        save_model: file that the optimisation problem is written to; None writes none.
        warn: called with warnings while the planner runs.
        seek_remedies: whether changed specs are planned where a climb or a transition has no plan.
    """

    progress: Progress = lambda stage, fraction: None
    jobs: int = 1
    save_model: Path | None = None
    warn: Callable[[str], None] = lambda words: None
    seek_remedies: bool = True


def run_planner(loaded: object, options: PlanningOptions | None = None) -> PlannedResult:
    """Run the planner for the kind of a loaded spec.

    Raises:
        SpecError: planning found a mistake in the spec; it has the line.
        UsageError: no plan is made from specs of this kind.
        NoPlanFound: no plan exists, or none was found; its `partial` is a `PlannedResult` or None.
    """
    spec = getattr(loaded, "spec", None)
    by_kind = _MAKERS.get(getattr(spec, "kind", ""))
    if by_kind is None or not isinstance(loaded, LoadedSpec):
        raise UsageError(
            "plans are made of specs of kind climb, transition, limms, mpc and bookshelf; "
            f"this is a {type(loaded).__name__}"
        )
    with placed_mistakes(loaded):
        return by_kind(loaded, options or PlanningOptions())


def _climb(loaded: LoadedClimb, options: PlanningOptions) -> PlannedResult:
    from climbplan.climb.plan.climb_plan import ClimbPlan
    from climbplan.climb.plan.file import write_climb
    from climbplan.climb.planner.planner import plan_climb

    def plan(climb: LoadedClimb) -> ClimbPlan:
        return plan_climb(
            climb,
            report=options.progress,
            jobs=options.jobs,
            save_model=options.save_model,
            seek_remedies=options.seek_remedies,
        )

    def describe(climb_plan: ClimbPlan) -> PlannedResult:
        return PlannedResult(
            climb_plan.summary,
            climb_plan.warnings,
            climb_plan.status,
            lambda path: write_climb(climb_plan, path),
            notes=climb_plan.notes,
        )

    try:
        if loaded.spec.risk is None:
            return describe(_in_sampled_worlds(plan(loaded), loaded, options))
        from climbplan.climb.simulation.risk.planning import Execution, plan_with_risk

        execution = Execution(options.jobs, options.progress)
        return describe(plan_with_risk(loaded, plan, type(loaded).with_overrides, execution))
    except NoPlanFound as error:
        if isinstance(error.partial, ClimbPlan):
            error.partial = describe(error.partial)
        raise


def _transition(loaded: LoadedTransition, options: PlanningOptions) -> PlannedResult:
    from climbplan.climb.plan.file import write_climb
    from climbplan.climb.transition.planner import plan_transition

    def plan(transition: LoadedTransition) -> ClimbPlan:
        return plan_transition(
            transition, report=options.progress, seek_remedies=options.seek_remedies
        )

    if loaded.spec.risk is None:
        transition_plan = _in_sampled_worlds(plan(loaded), loaded, options)
    else:
        from climbplan.climb.simulation.risk.planning import Execution, plan_with_risk

        transition_plan = plan_with_risk(
            loaded, plan, type(loaded).with_overrides, Execution(options.jobs, options.progress)
        )
    return PlannedResult(
        transition_plan.summary,
        transition_plan.warnings,
        transition_plan.status,
        lambda path: write_climb(transition_plan, path),
        notes=transition_plan.notes,
    )


def _in_sampled_worlds(
    plan: ClimbPlan, loaded: LoadedClimb | LoadedTransition, options: PlanningOptions
) -> ClimbPlan:
    """Add the falls in sampled worlds, if the spec or the robot file states uncertainty."""
    from climbplan.schema.robots.uncertainty import states_uncertainty
    from climbplan.schema.robots.urdf.robot import UrdfRobot

    robot = loaded.robot.spec if isinstance(loaded.robot, UrdfRobot) else loaded.robot
    if not states_uncertainty(loaded.spec.uncertainty, robot.uncertainty):
        return plan
    from climbplan.climb.simulation.risk.sampling import add_world_sample

    start = time.perf_counter()
    sampled = add_world_sample(
        plan, loaded.spec.seed, options.jobs, lambda part: options.progress("worlds", part)
    )
    timings = {**plan.timings, "worlds": time.perf_counter() - start}
    return replace(sampled, timings=timings)


def _limms(loaded: LoadedLimms, options: PlanningOptions) -> PlannedResult:
    from climbplan.limms.plan.file import write_limms_plan
    from climbplan.limms.planner.planner import plan_limms

    modules_plan = plan_limms(loaded, options.progress)
    return PlannedResult(
        modules_plan.summary,
        modules_plan.warnings,
        modules_plan.status,
        lambda path: write_limms_plan(modules_plan, path),
    )


def _walk(loaded: LoadedMpc, options: PlanningOptions) -> PlannedResult:
    from climbplan.walking.plan.file import write_walk_plan

    if loaded.spec.solver.method != "online":
        from climbplan.walking.planner.planner import plan_walk

        walk = plan_walk(loaded, options.progress)
        return PlannedResult(
            walk.summary, walk.warnings, walk.status, lambda path: write_walk_plan(walk, path)
        )
    from climbplan.walking.online.library import write_library
    from climbplan.walking.online.run import run_online

    walked = run_online(loaded, options.progress)
    return PlannedResult(
        walked.plan.summary,
        walked.plan.warnings,
        walked.plan.status,
        lambda path: write_walk_plan(walked.plan, path),
        lambda folder: write_library(walked.library, folder / LIBRARY_FILE, walked.key),
    )


def _shelf(loaded: LoadedShelf, options: PlanningOptions) -> PlannedResult:
    from climbplan.bookshelf.plan.file import write_shelf_plan
    from climbplan.bookshelf.planner.runs import run_shelf

    shelf_run = run_shelf(loaded, options.progress, options.jobs, options.warn, options.save_model)
    return PlannedResult(
        shelf_run.summary,
        (),
        shelf_run.totals.status,
        lambda path: write_shelf_plan(shelf_run, path),
    )


_MAKERS: dict[str, Callable[..., PlannedResult]] = {
    "climb": _climb,
    "transition": _transition,
    "limms": _limms,
    "mpc": _walk,
    "bookshelf": _shelf,
}
