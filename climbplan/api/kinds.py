"""The kinds of plan file, and what reads each; nothing is imported before it is needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, TextIO

from climbplan.errors import PlanFileError, UsageError

if TYPE_CHECKING:
    from climbplan.exports.motion import RobotMotion
    from climbplan.reports.viewer.scene import Scene
    from climbplan.schema.holding import HeldSpec
    from climbplan.verification.verification import Verification


@dataclass(frozen=True)
class PlanKind:
    """The modules that read one kind of plan file."""

    csv_name: str  # of the exported file
    verification: str  # with `verify` and `verify_and_mark`
    report: str  # with `write_report`, `write_values` (of plans) and `report_dict`
    csv: str  # with `export_csv`
    scene_function: str | None  # MODULE:FUNCTION; None for files that have nothing in space
    motion_function: str | None = None  # MODULE:FUNCTION; None for files in which nothing moves

    def verify(self, path: Path, held: HeldSpec | None = None) -> Verification:
        """Re-check every constraint from the file alone; held: against another spec."""
        own = import_module(self.verification).verify
        return own(path) if held is None else own(path, held)

    def verifier(self) -> Callable[[Path], Verification]:
        """As `verify`, and writes the outcome into the file; imported before it is timed."""
        return import_module(self.verification).verify_and_mark

    def write_report(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write page, figures and report.json into a directory.

        verification: of this very file if it was made already.
        """
        import_module(self.report).write_report(path, directory, verification)

    def write_values(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write report.json alone into a directory; arguments as of `write_report`."""
        import_module(self.report).write_values(path, directory, verification)

    def report_dict(self, path: Path) -> dict[str, object]:
        """The report as plain values."""
        return import_module(self.report).report_dict(path)

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        """The plan as CSV."""
        import_module(self.csv).export_csv(path, out)

    def motion(self, path: Path) -> RobotMotion:
        """What robots and other simulators are told; UsageError for files without a motion."""
        if self.motion_function is None:
            raise UsageError(f"{path}: nothing in it moves: --format csv is what there is")
        return resolve_name(self.motion_function)(path)

    def scene(self, path: Path) -> Scene:
        """What `view` shows; UsageError for files that have nothing in space."""
        if self.scene_function is None:
            raise UsageError(
                f"{path}: a dataset; `report` draws its statistics, `view` shows plans"
            )
        return resolve_name(self.scene_function)(path)


_CLIMB = PlanKind(
    csv_name="trajectory.csv",
    verification="climbplan.climb.check.verification",
    report="climbplan.climb.pages.report",
    csv="climbplan.climb.exports.trajectory_csv",
    scene_function="climbplan.climb.pages.scene:climb_scene",
    motion_function="climbplan.climb.exports.motion:climb_motion",
)
KINDS = {
    "climbplan/climb": _CLIMB,
    "climbplan/transition": _CLIMB,
    "climbplan/bookshelf": PlanKind(
        csv_name="placements.csv",
        verification="climbplan.bookshelf.check.verification",
        report="climbplan.bookshelf.pages.report",
        csv="climbplan.bookshelf.exports.placement_csv",
        scene_function="climbplan.bookshelf.pages.scene:shelf_scene",
    ),
    "climbplan/limms": PlanKind(
        csv_name="motion.csv",
        verification="climbplan.limms.check.verification",
        report="climbplan.limms.pages.report",
        csv="climbplan.limms.exports.motion_csv",
        scene_function="climbplan.limms.pages.scene:limms_scene",
        motion_function="climbplan.limms.exports.motion:limms_motion",
    ),
    "climbplan/mpc": PlanKind(
        csv_name="walk.csv",
        verification="climbplan.walking.check.verification",
        report="climbplan.walking.pages.report",
        csv="climbplan.walking.exports.trajectory_csv",
        scene_function="climbplan.walking.pages.scene:walk_scene",
        motion_function="climbplan.walking.exports.motion:walk_motion",
    ),
    "climbplan/dataset": PlanKind(
        csv_name="dataset.csv",
        verification="climbplan.datasets.verification",
        report="climbplan.api.dataset_reading",
        csv="climbplan.api.dataset_reading",
        scene_function=None,
    ),
}


def plan_kind(path: Path) -> PlanKind:
    """What reads the plan file at `path`.

    Raises:
        PlanFileError: it is missing or damaged, or no plan.
    """
    from climbplan.store.plan_format import plan_format

    found = plan_format(path)
    if found == "climbplan/program":
        raise PlanFileError(
            f"{path}: answers of `climbplan solve`, which only `climbplan verify --problem` reads; "
            "report.json is beside them"
        )
    if found not in KINDS:
        known = ", ".join(repr(name) for name in KINDS)
        raise PlanFileError(f"{path}: holds {found!r}, expected one of {known}")
    return KINDS[found]
