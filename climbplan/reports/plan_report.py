"""How a plan file of any kind becomes report.json, report.html and figures.

What draws is imported when something is to be drawn: numbers alone cost no matplotlib.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from climbplan.reports.report_files import write_files, write_values
from climbplan.verification.verification import Verification

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plan = TypeVar("Plan")


@dataclass(frozen=True)
class FigureOf:
    """A figure of a plan, by the name MODULE:FUNCTION of what draws it."""

    function: str

    def __call__(self, plan: Any, **options: Any) -> Figure:
        """Return the figure drawn; options: of the function."""
        return resolve_name(self.function)(plan, **options)


@dataclass(frozen=True)
class PlanReport(Generic[Plan]):
    """What reports one kind of plan file."""

    read: Callable[[Path], Plan]
    verify: Callable[[Path], Verification]
    values: Callable[[Plan, Verification], dict[str, Any]]  # JSON-ready
    figures: Callable[[Plan], Mapping[str, Callable[[Plan], Figure]]]  # by file name
    page: Callable[[Plan, Mapping[str, Any], Mapping[str, bytes]], str]  # of values and PNG files

    def build_report(self, path: Path) -> dict[str, Any]:
        """Return the report of a plan file as JSON-ready values, with a new verification.

        Args:
            path: Plan file.

        Raises:
            PlanFileError: The file is damaged.
        """
        return self.values(self.read(path), self.verify(path))

    def write_report(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write report.json, report.html and figures/*.png of a plan file into a directory.

        Each file is written aside and renamed.

        Args:
            path: Plan file.
            directory: Directory to write into; it is created if it is missing.
            verification: Verification of this very file; None verifies it.

        Raises:
            PlanFileError: The plan is damaged.
            UsageError: The directory cannot be written to.
        """
        from climbplan.reports.sheet import render_figures

        plan = self.read(path)
        report = self.values(plan, verification or self.verify(path))
        images = render_figures(plan, self.figures(plan))
        write_files(directory, report, self.page(plan, report, images), images)

    def write_values(
        self, path: Path, directory: Path, verification: Verification | None = None
    ) -> None:
        """Write report.json alone: no page, no figures.

        Args:
            path: Plan file.
            directory: Directory that exists.
            verification: Verification of this very file; None verifies it.
        """
        report = self.values(self.read(path), verification or self.verify(path))
        write_values(directory, {**report, "figures": []})
