"""Changes of a refused transition with which a plan was found, so that a remedy named works."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.remedies import as_tried, listed
from climbplan.climb.schema.transition import TransitionSpec
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.errors import NoPlanFound, NotProved, Remedy, SpecError, UsageError
from climbplan.schema.overrides import Override

_MORE_ROUNDS = (1, 2)
_ASIDE = 0.12  # [m]
_LEAST = 0.2  # [s] with less a change is not planned with
_EACH = 0.5  # share of what is left that one may use
_NAMED = 3  # changes looked for
_MOST = 12  # planned with


def with_remedies(
    loaded: LoadedTransition,
    error: NoPlanFound,
    plan: Callable[[LoadedTransition], ClimbPlan],
    deadline: float,
) -> NotProved:
    """The refusal with the changes of the spec that lead to a plan.

    plan: raises NoPlanFound, or returns a verified plan. deadline: `time.monotonic` [s] at which
    the search for changes ends.
    """
    found: list[Remedy] = []
    for remedy in list(candidates(loaded.spec, error))[:_MOST]:
        left = deadline - time.monotonic()
        if left < _LEAST or len(found) == _NAMED:
            break
        changes = (
            Override(remedy.key, remedy.yaml, remedy.option),
            # The search is the quicker method; what it does not find is no remedy that is named
            Override("solver.method", "enumerate", "--method enumerate"),
            Override("solver.time_limit", f"{max(_EACH * left, _LEAST):.3f}", "--time-limit"),
        )
        try:
            plan(loaded.with_overrides(changes))
        except (NoPlanFound, SpecError, UsageError):  # or a change that the spec cannot have
            continue
        found.append(as_tried(remedy))
    return NotProved(
        "\n".join([error.message, *listed(found)]),
        [replace(conflict, remedies=()) for conflict in error.conflicts],
        because=error.because if isinstance(error, NotProved) else "a limit was reached",
        stage=error.stage,
        remedies=found,
    )


def candidates(spec: TransitionSpec, error: NoPlanFound) -> Iterator[Remedy]:
    """Changes worth planning with: what the failure named, then what the search leaves out."""
    named = [*error.remedies, *(r for conflict in error.conflicts for r in conflict.remedies)]
    yield from dict.fromkeys(remedy for remedy in named if remedy.key)
    task, search = spec.task, spec.search
    if search.between != "any":
        yield Remedy("footholds on any surface between start and goal", "search.between", "any")
    if task.sequence is not None:
        yield Remedy("any sequence", "task.sequence", "null")
    else:
        for extra in _MORE_ROUNDS:
            rounds = task.rounds + extra
            yield Remedy(f"{rounds} rounds", "task.rounds", rounds)
    if search.aside < _ASIDE:
        yield Remedy("poses farther beside the straight way", "search.aside", _ASIDE)
    for key, words, value in (
        ("force.safety_friction", "S_mu of 1", spec.force.safety_friction),
        ("force.safety_torque", "S_tau of 1", spec.force.safety_torque),
    ):
        if value > 1:
            yield Remedy(words, key, 1.0)
