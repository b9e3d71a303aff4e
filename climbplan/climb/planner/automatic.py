"""Plan by method `auto`: a sequence of trials, each planned and verified.

A trial is a method together with choices of what the spec leaves open (see the module `trials`).
The global method comes first; the failure of one trial decides which trials follow. The first plan
that passes its verification is returned. Where no trial succeeds, changes of the spec are planned
with, so that every remedy in the error message is known to work. Keys that the spec states are
never changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.motion.open_rounds import PartialClimb
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.trials import (
    MethodVariant,
    generate_further_trials,
    select_first_trial,
)
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import (
    Infeasible,
    LimitReached,
    NoPlanFound,
    Remedy,
    SpecError,
    Unresolved,
    UsageError,
)
from climbplan.schema.overrides import Override

_TRIAL_FRACTION = 0.7  # share of the time limit for trials; the rest is for remedies
_FIRST_TRIAL_FRACTION = 0.6  # share of that which the global method may use
_FURTHER_TRIAL_FRACTION = 0.5  # share of what is left that a later trial may use
_MAX_CHANGES_AFTER_PROOF = 5  # changes planned with
_MAX_REMEDIES = 3  # found before the search for them ends
_MIN_TRIAL_TIME = 0.2  # [s] with less a trial is not begun

PlanByMethod = Callable[[LoadedClimb, float], ClimbPlan]
"""Plans a climb by the method of its spec until a deadline (`time.monotonic` [s])."""


@dataclass(frozen=True)
class FailedTrial:
    """A trial that led to no verified plan, with its error and duration."""

    trial: MethodVariant
    error: NoPlanFound
    seconds: float

    @property
    def failure_summary(self) -> str:
        """Return the first line of the error and its first conflict."""
        text = self.error.message.partition("\n")[0]
        if self.error.conflicts:
            text += f"; {str(self.error.conflicts[0]).partition(';')[0]}"
        return text

    def __str__(self) -> str:
        return f"{self.trial.name} ({self.seconds:.1f} s): {self.failure_summary}"


class NoTrialSucceeded(Unresolved):
    """The error of method `auto` when no trial led to a plan, which proves nothing.

    Its message lists why each trial failed and which changes of the spec lead to a plan.
    """

    def __init__(
        self,
        failed_trials: Sequence[FailedTrial],
        verified_remedies: Sequence[Remedy] | None,
        time_ran_out: bool,
    ) -> None:
        """Describe the failed trials.

        Args:
            failed_trials: In the order in which they were tried; at least one.
            verified_remedies: Changes with which a plan was found and verified; None where none
                were sought, so that conflicts keep the changes that they name themselves.
            time_ran_out: Whether the time limit ended the search.
        """
        from climbplan.climb.planner.remedies import add_verified_change, format_remedies

        first, remedies = failed_trials[0].error, verified_remedies or ()
        headline, _, details = first.message.partition("\n")[0].partition("; ")
        lines = [add_verified_change(headline, remedies), *([details] if details else [])]
        # What a conflict names would mend what failed there; other postures may do with less
        shown_conflicts = [
            replace(conflict, tried=True) for conflict in first.conflicts[:_MAX_CONFLICTS]
        ]
        lines += [f"  {_join_lines(str(conflict))}" for conflict in shown_conflicts]
        if len(failed_trials) > 1:
            lines.append(f"tried {len(failed_trials)} ways:")
            lines += [f"  {_join_lines(str(trial))}" for trial in failed_trials]
        if time_ran_out:
            lines.append("the time limit ended the search for a plan: more of it may help")
        lines += format_remedies(remedies)
        reason = first.because if isinstance(first, Unresolved) else "a limit was reached"
        super().__init__("\n".join(lines), because=reason, stage=first.stage, remedies=remedies)
        self.conflicts = [
            replace(conflict, tried=True)
            if verified_remedies is None
            else replace(conflict, remedies=())
            for conflict in first.conflicts
        ]
        self.tried = tuple(failed_trials)
        partials = [failure.error.partial for failure in failed_trials]
        climbs = [partial for partial in partials if isinstance(partial, PartialClimb)]
        self.partial = max(climbs, key=lambda climb: climb.covered / climb.length, default=None)


_MAX_CONFLICTS = 6  # conflicts of the first trial


def _join_lines(text: str) -> str:
    return text.replace("\n", " ")


@dataclass
class TrialSearch:
    """The trials of one climb: loaded spec, time budget and the failures so far."""

    loaded: LoadedClimb
    plan: PlanByMethod
    begin: float = field(default_factory=time.monotonic)
    failed_trials: list[FailedTrial] = field(default_factory=list)
    unverified_plan: ClimbPlan | None = None  # the first plan that failed its verification

    @property
    def limit(self) -> float:
        """Return the time limit of the whole search [s]."""
        return float(self.loaded.spec.solver.time_limit)

    def remaining_time(self, fraction: float = 1.0) -> float:
        """Return the time [s] until the given fraction of the time limit is used."""
        return self.begin + fraction * self.limit - time.monotonic()

    def plan_and_verify(self, trial: MethodVariant, seconds: float) -> ClimbPlan | None:
        """Return the verified plan of a trial, or None after recording the failure."""
        start = time.monotonic()
        try:
            plan = self.plan(apply_choices(self.loaded, trial), start + seconds)
            verification = verify_plan(plan)
            if verification.objection:
                self.unverified_plan = self.unverified_plan or plan
                raise Unresolved(
                    f"the plan {verification.objection}",
                    because=f"method {trial.method} does not state all that is checked",
                    stage="verify",
                )
        except (UsageError, SpecError) as error:
            if not self.failed_trials:
                raise
            # A method that cannot state this climb, or a change that the spec cannot have
            failure = Unresolved(
                str(error), because=f"method {trial.method} cannot state this climb"
            )
            self.failed_trials.append(FailedTrial(trial, failure, time.monotonic() - start))
            return None
        except NoPlanFound as error:
            self.failed_trials.append(FailedTrial(trial, error, time.monotonic() - start))
            return None
        return plan


def apply_choices(loaded: LoadedClimb, trial: MethodVariant) -> LoadedClimb:
    """Return the climb with a trial's choices in its text, and with its method.

    The text leaves the method open, so that the method is set in the parsed spec alone.
    """
    with_choices = loaded.with_overrides(trial.choices) if trial.choices else loaded
    solver = with_choices.spec.solver.model_copy(update={"method": trial.method})
    return replace(with_choices, spec=with_choices.spec.model_copy(update={"solver": solver}))


def plan_automatically(
    loaded: LoadedClimb,
    scene: Callable[[ClimbSpec], ClimbScene],
    plan: PlanByMethod,
    seek_remedies: bool = True,
) -> ClimbPlan:
    """Return the plan of the first trial that leads to one; its notes say what was chosen.

    Args:
        loaded: Spec of the climb, with method `auto`.
        scene: Builds the scene of a spec, which decides what methods can state the climb.
        plan: Plans a climb by the method of its spec until a deadline.
        seek_remedies: Whether changed specs are planned where there is no plan.

    Returns:
        A verified plan, or a plan that failed its verification where no other was found.

    Raises:
        Infeasible: It is proved that there is no plan.
        NoTrialSucceeded: No trial led to a plan.
    """
    from climbplan.climb.planner.proof import PROOF_TIME_FRACTION, prove_infeasibility
    from climbplan.climb.planner.remedies import generate_candidates

    search = TrialSearch(loaded, plan)
    climb_scene = scene(loaded.spec)
    first = select_first_trial(climb_scene)
    # On long ways other trials have little to add
    is_long = first.method in ("auto", "contact-search")
    fraction = _TRIAL_FRACTION * (1.0 if is_long else _FIRST_TRIAL_FRACTION)
    verified_plan = search.plan_and_verify(first, fraction * search.limit)
    if verified_plan is not None:
        return verified_plan
    error = search.failed_trials[0].error
    proof = prove_infeasibility(climb_scene, time.monotonic() + PROOF_TIME_FRACTION * search.limit)
    if proof is not None:
        changes = generate_candidates(climb_scene, proof.remedies) if seek_remedies else ()
        verified = _verify_changes(search, climb_scene, islice(changes, _MAX_CHANGES_AFTER_PROOF))
        raise _attach_verified_remedies(proof, tuple(verified)) from error
    time_ran_out = False
    for trial in generate_further_trials(climb_scene, error):
        remaining = search.remaining_time(_TRIAL_FRACTION)
        if remaining < _MIN_TRIAL_TIME:
            time_ran_out = True
            break
        verified_plan = search.plan_and_verify(
            trial, max(_FURTHER_TRIAL_FRACTION * remaining, _MIN_TRIAL_TIME)
        )
        if verified_plan is not None:
            return _add_provenance_note(verified_plan, trial, search.failed_trials[0])
    if search.unverified_plan is not None:
        return search.unverified_plan  # better than none: it is written, and marked as failing
    raise _build_failure(search, climb_scene, seek_remedies, time_ran_out)


def _build_failure(
    search: TrialSearch, scene: ClimbScene, seek_remedies: bool, time_ran_out: bool
) -> NoTrialSucceeded:
    """Return the error of trials that all failed, with the changes with which there is a plan."""
    from climbplan.climb.planner.remedies import generate_candidates

    failed_trials = tuple(search.failed_trials)
    if all(isinstance(failure.error, LimitReached) for failure in failed_trials):
        time_ran_out = True
    remedies: tuple[Remedy, ...] | None = None
    if seek_remedies:
        candidates = generate_candidates(scene, _collect_suggestions(failed_trials))
        remedies = tuple(_verify_changes(search, scene, candidates))
    return NoTrialSucceeded(failed_trials, remedies, time_ran_out)


def _collect_suggestions(failed_trials: Iterable[FailedTrial]) -> list[Remedy]:
    """Return the changes that failures suggest, first those of posture programs."""
    errors = [failure.error for failure in failed_trials]
    changes = [r for error in errors if isinstance(error, NoPostures) for r in error.changes]
    return changes + [r for error in errors for r in error.remedies]


def _add_provenance_note(
    plan: ClimbPlan, trial: MethodVariant, first_trial_failure: FailedTrial
) -> ClimbPlan:
    """Return the plan with a note that says which trial found it."""
    first_name, reason = first_trial_failure.trial.name, first_trial_failure.failure_summary
    note = f"found by {trial.name}; by {first_name} not: {reason}"
    return replace(plan, notes=(note, *plan.notes))


def _attach_verified_remedies(proof: Infeasible, remedies: Sequence[Remedy]) -> Infeasible:
    """Return the proof with the changes that lead to a plan.

    Remedies named by the proof itself are only necessary conditions, and are dropped.
    """
    from climbplan.climb.planner.remedies import format_remedies

    if not remedies:
        return proof
    message_lines = [proof.message, *format_remedies(remedies)]
    conflicts = [replace(conflict, remedies=()) for conflict in proof.conflicts]
    return Infeasible("\n".join(message_lines), conflicts, stage=proof.stage, remedies=remedies)


def _verify_changes(
    search: TrialSearch, scene: ClimbScene, changes: Iterable[Remedy]
) -> Iterator[Remedy]:
    """Yield the changes of the spec with which a plan was found and verified."""
    from climbplan.climb.planner.remedies import describe_as_planned

    num_verified = 0
    for remedy in changes:
        remaining = search.remaining_time()
        if remaining < _MIN_TRIAL_TIME or num_verified == _MAX_REMEDIES:
            return
        # With the method that would be tried first on the changed spec
        choice = Override(remedy.key, remedy.yaml, remedy.option)
        trial = replace(select_first_trial(scene), name=remedy.words, choices=(choice,))
        if (
            search.plan_and_verify(trial, max(_FURTHER_TRIAL_FRACTION * remaining, _MIN_TRIAL_TIME))
            is not None
        ):
            num_verified += 1
            yield describe_as_planned(remedy)
