"""The values that a search for a limit tried, and what they come to in plain words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from climbplan.api.limit_keys import NumericKey
from climbplan.api.limit_kinds import LimitKind
from climbplan.api.limit_search import Direction
from climbplan.errors import Conflict, Infeasible, NoPlanFound, Remedy, SpecError

if TYPE_CHECKING:
    from climbplan.api.plan import Plan
    from climbplan.api.planning import VerifiedPlan
    from climbplan.verification.check import Check
    from climbplan.verification.verification import Verification

Outcome = Literal[
    "verified",
    "implausible",
    "unverified",
    "infeasible",
    "not_proved",
    "limit",
    "invalid_spec",
    "out_of_time",
]
"""What became of a value; only "verified" counts, and only "infeasible" is a proof."""

_IN_WORDS: dict[Outcome, str] = {
    "verified": "verified",
    "implausible": "all checks passed, but the plan must not be used",
    "unverified": "a plan was found, but fails its verification",
    "infeasible": "proved infeasible",
    "not_proved": "no plan found, nothing proved",
    "limit": "no plan found within the limits, nothing proved",
    "invalid_spec": "no valid spec",
    "out_of_time": "not decided",
}
_NUM_MARGINS = 3
# Told of every plan, however much of their bounds is used up: what loads and surfaces end
_LOAD_CHECKS = ("force.friction", "torque.limit", "joint.torque", "grip.shear")
_NUM_CONFLICTS = 3
_MAX_LENGTH = 300  # of a message in one line; JSON has it in full


@dataclass(frozen=True)
class Margin:
    """A bound of which a plan uses up much, and the place where it uses most of it.

    Attributes:
        check: name of the check, such as "torque.limit".
        meaning: what the check looks at, in plain words.
        where: instant, limb and joint.
        margin: what is left, in the check's terms ("S_tau 1.02").
        fraction: part of the bound that is used up, 1 at the bound.
    """

    check: str
    meaning: str
    where: str
    margin: str
    fraction: float

    def __str__(self) -> str:
        place = f", {self.where}" if self.where else ""
        left = f" ({self.margin})" if self.margin else ""
        meaning = f": {self.meaning}" if self.meaning else ""
        return f"{100 * self.fraction:.3g} % of {self.check}{place}{left}{meaning}"

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return dict(vars(self))


@dataclass(frozen=True)
class Trial:
    """One value that was planned at, and what came of it.

    Attributes:
        value: in the key's unit.
        outcome: what became of it; "verified" counts.
        message: first sentence of the failure, or the headline of the verification.
        margins: bounds of which the plan uses up most, and those of loads, tightest first.
        conflicts: constraints of a failure that cannot hold together.
        remedies: changes of the spec that a failure suggests.
        planned: plan and verification, also of one that does not count; None where there is none.
        seconds: by the clock.
        cpu_seconds: of processors, workers included.
    """

    value: float
    outcome: Outcome
    message: str
    margins: tuple[Margin, ...] = ()
    conflicts: tuple[Conflict, ...] = ()
    remedies: tuple[Remedy, ...] = ()
    planned: VerifiedPlan | None = field(default=None, repr=False)
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    @property
    def plan(self) -> Plan | None:
        """The plan, also one that does not count; None where none was found."""
        return None if self.planned is None else self.planned.plan

    @property
    def counts(self) -> bool:
        """Return whether the value has a plan that passes every check and is plausible."""
        return self.outcome == "verified"

    def with_times(self, seconds: float, cpu_seconds: float) -> Trial:
        """Return the trial with the time that it took."""
        return replace(self, seconds=seconds, cpu_seconds=cpu_seconds)

    def describe(self) -> str:
        """Return outcome and message in one line."""
        message = self.message
        if len(message) > _MAX_LENGTH:
            message = f"{message[:_MAX_LENGTH].rstrip()} ..."
        return f"{_IN_WORDS[self.outcome]}: {message}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "value": self.value,
            "outcome": self.outcome,
            "counts": self.counts,
            "message": self.message,
            "margins": [margin.as_dict() for margin in self.margins],
            "conflicts": [
                {
                    "where": conflict.where,
                    "constraints": list(conflict.constraints),
                    "names": list(conflict.names),
                }
                for conflict in self.conflicts
            ],
            "remedies": [remedy.option for remedy in self.remedies if remedy.key],
            "seconds": round(self.seconds, 3),
            "cpu_seconds": round(self.cpu_seconds, 3),
        }


def judge_plan(kind: LimitKind, value: float, planned: VerifiedPlan) -> Trial:
    """Return the trial of a value at which there is a plan."""
    verification = planned.verification
    outcome: Outcome = "verified"
    message = verification.headline()
    if not verification.passed:
        outcome = "unverified"
    elif verification.implausible:
        outcome, message = "implausible", "; ".join(verification.implausible)
    elif kind.judged_by_status and planned.status == "infeasible":
        outcome, message = "infeasible", "every scene is proved infeasible"
    elif kind.judged_by_status and planned.status == "limit":
        outcome, message = "limit", "one scene or more has no answer"
    margins = tuple(_list_margins(kind, verification))
    return Trial(value, outcome, message, margins, planned=planned)


def report_failure(value: float, error: NoPlanFound) -> Trial:
    """Return the trial of a value at which no plan was found."""
    outcome: Outcome = "limit" if error.status == "limit" else "not_proved"
    if isinstance(error, Infeasible):
        outcome = "infeasible"
    message = error.message.partition("\n")[0].removesuffix(":")
    return Trial(
        value,
        outcome,
        message or type(error).__name__,
        conflicts=tuple(error.conflicts),
        remedies=error.remedies,
    )


def report_invalid_spec(value: float, error: SpecError) -> Trial:
    """Return the trial of a value that the spec cannot have."""
    return Trial(value, "invalid_spec", str(error).partition("\n")[0])


def _list_margins(kind: LimitKind, verification: Verification) -> Iterator[Margin]:
    """Yield the bounds of which most is used up, failed checks first, then those of loads."""

    def rank(check: Check) -> tuple[bool, float]:
        return check.passed, -check.used

    for index, check in enumerate(sorted(verification.checks, key=rank)):
        is_listed = index < _NUM_MARGINS or check.name in _LOAD_CHECKS
        if is_listed and (check.used > 0 or not check.passed):
            meaning = kind.describe_check(check.name)
            yield Margin(check.name, meaning, check.worst_at, check.margin, check.used)


@dataclass(frozen=True)
class LimitResult:
    """The outcome of a search for a limit.

    Attributes:
        key: what was varied, with its unit.
        kind: what a search knows of the kind of spec.
        direction: "largest" or "smallest", which value was sought.
        trials: every value that was tried, in order.
        stopped_by: what ended the search before the limit was bracketed to the tolerance; "" if
            nothing did.
        seconds: duration of the search [s].
    """

    key: NumericKey
    kind: LimitKind = field(repr=False)
    direction: Direction
    trials: tuple[Trial, ...]
    stopped_by: Literal["", "time", "interrupt"]
    seconds: float

    def _hardness(self, trial: Trial) -> float:
        return trial.value if self.direction == "largest" else -trial.value

    @property
    def best(self) -> Trial | None:
        """The hardest value that counts; None if none does."""
        return max((t for t in self.trials if t.counts), key=self._hardness, default=None)

    @property
    def value(self) -> float | None:
        """The limit itself, in the key's unit; None if no value counts."""
        return None if self.best is None else self.best.value

    @property
    def plan(self) -> Plan | None:
        """The plan at the limit."""
        return None if self.best is None else self.best.plan

    @property
    def next_failed(self) -> Trial | None:
        """The nearest harder value that was tried and does not count; None if there is none."""
        return min(self._failed_beyond(), key=self._hardness, default=None)

    @property
    def next_infeasible(self) -> Trial | None:
        """The nearest harder value for which it is proved that no plan exists."""
        proved = (t for t in self._failed_beyond() if t.outcome == "infeasible")
        return min(proved, key=self._hardness, default=None)

    @property
    def hardest_checked(self) -> Trial | None:
        """The hardest value whose plan passes every check, plausible or not."""
        passed = (t for t in self.trials if t.outcome in ("verified", "implausible"))
        return max(passed, key=self._hardness, default=None)

    @property
    def failed_within(self) -> tuple[Trial, ...]:
        """Easier values that do not count: with one, outcomes do not follow the value."""
        if self.best is None:
            return ()
        limit = self._hardness(self.best)
        return tuple(t for t in self._failures() if self._hardness(t) < limit)

    @property
    def ended_by(self) -> Literal["failure", "range", "time", "interrupt", "nothing"]:
        """The reason why the search ended.

        "failure": a harder value fails, within the tolerance. "range": all values up to the end
        count. "time": the time was over first. "interrupt": it was stopped, or still goes on.
        "nothing": no value counts.
        """
        if self.stopped_by:
            return self.stopped_by
        if self.best is None:
            return "nothing"
        return "range" if self.next_failed is None else "failure"

    @property
    def cpu_seconds(self) -> float:
        """Processor time of all plans and verifications [s]."""
        return sum(trial.cpu_seconds for trial in self.trials)

    def _failures(self) -> list[Trial]:
        return [t for t in self.trials if not t.counts and t.outcome != "out_of_time"]

    def _failed_beyond(self) -> list[Trial]:
        if self.best is None:
            return self._failures()
        limit = self._hardness(self.best)
        return [t for t in self._failures() if self._hardness(t) > limit]

    def sentences(self) -> tuple[str, ...]:
        """Return the answer in plain words, one line each."""
        return tuple(self._sentences())

    def _sentences(self) -> Iterator[str]:
        key, beyond = self.key, "above" if self.direction == "largest" else "below"
        count = f"{len(self.trials)} value{'s' * (len(self.trials) != 1)} planned"
        effort = f"{count}, {self.cpu_seconds:.0f} s of processor time"
        if self.best is None:
            yield f"no value of {key.key} counts ({effort})"
            return
        best = self.best
        yield f"{self.direction} {key.key} that is verified: {key.format(best.value)} ({effort})"
        if best.planned is not None and (model := best.planned.verification.model):
            yield f"verified in its model only: {model}"
        yield from self._describe_end(beyond)
        if (proved := self.next_infeasible) is not None and proved is not self.next_failed:
            yield f"proved infeasible: {key.format(proved.value)}, the nearest {beyond}"
        checked = self.hardest_checked
        if checked is not None and checked is not best:
            yield f"checks alone pass as far as {key.format(checked.value)}, with implausible data"
        for trial in self.failed_within:
            yield f"not in order: {key.format(trial.value)}, an easier value: {trial.describe()}"
        for margin in best.margins:
            yield f"tightest at {key.format(best.value)}: {margin}"

    def _describe_end(self, beyond: str) -> Iterator[str]:
        """Yield lines on what ends the limit."""
        nearest = self.next_failed
        if self.stopped_by == "interrupt":
            yield "the search was stopped before the limit was bracketed to the tolerance"
        if self.stopped_by == "time":
            undecided = [t.value for t in self.trials if t.outcome == "out_of_time"]
            under_way = f"; {self.key.format(undecided[-1])} is not decided" if undecided else ""
            yield f"the time was over before the limit was bracketed to the tolerance{under_way}"
        if nearest is None:
            if not self.stopped_by:
                yield f"nothing ends it {beyond}: every value tried up to the end counts"
            return
        ends = "fails" if self.stopped_by else "ends it"
        yield f"{self.key.format(nearest.value)} {ends}: {nearest.describe()}"
        for conflict in nearest.conflicts[:_NUM_CONFLICTS]:
            yield f"  {conflict}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        nearest, proved = self.next_failed, self.next_infeasible
        checked = self.hardest_checked
        return {
            "of": self.key.key,
            "unit": self.key.unit,
            "direction": self.direction,
            "value": self.value,
            "ended_by": self.ended_by,
            "next_failed": None if nearest is None else nearest.as_dict(),
            "next_infeasible": None if proved is None else proved.value,
            "hardest_checked": None if checked is None else checked.value,
            "failed_within": [trial.value for trial in self.failed_within],
            "margins": [margin.as_dict() for margin in self.best.margins] if self.best else [],
            **self._scope(),
            "answer": list(self.sentences()),
            "plans": len(self.trials),
            "seconds": round(self.seconds, 3),
            "cpu_seconds": round(self.cpu_seconds, 3),
            "trials": [trial.as_dict() for trial in self.trials],
        }

    def _scope(self) -> dict[str, Any]:
        """Return level, badge and what it leaves out, of the plan at the limit."""
        if self.best is None or self.best.planned is None:
            return {}
        scope = self.best.planned.verification.scope()
        return {name: scope[name] for name in ("level", "badge", "leaves_out", "fragile")}

    def table(self) -> tuple[tuple[str, ...], list[tuple[str | float, ...]]]:
        """Return header and rows of the values that were tried, by value."""
        value = f"value_{self.key.unit}" if self.key.unit.isalpha() else "value"
        header = (value, "outcome", "tightest_check", "margin", "seconds", "cpu_seconds", "message")
        rows: list[tuple[str | float, ...]] = []
        for trial in sorted(self.trials, key=lambda t: t.value):
            tightest = trial.margins[0] if trial.margins else None
            rows.append(
                (
                    trial.value,
                    trial.outcome,
                    "" if tightest is None else tightest.check,
                    "" if tightest is None else tightest.margin,
                    round(trial.seconds, 3),
                    round(trial.cpu_seconds, 3),
                    trial.message,
                )
            )
        return header, rows
