"""Find changes of an infeasible spec with which a plan exists, by planning with each of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.remedies import (
    add_verified_change,
    describe_as_planned,
    format_remedies,
)
from climbplan.climb.schema.transition import TransitionSpec
from climbplan.climb.schema.transition_loading import LoadedTransition
from climbplan.errors import NoPlanFound, Remedy, SpecError, Unresolved, UsageError
from climbplan.schema.overrides import Override

_EXTRA_ROUNDS = (1, 2)
_LATERAL_OFFSET = 0.12  # [m]
_MIN_TIME = 0.2  # [s] with less a change is not planned with
_TIME_FRACTION = 0.5  # share of what is left that one may use
_MAX_REMEDIES = 3  # changes looked for
_MAX_CANDIDATES = 12  # planned with


def find_remedies(
    loaded: LoadedTransition,
    error: NoPlanFound,
    plan: Callable[[LoadedTransition], ClimbPlan],
    deadline: float,
) -> Unresolved:
    """Find changes of a spec that lead to a plan, and return the failure with them.

    Args:
        loaded: The spec.
        error: The failure without changes.
        plan: Raises NoPlanFound, or returns a verified plan.
        deadline: Time in `time.monotonic` seconds at which the search for changes ends.
    """
    remedies: list[Remedy] = []
    for remedy in list(list_candidates(loaded.spec, error))[:_MAX_CANDIDATES]:
        remaining = deadline - time.monotonic()
        if remaining < _MIN_TIME or len(remedies) == _MAX_REMEDIES:
            break
        changes = (
            Override(remedy.key, remedy.yaml, remedy.option),
            # The search is the quicker method; what it does not find is no remedy that is named
            Override("solver.method", "stance-search", "--method stance-search"),
            Override(
                "solver.time_limit",
                f"{max(_TIME_FRACTION * remaining, _MIN_TIME):.3f}",
                "--time-limit",
            ),
        )
        try:
            plan(loaded.with_overrides(changes))
        except (NoPlanFound, SpecError, UsageError):  # or a change that the spec cannot have
            continue
        remedies.append(describe_as_planned(remedy))
    headline, newline, details = error.message.partition("\n")
    headline = add_verified_change(headline, remedies)
    return Unresolved(
        "\n".join([headline + newline + details, *format_remedies(remedies)]),
        [replace(conflict, remedies=()) for conflict in error.conflicts],
        because=error.because if isinstance(error, Unresolved) else "a limit was reached",
        stage=error.stage,
        remedies=remedies,
    )


def list_candidates(spec: TransitionSpec, error: NoPlanFound) -> Iterator[Remedy]:
    """List changes worth planning with: those of the failure, then what the search leaves out."""
    named = [*error.remedies, *(r for conflict in error.conflicts for r in conflict.remedies)]
    yield from dict.fromkeys(remedy for remedy in named if remedy.key)
    task, search = spec.task, spec.search
    if search.between != "any":
        yield Remedy("footholds on any surface between start and goal", "search.between", "any")
    if task.sequence is not None:
        yield Remedy("any sequence", "task.sequence", "null")
    else:
        for extra in _EXTRA_ROUNDS:
            rounds = task.rounds + extra
            yield Remedy(f"{rounds} rounds", "task.rounds", rounds)
    if search.lateral_offset < _LATERAL_OFFSET:
        yield Remedy(
            "poses farther beside the straight way", "search.lateral_offset", _LATERAL_OFFSET
        )
    for key, text, value in (
        ("force.safety_friction", "S_mu of 1", spec.force.safety_friction),
        ("force.safety_torque", "S_tau of 1", spec.force.safety_torque),
    ):
        if value > 1:
            yield Remedy(text, key, 1.0)
