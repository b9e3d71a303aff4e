"""Method `auto`: the global method first, then what its failure suggests.

A trial is a method with what the spec leaves open chosen in some way, as the module `trials` has
them. The first whose plan passes its verification is taken. Where none does, changes of the spec
are planned with, so that a remedy that is named works, and the refusal says what was tried and what
each lacked. Keys that the spec states are never changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from climbplan.climb.check.verification import verification_of
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.trials import Trial, first_trial, further_trials
from climbplan.climb.postures.explanation import NoPostures
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.loading import LoadedClimb
from climbplan.climb.schema.model import ClimbSpec
from climbplan.errors import (
    Infeasible,
    LimitReached,
    NoPlanFound,
    NotProved,
    Remedy,
    SpecError,
    UsageError,
)
from climbplan.schema.overrides import Override

_FOR_PLANS = 0.7  # share of the time limit for trials; the rest is for remedies
_FIRST = 0.6  # share of that which the global method may use
_EACH = 0.5  # share of what is left that a later trial may use
_AFTER_PROOF = 5  # changes planned with
_REMEDIES = 3  # found before the search for them ends
_LEAST = 0.2  # [s] with less a trial is not begun

ByMethod = Callable[[LoadedClimb, float], ClimbPlan]
"""Plans a climb by the method of its spec until a deadline (`time.monotonic` [s])."""


@dataclass(frozen=True)
class Tried:
    """What became of a trial."""

    trial: Trial
    error: NoPlanFound
    seconds: float

    @property
    def lacked(self) -> str:
        """In one line, with the first of several conflicts."""
        text = self.error.message.partition("\n")[0]
        if self.error.conflicts:
            text += f"; {str(self.error.conflicts[0]).partition(';')[0]}"
        return text

    def __str__(self) -> str:
        return f"{self.trial.name} ({self.seconds:.1f} s): {self.lacked}"


class Refused(NotProved):
    """No trial led to a plan, which proves nothing; says what each lacked and what would help."""

    def __init__(self, tried: Sequence[Tried], remedies: Sequence[Remedy], late: bool) -> None:
        from climbplan.climb.planner.remedies import listed

        first = tried[0].error
        lines = [first.message.partition("\n")[0]]
        # What a conflict names would mend what failed there; other postures may do with less
        shown = [replace(conflict, tried=True) for conflict in first.conflicts[:_SHOWN]]
        lines += [f"  {_plain(str(conflict))}" for conflict in shown]
        lines.append(f"tried {len(tried)} way{'s' if len(tried) > 1 else ''}:")
        lines += [f"  {_plain(str(one))}" for one in tried]
        if late:
            lines.append("the time limit ended the search for a plan: more of it may help")
        lines += listed(remedies)
        because = first.because if isinstance(first, NotProved) else "a limit was reached"
        super().__init__("\n".join(lines), because=because, stage=first.stage, remedies=remedies)
        self.conflicts = [replace(c, remedies=()) for c in first.conflicts]
        self.tried = tuple(tried)


_SHOWN = 6  # conflicts of the first trial


def _plain(text: str) -> str:
    return text.replace("\n", " ")


@dataclass
class Search:
    """The trials of one climb."""

    loaded: LoadedClimb
    plan: ByMethod
    begin: float = field(default_factory=time.monotonic)
    tried: list[Tried] = field(default_factory=list)
    failing: ClimbPlan | None = None  # the first plan that failed its verification

    @property
    def limit(self) -> float:
        """Time limit of the whole search [s]."""
        return float(self.loaded.spec.solver.time_limit)

    def left(self, share: float = 1.0) -> float:
        """Seconds until that share of the limit is used."""
        return self.begin + share * self.limit - time.monotonic()

    def attempt(self, trial: Trial, seconds: float) -> ClimbPlan | None:
        """The verified plan of a trial, or None and a line in `tried`."""
        start = time.monotonic()
        try:
            plan = self.plan(prepared(self.loaded, trial), start + seconds)
            verification = verification_of(plan)
            if verification.objection:
                self.failing = self.failing or plan
                raise NotProved(
                    f"the plan {verification.objection}",
                    because=f"method {trial.method} does not state all that is checked",
                    stage="verify",
                )
        except (UsageError, SpecError) as error:
            if not self.tried:
                raise
            # A method that cannot state this climb, or a change that the spec cannot have
            refused = NotProved(
                str(error), because=f"method {trial.method} cannot state this climb"
            )
            self.tried.append(Tried(trial, refused, time.monotonic() - start))
            return None
        except NoPlanFound as error:
            self.tried.append(Tried(trial, error, time.monotonic() - start))
            return None
        return plan


def prepared(loaded: LoadedClimb, trial: Trial) -> LoadedClimb:
    """The climb with a trial's choices in its text, and its method, which the text leaves open."""
    chosen = loaded.with_overrides(trial.choices) if trial.choices else loaded
    solver = chosen.spec.solver.model_copy(update={"method": trial.method})
    return replace(chosen, spec=chosen.spec.model_copy(update={"solver": solver}))


