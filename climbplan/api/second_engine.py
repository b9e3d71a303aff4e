"""A climb's exported files played in a second engine, Drake, which shares no code with planning."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.errors import PlanFileError, UsageError
from climbplan.progress import Progress
from climbplan.store.hdf5_reading import open_store
from climbplan.store.plan_format import read_plan_format

if TYPE_CHECKING:
    from climbplan.simulation.drake.report import ReportedRun
    from climbplan.simulation.drake.settings import Settings

RATE = 100.0  # [Hz] of the exported motion
EXPORTED = "exported"  # directory of the files that are played
_KINDS = ("climbplan/climb", "climbplan/transition")


def simulate_in_drake(
    plan: Path, directory: Path, settings: Settings, urdf: Path | None, report: Progress
) -> ReportedRun:
    """Export a plan into a directory and play the exported files in Drake.

    Args:
        plan: a plan file.
        directory: an existing one, which gets `exported/`.
        settings: what of the world differs from the plan.
        urdf: the robot's file, for meshes; where the robot file names it if None.
        report: told how far the run is.

    Raises:
        MissingSolver: Drake is not installed.
        PlanFileError: the plan is neither a climb nor a transition.
        UsageError: the robot is not from a URDF, or its motion cannot be exported.
    """
    from climbplan.simulation.drake.plant import import_pydrake
    from climbplan.simulation.drake.simulating import read_stored_urdf, simulate_exported

    kind = read_plan_format(plan)
    if kind not in _KINDS:
        raise PlanFileError(
            f"{plan}: holds {kind!r}; --engine drake plays climbs and transitions "
            f"({', '.join(_KINDS)})"
        )
    import_pydrake("common")
    read_stored_urdf(plan)
    _require_toes_that_press(plan)
    exported = directory / EXPORTED
    exported.mkdir()
    export_for_drake(plan, exported, with_regulator=settings.regulate)
    return simulate_exported(
        exported, plan, settings, urdf, lambda done: report("playing in Drake", done)
    )


def plan_name(plan: Path) -> str:
    """Return the name of a plan in a file."""
    with open_store(plan) as file:
        return str(file.attrs.get("name", plan.parent.name))


def _require_toes_that_press(plan: Path) -> None:
    from climbplan.climb.plan.file import read_climb

    robot = read_climb(plan).robot
    if robot.gripper is not None or robot.sole is not None:
        kind = "flat feet" if robot.gripper is None else "grippers"
        raise UsageError(
            f"--engine drake: {robot.name} has {kind}; the second engine plays toes that press on "
            "one point: points and spherical feet"
        )


def export_for_drake(plan: Path, directory: Path, *, with_regulator: bool) -> None:
    """Write what `climbplan export --gains rigid` writes: the motion, and the regulator if asked.

    Raises UsageError for robots whose motion or regulator cannot be exported.
    """
    from climbplan.api.kinds import identify_kind
    from climbplan.climb.exports.regulator_files import write_regulator
    from climbplan.exports.formats import FORMATS, ControllerOptions, adapt_motion

    motion = adapt_motion(
        identify_kind(plan).read_motion(plan), ControllerOptions(rate=RATE, gains="rigid")
    )
    table = FORMATS["csv"]
    table.write(motion, directory / table.name)
    if with_regulator:
        regulator = directory / "regulator"
        regulator.mkdir()
        write_regulator(plan, "rigid", regulator)
