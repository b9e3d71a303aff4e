"""`climbplan.find_limit`: the largest value of a key of a spec with a plan that counts.

Every value is planned and verified in full, as the plan commands do. A value counts where they end
with exit code 0: every check of the plan passed, and neither data nor deflections are implausible.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from climbplan.api.ctrl_c import ctrl_c_insists
from climbplan.api.limit_keys import NumericKey, find_numeric_key, read_value
from climbplan.api.limit_kinds import LIMIT_KINDS, LimitKind
from climbplan.api.limit_search import (
    Direction,
    Proposals,
    Tolerance,
    guess_direction,
    propose_between_ends,
    propose_values,
)
from climbplan.api.limit_trials import (
    LimitResult,
    Trial,
    judge_plan,
    report_failure,
    report_invalid_spec,
)
from climbplan.api.loading import SpecSource, build_overrides, read_spec_source
from climbplan.api.making import PlanningOptions
from climbplan.api.planning import plan_and_verify
from climbplan.api.progress_display import show_progress
from climbplan.errors import (
    LimitReached,
    NoPlanFound,
    SpecError,
    Unresolved,
    UsageError,
)
from climbplan.progress import Progress
from climbplan.schema.loaded import LoadedSpec
from climbplan.schema.loading import load_source
from climbplan.schema.overrides import Override
from climbplan.schema.source import SourceText

DEFAULT_TOLERANCE = "5%"
_TIME_IS_UP = 1e-3  # of a planner's limit: with less time left, the end of the search ended a plan


class _TimeIsUp(BaseException):
    """The time of the whole search is over; no handler of a planner's errors is to catch it."""


@dataclass(frozen=True, kw_only=True)
class LimitSearchOptions:
    """What a search for a limit may vary, and how it plans.

    Attributes:
        lower: smallest value to try; None takes the end that the schema sets.
        upper: largest value to try; None takes the end that the schema sets.
        tolerance: distance of the last value that counts and the first that fails: a number in the
            key's unit, or a text such as "5%" or "0.1".
        direction: "largest" or "smallest"; None takes what is usual for the key.
        time_limit: limit of the whole search [s]; None sets none.
        jobs: worker processes of plans that are judged in sampled worlds.
        progress: called with a stage and the fraction of it that is done.
        on_trial: called with each value that was tried.
        warn: called with warnings of planners.
    """

    lower: float | None = None
    upper: float | None = None
    tolerance: float | str = DEFAULT_TOLERANCE
    direction: Direction | None = None
    time_limit: float | None = None
    jobs: int = 1
    progress: Progress = lambda stage, fraction: None
    on_trial: Callable[[Trial], None] = lambda trial: None
    warn: Callable[[str], None] = lambda words: None


def parse_tolerance(tolerance: float | str) -> Tolerance:
    """Return a tolerance given as a number or as a text, "5%" being relative.

    Raises:
        UsageError: it is not above zero, or no number.
    """
    text = str(tolerance).strip()
    is_relative = text.endswith("%")
    try:
        width = float(text.removesuffix("%"))
    except ValueError:
        width = float("nan")
    if not 0 < width < float("inf") or (is_relative and width >= 100):
        raise UsageError(
            f"tolerance: expected a number above zero in the key's unit, or a percentage such as "
            f"{DEFAULT_TOLERANCE}, got {text!r}"
        )
    return Tolerance(width / 100 if is_relative else width, is_relative)