def plan_automatically(
    loaded: LoadedClimb, scene: Callable[[ClimbSpec], ClimbScene], plan: ByMethod
) -> ClimbPlan:
    """The plan of the first trial that leads to one; its warnings tell what was chosen.

    scene: of a spec, to see what methods it admits. Raises Infeasible where it is proved that there
    is no plan, and Refused where no trial led to one. A plan that fails its verification is
    returned where no other was found.
    """
    from climbplan.climb.planner.proof import PROOF_SHARE, proof_of_infeasibility
    from climbplan.climb.planner.remedies import candidates

    search = Search(loaded, plan)
    here = scene(loaded.spec)
    first = first_trial(here)
    # Windows try the methods themselves: other trials have little to add
    share = _FOR_PLANS * (1.0 if first.method == "auto" else _FIRST)
    found = search.attempt(first, share * search.limit)
    if found is not None:
        return found
    error = search.tried[0].error
    proof = proof_of_infeasibility(here, time.monotonic() + PROOF_SHARE * search.limit)
    if proof is not None:
        changes = list(candidates(here, proof.remedies))[:_AFTER_PROOF]
        raise _with_changes(proof, tuple(_that_work(search, here, changes))) from error
    late = False
    for trial in further_trials(here, error):
        left = search.left(_FOR_PLANS)
        if left < _LEAST:
            late = True
            break
        found = search.attempt(trial, max(_EACH * left, _LEAST))
        if found is not None:
            return _told(found, trial, search.tried[0])
    if search.failing is not None:
        return search.failing  # better than none: it is written, and marked as failing
    tried = tuple(search.tried)
    if all(isinstance(one.error, LimitReached) for one in tried):
        late = True
    named = [r for one in tried if isinstance(one.error, NoPostures) for r in one.error.changes]
    named += [r for one in tried for r in one.error.remedies]
    raise Refused(tried, tuple(_that_work(search, here, candidates(here, named))), late)


def _told(plan: ClimbPlan, trial: Trial, first: Tried) -> ClimbPlan:
    """The plan with a word on how it came about."""
    note = f"found by {trial.name}; by {first.trial.name} not: {first.lacked}"
    return replace(plan, warnings=(note, *plan.warnings))


def _with_changes(proof: Infeasible, remedies: Sequence[Remedy]) -> Infeasible:
    """The proof with the changes that lead to a plan; those of its own are only needed."""
    from climbplan.climb.planner.remedies import listed

    if not remedies:
        return proof
    lines = [proof.message, *listed(remedies)]
    conflicts = [replace(conflict, remedies=()) for conflict in proof.conflicts]
    return Infeasible("\n".join(lines), conflicts, stage=proof.stage, remedies=remedies)


def _that_work(search: Search, scene: ClimbScene, changes: Iterable[Remedy]) -> Iterator[Remedy]:
    """Those changes of the spec with which a plan was found and verified."""
    from climbplan.climb.planner.remedies import as_tried

    count = 0
    for remedy in changes:
        left = search.left()
        if left < _LEAST or count == _REMEDIES:
            return
        # With the method that would be tried first on the changed spec
        choice = Override(remedy.key, remedy.yaml, remedy.option)
        trial = replace(first_trial(scene), name=remedy.words, choices=(choice,))
        if search.attempt(trial, max(_EACH * left, _LEAST)) is not None:
            count += 1
            yield as_tried(remedy)
