"""Command options that stand for a key of the spec."""

from __future__ import annotations

from collections.abc import Sequence

from climbplan.climb.schema.model import SolverSpec
from climbplan.errors import UsageError
from climbplan.schema.fields import nearest, slot_at
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
    """`solver.posture`, `solver.force` or `solver.mixed`, the first that accepts this solver."""
    accepted = {}
    for key in ("posture", "force", "mixed"):
        slot = slot_at(SolverSpec, (key,))
        accepted[key] = slot.choices if slot is not None else ()
        if name in accepted[key]:
            return f"solver.{key}"
    near = nearest(name, [name for names in accepted.values() for name in names])
    raise UsageError(
        f"--solver {name}: no such solver; posture problem: {', '.join(accepted['posture'])}; "
        f"force problem: {', '.join(accepted['force'])}; "
        f"mixed-integer program: {', '.join(accepted['mixed'])}"
        + (f" (did you mean {near!r}?)" if near else "")
    )