class LimitSearch:
    """A search for the limit of one key, whose result so far can be read at any moment."""

    def __init__(
        self,
        source: SourceText,
        overrides: Sequence[str | Override],
        key: str,
        options: LimitSearchOptions,
    ) -> None:
        """Check spec, key and range, before anything is planned.

        Args:
            source: text of the spec.
            overrides: changes of it, as those of a plan command.
            key: dotted key, entries of lists by their index.
            options: range, tolerance and limits.

        Raises:
            SpecError: the spec has mistakes, also at an end of the range that was given.
            UsageError: no plan is made of such a spec, the key is no number, or the range is empty.
        """
        self._source, self._overrides, self._options = source, list(overrides), options
        loaded = load_source(source, self._overrides)
        kind = str(getattr(vars(loaded).get("spec"), "kind", ""))
        if kind not in LIMIT_KINDS or not isinstance(loaded, LoadedSpec):
            raise UsageError(
                f"{source.shown}: limits are those of specs of kind {', '.join(LIMIT_KINDS)}"
            )
        self.kind: LimitKind = LIMIT_KINDS[kind]
        stated = loaded.document.value
        self._overrides += [
            Override(name, "null", f"without {name}")
            for name in self.kind.without
            if isinstance(stated, dict) and stated.get(name) is not None
        ]
        self.name = loaded.name
        self.key: NumericKey = find_numeric_key(loaded, kind, key)
        self._tolerance = parse_tolerance(options.tolerance)
        self._domain = self.key.narrow(options.lower, options.upper)
        self._direction = options.direction or self.kind.default_direction(self.key.key)
        if self._direction is None and None in (options.lower, options.upper):
            raise UsageError(
                f"{self.key.key}: nothing says whether its largest or its smallest value is "
                "sought: say which, or give both ends of the range"
            )
        for value in (self._domain.start, options.lower, options.upper):
            if value is not None:
                self._load(value)
        self._trials: list[Trial] = []
        self._begin = time.monotonic()
        self._stopped_by: Literal["", "time", "interrupt"] = "interrupt"  # until it ends

    @property
    def start(self) -> float:
        """The first value that is tried."""
        return self._domain.start

    @property
    def direction(self) -> Direction | None:
        """Direction of the search; None as long as only outcomes can tell."""
        return self._direction

    def run(self) -> LimitResult:
        """Try values until the limit is bracketed to the tolerance, or time is up."""
        self._begin = time.monotonic()
        if self._direction is None:
            proposals: Proposals = propose_between_ends(self._domain, self._tolerance)
        else:
            proposals = propose_values(self._domain, self._direction, self._tolerance)
        value = next(proposals)
        while True:
            trial = self._try(value)
            self._trials.append(trial)
            self._options.on_trial(trial)
            try:
                value = proposals.send(trial.counts)
            except StopIteration:
                self._stopped_by = "time" if trial.outcome == "out_of_time" else ""
                break
            if trial.outcome == "out_of_time" or self._remaining() <= 0:
                self._stopped_by = "time"
                break
        return self.result()

    def result(self) -> LimitResult:
        """Return what is known so far."""
        outcomes = {trial.value: trial.counts for trial in self._trials}
        direction = self._direction or (guess_direction(outcomes) if outcomes else "largest")
        return LimitResult(
            self.key,
            self.kind,
            direction,
            tuple(self._trials),
            self._stopped_by,
            time.monotonic() - self._begin,
        )

    def _remaining(self) -> float:
        """Return what is left of the time of the search [s]."""
        if self._options.time_limit is None:
            return float("inf")
        return self._options.time_limit - (time.monotonic() - self._begin)

    def _load(self, value: float, time_limit: float | None = None) -> LoadedSpec:
        text = self.key.to_yaml(value)
        overrides = [*self._overrides, Override(self.key.key, text, f"--set {self.key.key}={text}")]
        if time_limit is not None:
            limit = f"{time_limit:.6g}"
            overrides.append(Override("solver.time_limit", limit, f"--time-limit {limit}"))
        loaded = load_source(self._source, overrides)
        assert isinstance(loaded, LoadedSpec)  # of the same kind
        return loaded

    def _try(self, value: float) -> Trial:
        """Plan and verify at one value, whatever comes of it."""
        begin, cpu_begin = time.monotonic(), _read_cpu_time()
        limit: float | None = None  # of the planner, as the spec has it [s]
        is_cut = False
        try:
            loaded = self._load(value)
            limit = read_value(vars(loaded)["spec"], ("solver", "time_limit"))
            is_cut = limit is not None and self._remaining() < limit
            if is_cut:
                loaded = self._load(value, max(self._remaining(), 1e-3))
            trial = judge_plan(self.kind, value, plan_and_verify(loaded, self._planning(value)))
        except SpecError as error:
            if not self._trials:  # a mistake in the spec as it stands
                raise
            trial = report_invalid_spec(value, error)
        except NoPlanFound as error:
            trial = report_failure(value, error)
        except _TimeIsUp:
            trial = Trial(value, "out_of_time", "the time of the search was over")
        is_decided = trial.outcome in ("verified", "infeasible", "invalid_spec")
        if is_cut and not is_decided and self._remaining() <= _TIME_IS_UP * (limit or 0.0):
            trial = Trial(value, "out_of_time", trial.message)
        return trial.with_times(time.monotonic() - begin, _read_cpu_time() - cpu_begin)

    def _planning(self, value: float) -> PlanningOptions:
        def report(stage: str, fraction: float) -> None:
            if self._remaining() <= 0:
                raise _TimeIsUp
            self._options.progress(f"{self.key.format(value)}: {stage}", fraction)

        # Of the stated value alone: what would mend a harder one is the value that is sought
        is_stated = not self._trials
        return PlanningOptions(
            report, self._options.jobs, None, self._options.warn, seek_remedies=is_stated
        )


