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
from climbplan.cli.console import Session, print_json, print_result, warn
from climbplan.cli.output_directory import OutputDirectory
from climbplan.cli.progress import StageProgress
from climbplan.cli.verify_line import (
    leaves_out_lines,
    level_line,
    verify_line,
    warn_of_implausible,
)
from climbplan.errors import VerificationFailed

if TYPE_CHECKING:
    from climbplan.api.making import PlannedResult
    from climbplan.schema.loaded import LoadedSpec


REPORT = "report.json"


@dataclass
class PlanRun:
    """A run whose files stand in a hidden directory until they are whole."""

    session: Session
    target: Path  # where they appear
    directory: Path  # where they are written
    report: Callable[[str, float], None]  # progress: stage, share that is done
    drawn: bool  # whether page and figures are wanted
    _failure: str = field(default="", init=False)  # why the plan must not be used

    def make(
        self, loaded: LoadedSpec, jobs: int = 1, save_model: Path | None = None
    ) -> PlannedResult:
        """Plan what the spec asks for, write and verify it; its lines, warnings and report."""
        # Planners and solvers take a second to import: not before all paths are known to be good
        from climbplan.api.making import PlanningOptions, run_planner

        made = run_planner(loaded, PlanningOptions(self.report, jobs, save_model, warn))
        self._finish(made)
        return made

    def _finish(self, made: PlannedResult) -> None:
        self.report("verify", 0.0)  # ends the planner's bar before lines are printed
        plan_file = self.directory / PLAN_FILE
        made.write(plan_file)
        if made.write_beside is not None:
            made.write_beside(self.directory)
        kind = identify_kind(plan_file)
        verify_and_mark = kind.load_verifier()
        start = time.perf_counter()
        verification = verify_and_mark(plan_file)
        spent = time.perf_counter() - start
        warn_of_implausible(verification)  # before all else
        for line in made.summary:
            self.session.note(line)
        for warning in made.warnings:
            warn(warning)
        self.session.note(verify_line(verification, spent))
        for line in leaves_out_lines(verification):
            self.session.note(line)
        self.session.note(level_line(verification))
        self.report("report", 0.0)
        write_report = kind.write_report if self.drawn else kind.write_values
        write_report(plan_file, self.directory, verification)
        self._failure = verification.objection

    def hand_over(self, as_json: bool) -> None:
        """Print the plan's path, or its report.

        Raises:
            PlanFails: the plan failed its verification, or its data are implausible.
        """
        plan_file = self.target / PLAN_FILE
        if as_json:
            told = json.loads((self.target / REPORT).read_text(encoding="utf-8"))
            print_json({**told, "plan": str(plan_file)})
        else:
            print_result(str(plan_file))
        if self._failure:
            self.session.stage = "verify"
            raise VerificationFailed(f"{plan_file} {self._failure}")


@contextmanager
def plan_run(
    session: Session, loaded: LoadedSpec, out: Path | None, force: bool, report: bool = True
) -> Iterator[PlanRun]:
    """Context that calls `make`; the output directory appears when it ends well.

    out: the directory; below outputs/, named after the spec, if left out. report: whether page and
    figures are drawn.
    """
    target = out if out is not None else Path("outputs", loaded.name)
    with OutputDirectory(target, force=force) as directory:
        with StageProgress(session) as progress:
            yield PlanRun(session, target, directory.path, progress.report, report)
        directory.publish()
