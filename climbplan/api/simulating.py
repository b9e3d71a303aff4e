"""Plans of climbs, transitions, walks and modules replayed in MuJoCo, whatever their kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.errors import PlanFileError, UsageError
from climbplan.progress import Progress
from climbplan.store.plan_format import read_plan_format

if TYPE_CHECKING:
    from climbplan.simulation.report_files import SimulationRecord
    from climbplan.simulation.request import SimulationRequest
    from climbplan.simulation.trials import RandomRun

Simulate = Callable[["SimulationRequest", Progress], tuple["SimulationRecord", list[str]]]
"""Returns the record of a simulation, and lines on its random runs."""


def find_simulator(path: Path) -> Callable[[Path], tuple[str, Simulate]]:
    """Return the function that reads a plan file and gives its name and its simulator.

    Raises PlanFileError for a file that is not a plan, and for kinds without a simulated model.
    """
    kind = read_plan_format(path)
    if kind not in _KINDS:
        raise PlanFileError(
            f"{path}: holds {kind!r}; `simulate` replays climbs, transitions, walks and modules "
            f"({', '.join(_KINDS)}), there is no simulated model for anything else"
        )
    return _KINDS[kind]


def _climb(path: Path) -> tuple[str, Simulate]:
    from climbplan.climb.plan.file import read_climb

    plan = read_climb(path)

    def run(request: SimulationRequest, report: Progress) -> tuple[SimulationRecord, list[str]]:
        from climbplan.climb.simulation.report import build_report
        from climbplan.climb.simulation.risk.estimation import format_risk
        from climbplan.climb.simulation.risk.multilevel_splitting import format_rare_event
        from climbplan.climb.simulation.study import simulate_plan

        _reject_pushes(request)
        record = simulate_plan(plan, request, report)
        lines = [
            f"{record.sweep_key} {point.value:g}: "
            + (point.no_plan or f"{point.fall_share.fallen} of {point.fall_share.runs} runs fall")
            for point in record.points
        ]
        if record.risk is not None:
            lines += format_risk(record.risk, plan.robot.limb_names, plan)
        if record.rare is not None:
            lines += format_rare_event(record.rare)
        return build_report(record), [*lines, *_falls(record.trials)]

    return plan.name, run


def _walk(path: Path) -> tuple[str, Simulate]:
    from climbplan.walking.plan.file import read_walk_plan

    plan = read_walk_plan(path)

    def run(request: SimulationRequest, report: Progress) -> tuple[SimulationRecord, list[str]]:
        if request.rare:
            raise UsageError("--rare: walks have no worlds of an uncertainty")
        if plan.task.legs is not None:
            from climbplan.walking.simulation import whole_body_study

            whole = whole_body_study.simulate_whole_body_plan(plan, request, report)
            return whole_body_study.build_report(whole), _falls(whole.trials)
        from climbplan.walking.simulation.rigid_body_study import build_report, simulate_walk_plan

        record = simulate_walk_plan(plan, request, report)
        return build_report(record), _falls(record.trials)

    return plan.name, run


def _modules(path: Path) -> tuple[str, Simulate]:
    from climbplan.limms.plan.file import read_limms_plan

    plan = read_limms_plan(path)

    def run(request: SimulationRequest, report: Progress) -> tuple[SimulationRecord, list[str]]:
        from climbplan.limms.simulation.study import build_report, simulate_module_plan

        _reject_pushes(request)
        record = simulate_module_plan(plan, request, report)
        return build_report(record), [
            f"{broken.time:.2f} s  {broken.words}" for broken in record.run.broken[1:]
        ]

    return plan.name, run


def _reject_pushes(request: SimulationRequest) -> None:
    if request.pushes:
        raise UsageError("--push: only walks of robots from URDFs are pushed")


def _falls(trials: tuple[RandomRun, ...]) -> list[str]:
    if not trials:
        return []
    return [f"{sum(trial.fallen for trial in trials)} of {len(trials)} runs fall"]


_KINDS = {
    "climbplan/climb": _climb,
    "climbplan/transition": _climb,
    "climbplan/mpc": _walk,
    "climbplan/limms": _modules,
}
