"""`climbplan.plan` and `climbplan.verify`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.loading import SpecSource, load_spec, override_spec
from climbplan.api.making import PlannedResult, PlanningOptions, run_planner
from climbplan.api.plan import Plan, load_plan
from climbplan.api.plan_group import Folder
from climbplan.api.plan_path import PLAN_FILE
from climbplan.api.progress_display import show_progress
from climbplan.deprecation import renamed_parameters
from climbplan.errors import NoPlanFound, VerificationFailed
from climbplan.progress import Progress
from climbplan.schema.loaded import LoadedSpec

if TYPE_CHECKING:
    from climbplan.verification.verification import Verification


@renamed_parameters(set="overrides", report="progress")
@ctrl_c_insists()
def plan(
    spec: SpecSource | LoadedSpec,
    overrides: Mapping[str, Any] | None = None,
    *,
    method: str | None = None,
    seed: int | None = None,
    time_limit: float | None = None,
    jobs: int = 1,
    progress: Progress | bool | None = None,
) -> Plan:
    """Plan a climb, transition, delivery by modules, walk or bookshelf scene, and verify it.

    Args:
        spec: the result of `climbplan.load_spec`, or anything that it takes.
        overrides: values by dotted key, as with `--set`.
        method: replaces `solver.method`; None keeps the spec's.
        seed: replaces `seed`; None keeps the spec's.
        time_limit: replaces `solver.time_limit` [s]; None keeps the spec's.
        jobs: worker processes of studies and of files of scenes.
        progress: called with the name of a stage and the fraction of it that is done. True shows
            it instead: a bar in notebooks, elsewhere a line every five seconds on standard error.
            False shows nothing, and None a bar in notebooks only.

    Raises:
        SpecError: the spec has mistakes (exit code 2 of the command line).
        Infeasible: the problem is proved to have no plan (3).
        Unresolved: the method found no plan, which proves nothing (4).
        LimitReached: a limit was reached before a plan was found (4).
        VerificationFailed: a plan was found and fails its verification, or its data are
            implausible (5); `.plan` has it. The errors of codes 3 and 4 have `.conflicts` and
            `.remedies`, and as `.partial` the plan of the part of the way that was found, if any.
    """
    options = {"solver.method": method, "seed": seed, "solver.time_limit": time_limit}
    changes = {**(overrides or {}), **{k: v for k, v in options.items() if v is not None}}
    loaded: object  # `make` rejects specs that no plan is made from
    if isinstance(spec, LoadedSpec):
        loaded = override_spec(spec, changes) if changes else spec
    else:
        loaded = load_spec(spec, changes)
    with show_progress(progress) as report:
        outcome = plan_and_verify(loaded, PlanningOptions(report, jobs))
    if outcome.verification.objection:
        failed = VerificationFailed(f"the plan {outcome.verification.objection}")
        failed.plan = outcome.plan
        raise failed
    return outcome.plan


@dataclass(frozen=True)
class VerifiedPlan:
    """A plan with what its verification says, passed or not."""

    plan: Plan
    verification: Verification
    status: str  # "optimal", "feasible", "infeasible", "limit"; of files of scenes all in one
    folder: Path  # of the plan file and of what the planner wrote beside it


def plan_and_verify(loaded: object, options: PlanningOptions) -> VerifiedPlan:
    """Plan a loaded spec and verify the plan from its file, in a folder that goes with the plan.

    Raises:
        SpecError: planning found a mistake in the spec.
        UsageError: no plan is made from specs of this kind.
        NoPlanFound: no plan exists, or none was found; its `partial` is a `Plan` or None.
    """
    try:
        result = run_planner(loaded, options)
    except NoPlanFound as error:
        if isinstance(error.partial, PlannedResult):
            error.partial = _write_and_verify(error.partial).plan
        raise
    return _write_and_verify(result)


def _write_and_verify(result: PlannedResult) -> VerifiedPlan:
    """Write and verify what a planner made."""
    folder = Folder()
    path = folder.path / PLAN_FILE
    result.write(path)
    if result.write_beside is not None:
        result.write_beside(path.parent)
    from climbplan.api.kinds import identify_kind

    verification = identify_kind(path).load_verifier()(path)
    planned = Plan(path, folder)
    planned.summary, planned.warnings = tuple(result.summary), tuple(result.warnings)
    planned.notes = tuple(result.notes)
    return VerifiedPlan(planned, verification, result.status, folder.path)


@renamed_parameters(set="overrides")
def verify(
    plan: Plan | str | Path,
    spec: SpecSource | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Verification:
    """Check every constraint of a plan, file or output directory again, as `Plan.verify`."""
    return (plan if isinstance(plan, Plan) else load_plan(plan)).verify(spec, overrides)
