"""What all plan commands share: the output directory, and how a run ends."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.api.kinds import identify_kind
from climbplan.api.plan_path import PLAN_FILE
from climbplan.cli.console import Invocation, print_json, print_result, warn
from climbplan.cli.output_directory import PARTIAL_PLAN, OutputDirectory
from climbplan.cli.progress import StageProgress
from climbplan.cli.verify_line import (
    format_level,
    format_omissions,
    format_verification,
    warn_of_implausible,
)
from climbplan.errors import NoPlanFound, VerificationFailed

if TYPE_CHECKING:
    from climbplan.api.making import PlannedResult
    from climbplan.schema.loaded import LoadedSpec


REPORT = "report.json"


@dataclass
class PlanRun:
    """A planner run whose files are in a hidden directory until they are complete."""

    session: Invocation
    target: Path  # where they appear
    output: OutputDirectory  # where they are written
    report: Callable[[str, float], None]  # progress: stage, share that is done
    with_figures: bool  # whether page and figures are wanted
    _failure: str = field(default="", init=False)  # why the plan must not be used

    def make(
        self, loaded: LoadedSpec, jobs: int = 1, save_model: Path | None = None
    ) -> PlannedResult:
        """Run the planner of a spec, write and verify the plan, and print what it reports."""
        # Planners and solvers take a second to import: not before all paths are known to be good
        from climbplan.api.making import PlannedResult, PlanningOptions, run_planner

        try:
            result = run_planner(loaded, PlanningOptions(self.report, jobs, save_model, warn))
        except NoPlanFound as error:
            if isinstance(error.partial, PlannedResult):
                error.partial = self._write_partial(error.partial)
            raise
        self._finish(result)
        return result

    def _write_partial(self, result: PlannedResult) -> Path:
        """Write and verify the plan of a part of the way; return its path."""
        plan_file = self.output.path / PARTIAL_PLAN
        result.write(plan_file)
        verification = identify_kind(plan_file).load_verifier()(plan_file)
        path = self.output.publish_beside(PARTIAL_PLAN)
        outcome = verification.objection or "passed its verification"
        self.session.note(f"{result.warnings[0]}; it {outcome}: {path}")
        return path

    def _finish(self, result: PlannedResult) -> None:
        self.report("verify", 0.0)  # ends the planner's bar before lines are printed
        plan_file = self.output.path / PLAN_FILE
        result.write(plan_file)
        if result.write_beside is not None:
            result.write_beside(self.output.path)
        kind = identify_kind(plan_file)
        verify_and_mark = kind.load_verifier()
        start = time.perf_counter()
        verification = verify_and_mark(plan_file)
        seconds = time.perf_counter() - start
        warn_of_implausible(verification)  # before all else
        for line in result.summary:
            self.session.note(line)
        if self.session.verbose:
            for note in result.notes:
                self.session.note(f"{'note':<9} {note}")
        for warning in result.warnings:
            warn(warning)
        self.session.note(format_verification(verification, seconds))
        for line in format_omissions(verification):
            self.session.note(line)
        self.session.note(format_level(verification))
        self.report("report", 0.0)
        write_report = kind.write_report if self.with_figures else kind.write_values
        write_report(plan_file, self.output.path, verification)
        self._failure = verification.objection

    def hand_over(self, as_json: bool) -> None:
        """Print the plan's path, or its report.

        Raises:
            VerificationFailed: the plan failed its verification, or its data are implausible.
        """
        plan_file = self.target / PLAN_FILE
        if as_json:
            report = json.loads((self.target / REPORT).read_text(encoding="utf-8"))
            print_json({**report, "plan": str(plan_file)})
        else:
            print_result(str(plan_file))
        if self._failure:
            self.session.stage = "verify"
            raise VerificationFailed(f"{plan_file} {self._failure}")


@contextmanager
def plan_run(
    session: Invocation, loaded: LoadedSpec, out: Path | None, force: bool, report: bool = True
) -> Iterator[PlanRun]:
    """Context that calls `make`; the output directory appears when it ends well.

    out: the directory; below outputs/, named after the spec, if left out. report: whether page and
    figures are drawn.
    """
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        with StageProgress(session) as progress:
            yield PlanRun(session, target, directory, progress.report, report)
        directory.publish()
