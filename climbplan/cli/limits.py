"""`climbplan limits`: the largest value of a key for which a verified plan is found."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.api.kinds import identify_kind
from climbplan.api.plan_path import PLAN_FILE
from climbplan.cli.console import Invocation, print_json, print_result, warn
from climbplan.cli.options import (
    Force,
    Jobs,
    Json,
    Method,
    Quiet,
    Seed,
    Set,
    Spec,
    Verbose,
)
from climbplan.cli.output_directory import OutputDirectory
from climbplan.cli.progress import StageProgress
from climbplan.cli.quick import NoReport, quick_overrides
from climbplan.cli.supervision import remove_if_killed
from climbplan.store.csv_file import write_csv

if TYPE_CHECKING:
    from climbplan.api.limit_search import Direction
    from climbplan.api.limit_trials import LimitResult, Trial
    from climbplan.api.limits import LimitSearch
    from climbplan.schema.overrides import Override
    from climbplan.schema.source import SourceText

TABLE, ANSWER = "limits.csv", "limits.json"
Key = Annotated[
    str,
    typer.Option(
        "--of", metavar="KEY", help="Key whose limit is sought, such as task.payload.mass."
    ),
]
Lower = Annotated[
    float | None,
    typer.Option("--from", metavar="LOW", help="Smallest value [default: the key's own bound]."),
]
Upper = Annotated[
    float | None,
    typer.Option("--to", metavar="HIGH", help="Largest value [default: the key's own bound]."),
]
WhichEnd = Annotated[
    bool | None,
    typer.Option(
        "--largest/--smallest",
        help="Which value is sought [default: the usual one for the key, such as the smallest "
        "friction, or what planning at LOW and HIGH shows].",
        show_default=False,
    ),
]
ToleranceText = Annotated[
    str,
    typer.Option(
        "--tolerance",
        metavar="WIDTH",
        help="Distance of the limit from the next value that fails, in the key's unit or as a "
        "percentage.",
    ),
]
OutOfSearch = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", metavar="DIR", help="Output directory [default: outputs/<spec name>_limits]."
    ),
]
WholeTimeLimit = Annotated[
    float | None,
    typer.Option("--time-limit", metavar="SECONDS", help="Time limit of the whole search [s]."),
]
QuickSearch = Annotated[
    bool,
    typer.Option(
        "--quick", help="Coarser plans, as with --quick of the command for such a spec; no report."
    ),
]


def limits(
    context: typer.Context,
    spec: Spec,
    *,
    key: Key,
    lower: Lower = None,
    upper: Upper = None,
    largest: WhichEnd = None,
    tolerance: ToleranceText = "5%",
    out: OutOfSearch = None,
    assignments: Set = None,
    seed: Seed = None,
    jobs: Jobs = 1,
    time_limit: WholeTimeLimit = None,
    method: Method = None,
    as_json: Json = False,
    no_report: NoReport = False,
    quick: QuickSearch = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Find how much payload, how little friction or how wide a gap a task allows.

    Plans and verifies at several values of one key of the spec: doubles or halves the stated value,
    then bisects. Prints KEY=VALUE of the last value that counts, as --set takes it. A value counts
    if every check of its plan passes and its data are plausible. The output directory has that plan
    with its report, limits.csv and limits.json with all values that were tried; it appears with
    the first plan and stays if the run is stopped. Exit code 4 if no value counts.
    """
    from climbplan.api.limits import LimitSearch, LimitSearchOptions
    from climbplan.cli.spec_options import spec_overrides
    from climbplan.schema.source import read_source

    session = context.ensure_object(Invocation)
    text = read_source(spec)
    overrides = _find_quick_overrides(text) if quick else []
    overrides += spec_overrides(assignments, seed, method=method)
    with StageProgress(session) as progress:
        run = _LimitRun(session, force)
        search = LimitSearch(
            text,
            overrides,
            key,
            LimitSearchOptions(
                lower=lower,
                upper=upper,
                tolerance=tolerance,
                direction=_DIRECTIONS[largest],
                time_limit=time_limit,
                jobs=jobs,
                progress=progress.report,
                on_trial=run.add,
                warn=warn,
            ),
        )
        run.begin(search, out if out is not None else Path("outputs", f"{search.name}_limits"))
        result = run.search_limit(progress, with_report=not (no_report or quick))
    run.hand_over(result)


