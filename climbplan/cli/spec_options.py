"""Command options that stand for a key of the spec."""

from __future__ import annotations

from collections.abc import Sequence

from climbplan.climb.schema.model import SolverSpec
from climbplan.errors import UsageError
from climbplan.schema.fields import find_closest_name, find_slot
from climbplan.schema.overrides import Override

Given = tuple[str, str, str | float | None]
"""Key of the spec, option that stands for it, value; None if the option is left out."""


def key_overrides(assignments: Sequence[str] | None, *options: Given) -> list[str | Override]:
    """`--set` and options that stand for a key, the latter last and so the stronger."""
    overrides: list[str | Override] = list(assignments or ())
    for key, option, value in options:
        if value is not None:
            text = f".{value}" if value != value else str(value)  # YAML's NaN is `.nan`
            overrides.append(Override(key, text, f"{option} {value}"))
    return overrides


def spec_overrides(
    assignments: Sequence[str] | None,
    seed: int | None = None,
    time_limit: float | None = None,
    method: str | None = None,
    solvers: Sequence[str] | None = None,
    solver: str | None = None,
) -> list[str | Override]:
    """`key_overrides` of the planning commands.

    solvers: of a climb, each for the problem that knows it; solver: of kinds with one problem.

    Raises:
        UsageError: a solver that neither the posture nor the force problem knows.
    """
    return [
        *key_overrides(
            assignments,
            ("seed", "--seed", seed),
            ("solver.time_limit", "--time-limit", time_limit),
            ("solver.method", "--method", method),
            ("solver.solver", "--solver", solver),
        ),
        *(Override(_solver_key(name), name, f"--solver {name}") for name in solvers or ()),
    ]


def _solver_key(name: str) -> str:
    """Return the first key of `solver` that accepts a solver of this name."""
    accepted = {}
    for key in ("posture_solver", "force_solver", "mip_solver"):
        slot = find_slot(SolverSpec, (key,))
        accepted[key] = slot.choices if slot is not None else ()
        if name in accepted[key]:
            return f"solver.{key}"
    suggestion = find_closest_name(name, [name for names in accepted.values() for name in names])
    raise UsageError(
        f"--solver {name}: no such solver; "
        f"posture problem: {', '.join(accepted['posture_solver'])}; "
        f"force problem: {', '.join(accepted['force_solver'])}; "
        f"mixed-integer program: {', '.join(accepted['mip_solver'])}"
        + (f" (did you mean {suggestion!r}?)" if suggestion else "")
    )
