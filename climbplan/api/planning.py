"""`climbplan.plan` and `climbplan.verify`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.loading import SpecSource, changed, load
from climbplan.api.making import MakingOptions, make
from climbplan.api.plan import Folder, Plan, read
from climbplan.api.plan_path import PLAN_FILE
from climbplan.errors import PlanFails
from climbplan.progress import Progress
from climbplan.schema.loaded import LoadedSpec

if TYPE_CHECKING:
    from climbplan.verification.verification import Verification


@ctrl_c_insists()
def plan(
    spec: SpecSource | LoadedSpec,
    set: Mapping[str, Any] | None = None,
    *,
    method: str | None = None,
    seed: int | None = None,
    time_limit: float | None = None,
    jobs: int = 1,
    report: Progress | None = None,
) -> Plan:
    """Plan a climb, transition, delivery by modules, walk or bookshelf scene, and verify it.

    spec: what `climbplan.load` returned, or what it takes. set, method, seed, time_limit [s]: as
    the options of the command line. jobs: worker processes of studies and files of scenes. report:
    called with stage and share that is done.

    Raises what the command line turns into exit codes: SpecError (2), Infeasible (3), NotProved
    and LimitReached (4), each with `.conflicts` and `.remedies`, and PlanFails (5) for a
    plan that fails its verification or whose data are implausible, with the plan as `.plan`.
    """
    options = {"solver.method": method, "seed": seed, "solver.time_limit": time_limit}
    changes = {**(set or {}), **{k: v for k, v in options.items() if v is not None}}
    loaded: object  # `make` refuses what is no plan's
    if isinstance(spec, LoadedSpec):
        loaded = changed(spec, changes) if changes else spec
    else:
        loaded = load(spec, changes)
    made = make(loaded, MakingOptions(report or (lambda stage, fraction: None), jobs))
    folder = Folder()
    path = folder.path / PLAN_FILE
    made.write(path)
    if made.write_beside is not None:
        made.write_beside(path.parent)
    from climbplan.api.kinds import plan_kind

    verification = plan_kind(path).verifier()(path)
    found = Plan(path, folder)
    found.summary, found.warnings = tuple(made.summary), tuple(made.warnings)
    if verification.objection:
        failed = PlanFails(f"the plan {verification.objection}")
        failed.plan = found
        raise failed
    return found


def verify(
    plan: Plan | str | Path,
    spec: SpecSource | None = None,
    set: Mapping[str, Any] | None = None,
) -> Verification:
    """Every constraint of a plan checked again; as `Plan.verify`, of a file or directory too."""
    return (plan if isinstance(plan, Plan) else read(plan)).verify(spec, set)
