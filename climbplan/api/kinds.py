"""The kinds of plan files and the modules that read them, imported when first used."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

from climbplan.errors import PlanFileError, UsageError

if TYPE_CHECKING:
    from climbplan.exports.motion import RobotMotion
    from climbplan.motions.tracked_motion import TrackedMotion
    from climbplan.reports.viewer.scene import ViewerScene
    from climbplan.schema.holding import HeldSpec
    from climbplan.verification.verification import Verification


@dataclass(frozen=True)
class PlanKind:
    """One kind of plan file; the modules that read it have the same names in every family."""

    family: str  # its folder
    csv_name: str  # of the exported file
    is_in_space: bool = True  # whether there is something to look at
    moves: bool = True  # whether there is a motion to export
    has_links: bool = True  # whether it moves one robot with limbs, which trackers follow

    def _module(self, name: str) -> Any:
        return import_module(f"climbplan.{self.family}.{name}")

    def verify(self, path: Path, user_spec: HeldSpec | None = None) -> Verification:
        """Check every constraint again from the file alone, or against the user's own spec."""
        check_plan = self._module("check.verification").verify
        verification: Verification = (
            check_plan(path) if user_spec is None else check_plan(path, user_spec)
        )
        return verification

    def load_verifier(self) -> Callable[[Path], Verification]:
        """Return the function that verifies a file and writes the outcome into it.

        The modules are imported here, so that callers can time the verification alone.
        """
        mark: Callable[[Path], Verification] = self._module("check.verification").verify_and_mark
        return mark

    def write_report(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write page, figures and report.json into a directory.

        Args:
            path: the plan file.
            directory: an existing directory.
            verification: the outcome for this file; None verifies it again.
        """
        self._module("pages.report").write_report(path, directory, verification)

    def write_values(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write report.json alone into a directory; None as `verification` verifies again."""
        self._module("pages.report").write_values(path, directory, verification)

    def build_report(self, path: Path) -> dict[str, object]:
        """Return the contents of report.json."""
        values: dict[str, object] = self._module("pages.report").build_report(path)
        return values

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        """Write the plan as CSV."""
        self._module("exports.table").export_csv(path, out)

    def read_motion(self, path: Path) -> RobotMotion:
        """Read the motion for robots and other simulators; raises UsageError without motion."""
        if not self.moves:
            raise UsageError(f"{path}: it holds no motion; expected --format csv")
        motion: RobotMotion = self._module("exports.motion").read_motion(path)
        return motion

    def read_tracked_motion(
        self, path: Path, rate: float | None, pace: float | Literal["fastest"] = 1.0
    ) -> TrackedMotion:
        """Read the motion for motion-tracking pipelines.

        Args:
            path: The plan file.
            rate: Sample rate [Hz]; None takes 50 Hz.
            pace: Factor on the planned speed of climbs, or the fastest by inverse dynamics.

        Raises:
            UsageError: The plan has no links and joints, or not this pace.
        """
        if not (self.moves and self.has_links):
            raise UsageError(
                f"{path}: expected a climb, transition or walk, whose robot has one body; "
                "--format motion writes no other plans"
            )
        if pace != 1.0:
            if self.family != "climb":
                raise UsageError(
                    f"{path}: --pace is of climbs and transitions, whose plans are quasi-static"
                )
            factor = None if pace == "fastest" else pace
            paced: TrackedMotion = self._module("exports.paced_motion").read_paced_motion(
                path, rate, factor
            )
            return paced
        module = self._module("exports.tracked_motion")
        motion: TrackedMotion = module.read_tracked_motion(path, rate)
        return motion

    def read_scene(self, path: Path) -> ViewerScene:
        """Read the scene that `view` shows; raises UsageError for files without geometry."""
        if not self.is_in_space:
            raise UsageError(
                f"{path}: expected a plan, got a dataset; `climbplan report` shows its statistics"
            )
        scene: ViewerScene = self._module("pages.scene").read_scene(path)
        return scene


KINDS = {
    "climbplan/climb": PlanKind("climb", "trajectory.csv"),
    "climbplan/transition": PlanKind("climb", "trajectory.csv"),
    "climbplan/bookshelf": PlanKind("bookshelf", "placements.csv", moves=False),
    "climbplan/limms": PlanKind("limms", "motion.csv", has_links=False),
    "climbplan/mpc": PlanKind("walking", "walk.csv"),
    "climbplan/dataset": PlanKind("datasets", "dataset.csv", is_in_space=False, moves=False),
}


def identify_kind(path: Path) -> PlanKind:
    """Return the kind of the plan file at `path`.

    Raises:
        PlanFileError: the file is missing, damaged or not a plan.
    """
    from climbplan.store.plan_format import read_plan_format

    format_name = read_plan_format(path)
    if format_name == "climbplan/program":
        raise PlanFileError(
            f"{path}: answers of `climbplan solve`, which only `climbplan verify --problem` reads; "
            "report.json is beside them"
        )
    if format_name not in KINDS:
        names = ", ".join(repr(name) for name in KINDS)
        raise PlanFileError(f"{path}: holds {format_name!r}, expected one of {names}")
    return KINDS[format_name]
