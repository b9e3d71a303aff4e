"""The kinds of plan file, and what reads each; nothing is imported before it is needed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TextIO

from climbplan.cli.console import warn
from climbplan.errors import PlanFileError, UsageError

if TYPE_CHECKING:
    from climbplan.plans.verification import Verification
    from climbplan.reports.viewer.scene import Scene


class PlanKind(Protocol):
    """What can be done with one kind of plan file."""

    csv_name: str  # of the exported file

    def verify(self, path: Path) -> Verification:
        """Re-check every constraint from the file alone."""

    def write_report(self, path: Path, directory: Path) -> None:
        """Write page, figures and report.json into a directory."""

    def report_dict(self, path: Path) -> dict[str, object]:
        """The report as plain values."""

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        """The plan as CSV."""

    def scene(self, path: Path) -> Scene:
        """What `view` shows; UsageError for files that have nothing in space."""


class _Climb:
    csv_name = "trajectory.csv"

    def verify(self, path: Path) -> Verification:
        from climbplan.plans.verification import verify

        return verify(path)

    def write_report(self, path: Path, directory: Path) -> None:
        from climbplan.reports.climb_report import write_report

        write_report(path, directory)

    def report_dict(self, path: Path) -> dict[str, object]:
        from climbplan.reports.climb_report import report_dict

        return report_dict(path)

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        from climbplan.plans.trajectory_csv import export_csv

        export_csv(path, out)

    def scene(self, path: Path) -> Scene:
        from climbplan.reports.viewer.climb_scene import climb_scene

        return climb_scene(path)


class _Bookshelf:
    csv_name = "placements.csv"

    def verify(self, path: Path) -> Verification:
        from climbplan.bookshelf.verification import verify

        return verify(path)

    def write_report(self, path: Path, directory: Path) -> None:
        from climbplan.reports.bookshelf_report import write_report

        write_report(path, directory)

    def report_dict(self, path: Path) -> dict[str, object]:
        from climbplan.reports.bookshelf_report import report_dict

        return report_dict(path)

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        from climbplan.bookshelf.placement_csv import export_csv

        export_csv(path, out)

    def scene(self, path: Path) -> Scene:
        from climbplan.reports.viewer.shelf_scene import shelf_scene

        return shelf_scene(path)


class _Walk:
    csv_name = "walk.csv"

    def verify(self, path: Path) -> Verification:
        from climbplan.mpc.verification import verify

        return verify(path)

    def write_report(self, path: Path, directory: Path) -> None:
        from climbplan.reports.walk_report import write_report

        write_report(path, directory)

    def report_dict(self, path: Path) -> dict[str, object]:
        from climbplan.reports.walk_report import report_dict

        return report_dict(path)

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        from climbplan.mpc.trajectory_csv import export_csv

        export_csv(path, out)

    def scene(self, path: Path) -> Scene:
        from climbplan.reports.viewer.walk_scene import walk_scene

        return walk_scene(path)


class _Dataset:
    csv_name = "dataset.csv"

    def verify(self, path: Path) -> Verification:
        from climbplan.datasets.verification import verify

        return verify(path)

    def write_report(self, path: Path, directory: Path) -> None:
        from climbplan.datasets.verification import MEANINGS, verification_of
        from climbplan.plans.dataset_file import read_dataset_file
        from climbplan.reports.dataset_report import write_report

        data = read_dataset_file(path)
        write_report(data, directory, verification_of(data, path), MEANINGS)

    def report_dict(self, path: Path) -> dict[str, object]:
        from climbplan.datasets.verification import verification_of
        from climbplan.plans.dataset_file import read_dataset_file
        from climbplan.reports.dataset_report import report_dict

        data = read_dataset_file(path)
        return report_dict(data, verification_of(data, path))

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        from climbplan.datasets.tables import export_csv
        from climbplan.plans.dataset_file import read_dataset_file

        export_csv(read_dataset_file(path), out)

    def scene(self, path: Path) -> Scene:
        raise UsageError(f"{path}: a dataset; `report` draws its statistics, `view` shows plans")


class _Limms:
    csv_name = "motion.csv"

    def verify(self, path: Path) -> Verification:
        from climbplan.limms.verification import verify

        return verify(path)

    def write_report(self, path: Path, directory: Path) -> None:
        from climbplan.reports.limms_report import write_report

        write_report(path, directory)

    def report_dict(self, path: Path) -> dict[str, object]:
        from climbplan.reports.limms_report import report_dict

        return report_dict(path)

    def export_csv(self, path: Path, out: Path | TextIO) -> None:
        from climbplan.limms.motion_csv import export_csv

        export_csv(path, out)

    def scene(self, path: Path) -> Scene:
        from climbplan.reports.viewer.limms_scene import limms_scene

        return limms_scene(path)


_KINDS: dict[str, PlanKind] = {
    "climbplan/climb": _Climb(),
    "climbplan/transition": _Climb(),
    "climbplan/bookshelf": _Bookshelf(),
    "climbplan/limms": _Limms(),
    "climbplan/mpc": _Walk(),
    "climbplan/dataset": _Dataset(),
}


def plan_kind(path: Path) -> PlanKind:
    """What reads the plan file at `path`.

    Raises:
        PlanFileError: it is missing or damaged, or no plan.
    """
    from climbplan.plans.plan_format import plan_format

    found = plan_format(path)
    if found == "climbplan/program":
        raise PlanFileError(
            f"{path}: answers of `climbplan solve`, which only `climbplan verify --problem` reads; "
            "report.json is beside them"
        )
    if found not in _KINDS:
        known = ", ".join(repr(name) for name in _KINDS)
        raise PlanFileError(f"{path}: holds {found!r}, expected one of {known}")
    return _KINDS[found]


def warn_of_failure(kind: PlanKind, path: Path) -> None:
    """Say that a plan which is to be shown or passed on does not hold.

    Raises:
        UnsoundPlan: its numbers mean nothing, so that nothing can be shown.
    """
    verification = kind.verify(path)
    if not verification.passed:
        verification.require_sound(path)
        warn(f"{path} fails its verification: {verification.headline()}")