_DIRECTIONS: dict[bool | None, Direction | None] = {None: None, True: "largest", False: "smallest"}


class _LimitRun:
    """A search whose best plan so far is in the output directory at any moment."""

    def __init__(self, session: Invocation, force: bool) -> None:
        self._session = session
        self._force = force
        self._best: Trial | None = None  # what the directory holds

    def begin(self, search: LimitSearch, target: Path) -> None:
        """Check that the directory can be written, and say what is sought.

        Raises:
            UsageError: the directory is taken or cannot be written.
        """
        self._search, self._target = search, target
        with OutputDirectory(target, force=self._force):
            pass
        key, direction = search.key, search.direction or "last"
        unit = f" [{key.unit}]" if key.unit else ""
        self._session.note(
            f"{search.name:<16} {direction} {key.key}{unit}, from {key.format(search.start)}"
        )

    def add(self, trial: Trial) -> None:
        """Say how a value ended, and keep its plan if it is the best so far."""
        value = self._search.key.format(trial.value)
        self._session.note(f"{'try':<9} {value:<9} {trial.seconds:.2f} s   {trial.describe()}")
        if trial.planned is not None:
            remove_if_killed(trial.planned.folder)
        result = self._search.result()
        if result.best is not self._best:
            self._best = result.best
            self.publish(result, with_report=False)

    def search_limit(self, progress: StageProgress, with_report: bool) -> LimitResult:
        """Run the search and write its result.

        What is known when it is interrupted goes into its JSON answer.

        Raises:
            NoPlanFound: no value counts.
        """
        from climbplan.api.limits import explain_no_limit

        try:
            result = self._search.run()
        except KeyboardInterrupt:
            self._report_partial()
            raise
        if result.best is None:
            self._print_json(result)
            raise explain_no_limit(result)
        if with_report:
            progress.report("report", 0.0)
        self.publish(result, with_report)
        return result

    def _report_partial(self) -> None:
        result = self._search.result()
        for sentence in result.sentences():
            self._session.note(f"{'so far':<9} {sentence}")
        if self._best is not None:
            self._session.note(f"{'so far':<9} {self._target / PLAN_FILE}")
        self._print_json(result)

    def publish(self, result: LimitResult, with_report: bool) -> None:
        """Write the plan of the best value and all values tried; the directory appears whole.

        Raises:
            UsageError: it cannot be written.
        """
        if result.best is None or result.best.planned is None:
            return
        planned = result.best.planned
        with OutputDirectory(self._target, force=self._force) as directory:
            shutil.copytree(planned.folder, directory.path, dirs_exist_ok=True)
            plan_file = directory.path / PLAN_FILE
            kind = identify_kind(plan_file)
            write_report = kind.write_report if with_report else kind.write_values
            write_report(plan_file, directory.path, planned.verification)
            write_csv(directory.path / TABLE, *result.table())
            text = json.dumps(result.as_dict(), indent=2, allow_nan=False)
            (directory.path / ANSWER).write_text(f"{text}\n", encoding="utf-8")
            directory.publish()
        self._force = True  # from now on the directory is this run's own

    def hand_over(self, result: LimitResult) -> None:
        """Print the limit, or with `--json` all that is known of it."""
        for sentence in result.sentences():
            self._session.note(f"{'limit':<9} {sentence}")
        self._session.note(f"{'plan':<9} {self._target / PLAN_FILE}")
        if self._session.as_json:
            self._print_json(result)
        elif result.value is not None:
            print_result(f"{result.key.key}={result.key.to_yaml(result.value)}")

    def _print_json(self, result: LimitResult) -> None:
        if self._session.as_json:
            plan = {} if self._best is None else {"plan": str(self._target / PLAN_FILE)}
            print_json({**result.as_dict(), **plan})


def _find_quick_overrides(text: SourceText) -> list[str | Override]:
    """Return the overrides of `--quick` for the kind of a spec; none for other kinds."""
    from climbplan.api.limit_kinds import LIMIT_KINDS
    from climbplan.schema.yaml_source import parse_yaml

    value = parse_yaml(text.text, text.shown).value
    kind = value.get("kind") if isinstance(value, dict) else None
    return quick_overrides(kind, True) if kind in LIMIT_KINDS else []
