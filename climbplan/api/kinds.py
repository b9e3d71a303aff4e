"""The kinds of plan file, and what reads each; nothing is imported before it is needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from climbplan.errors import PlanFileError, UsageError

if TYPE_CHECKING:
    from climbplan.exports.motion import RobotMotion
    from climbplan.reports.viewer.scene import Scene
    from climbplan.schema.holding import HeldSpec
    from climbplan.verification.verification import Verification


@dataclass(frozen=True)
class PlanKind:
    """One kind of plan file, and the family whose modules read it, by the same names in each."""

    family: str  # its folder
    csv_name: str  # of the exported file
    is_in_space: bool = True  # whether there is something to look at
    moves: bool = True  # whether there is a motion to export

    def _module(self, name: str) -> Any:
        return import_module(f"climbplan.{self.family}.{name}")

    def verify(self, path: Path, held: HeldSpec | None = None) -> Verification:
        """Re-check every constraint from the file alone; held: against another spec."""
        own = self._module("check.verification").verify
        verification: Verification = own(path) if held is None else own(path, held)
        return verification

    def verifier(self) -> Callable[[Path], Verification]:
        """As `verify`, and writes the outcome into the file; imported before it is timed."""
        mark: Callable[[Path], Verification] = self._module("check.verification").verify_and_mark
        return mark

    def write_report(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write page, figures and report.json into a directory.

        verification: of this very file if it was made already.
        """
        self._module("pages.report").write_report(path, directory, verification)

    def write_values(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write report.json alone into a directory; arguments as of `write_report`."""
        self._module("pages.report").write_values(path, directory, verification)

    def report_dict(self, path: Path) -> dict[str, object]:
        """The report as plain values."""
        values: dict[str, object] = self._module("pages.report").report_dict(path)
        return values

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        """The plan as CSV."""
        self._module("exports.table").export_csv(path, out)

    def motion(self, path: Path) -> RobotMotion:
        """What robots and other simulators are told; UsageError for files without a motion."""
        if not self.moves:
            raise UsageError(f"{path}: nothing in it moves: --format csv is what there is")
        motion: RobotMotion = self._module("exports.motion").read_motion(path)
        return motion

    def scene(self, path: Path) -> Scene:
        """What `view` shows; UsageError for files that have nothing in space."""
        if not self.is_in_space:
            raise UsageError(
                f"{path}: a dataset; `report` draws its statistics, `view` shows plans"
            )
        scene: Scene = self._module("pages.scene").read_scene(path)
        return scene


KINDS = {
    "climbplan/climb": PlanKind("climb", "trajectory.csv"),
    "climbplan/transition": PlanKind("climb", "trajectory.csv"),
    "climbplan/bookshelf": PlanKind("bookshelf", "placements.csv", moves=False),
    "climbplan/limms": PlanKind("limms", "motion.csv"),
    "climbplan/mpc": PlanKind("walking", "walk.csv"),
    "climbplan/dataset": PlanKind("datasets", "dataset.csv", is_in_space=False, moves=False),
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