def explain_no_limit(result: LimitResult) -> NoPlanFound:
    """Return the error of a search in which no value counts: nothing is proved of other values."""
    key, trials = result.key, result.trials
    if not trials or all(trial.outcome == "out_of_time" for trial in trials):
        return LimitReached(
            f"{key.key}: the time of the search was over before a plan was found", stage="limits"
        )
    values = ", ".join(key.format(trial.value) for trial in sorted(trials, key=lambda t: t.value))
    first = trials[0]
    proved = all(trial.outcome == "infeasible" for trial in trials)
    outcome = "each of them proved infeasible" if proved else "not each of them proved infeasible"
    return Unresolved(
        f"{key.key}: no plan that counts at {values} ({outcome}); at {key.format(first.value)} "
        f"{first.describe()}",
        first.conflicts,
        because="a search tries single values; other values may have a plan",
        stage="limits",
        remedies=first.remedies,
    )


def _read_cpu_time() -> float:
    """Return the processor time of this process and of those that it waited for [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@ctrl_c_insists()
def find_limit(
    spec: SpecSource | LoadedSpec,
    key: str,
    overrides: Mapping[str, Any] | None = None,
    *,
    lower: float | None = None,
    upper: float | None = None,
    tolerance: float | str = DEFAULT_TOLERANCE,
    direction: Direction | None = None,
    method: str | None = None,
    seed: int | None = None,
    time_limit: float | None = None,
    jobs: int = 1,
    progress: Progress | bool | None = None,
    on_trial: Callable[[Trial], None] | None = None,
) -> LimitResult:
    """Find the largest (or smallest) value of a key for which a plan is made that counts.

        limit = climbplan.find_limit("specs/climb_steps.yaml", "task.payload.mass")
        limit.value, limit.plan, limit.sentences()

    The stated value is doubled or halved until the outcome changes, then bisected; every value is
    planned and verified in full. A value counts if every check of its plan passes and nothing about
    the plan is implausible. A value without a plan is no proof: `Trial.outcome` tells them apart.

    Args:
        spec: the result of `climbplan.load_spec`, or anything that it takes.
        key: dotted key of a number, such as "task.payload.mass"; entries of lists by their index.
        overrides: values by dotted key, as with `--set`.
        lower: smallest value to try; None takes the end that the schema sets.
        upper: largest value to try; None takes the end that the schema sets.
        tolerance: distance from the next value that fails, in the key's unit or as text ("5%").
        direction: "largest" or "smallest"; None takes what is usual for the key, or what planning
            at both ends of the range shows.
        method: replaces `solver.method`; None keeps the spec's.
        seed: replaces `seed`; None keeps the spec's.
        time_limit: limit of the whole search [s]; None sets none.
        jobs: worker processes of plans that have some.
        progress: as of `climbplan.plan`: a callback of stage and fraction, or whether to show it.
        on_trial: called with every value that was tried, so that Ctrl-C loses none.

    Raises:
        SpecError: the spec has mistakes, also at an end of the range that was given.
        UsageError: the key is no number, the range is empty, or the direction is not known.
        Unresolved: no value that was tried has a plan that counts.
        LimitReached: the time was over before a plan was found.
    """
    options = {"solver.method": method, "seed": seed}
    changes = {**(overrides or {}), **{k: v for k, v in options.items() if v is not None}}
    with show_progress(progress) as report:
        search_options = LimitSearchOptions(
            lower=lower,
            upper=upper,
            tolerance=tolerance,
            direction=direction,
            time_limit=time_limit,
            jobs=jobs,
            progress=report,
            on_trial=on_trial or (lambda trial: None),
        )
        return _search_limit(spec, build_overrides(changes), key, search_options)


def _search_limit(
    spec: SpecSource | LoadedSpec,
    overrides: Sequence[str | Override],
    key: str,
    options: LimitSearchOptions,
) -> LimitResult:
    """Run a search; raises NoPlanFound if no value counts."""
    if isinstance(spec, LoadedSpec):
        text = SourceText(spec.source, spec.name, spec.directory, spec.text)
    else:
        text = read_spec_source(spec)
    result = LimitSearch(text, overrides, key, options).run()
    if result.best is None:
        raise explain_no_limit(result)
    return result
