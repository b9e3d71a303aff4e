"""Surfaces by an L1 relaxation and rounding, against enumeration and branch and bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_scenes import stepping_scene

from climbplan.program import Polytope, Program
from climbplan.program.instance import Instance
from climbplan.reformulations.slack_relaxation import SlackRelaxation
from climbplan.solvers.convex.sessions import solve_convex
from climbplan.solvers.registry import solve
from climbplan.solvers.result import FEASIBILITY
from climbplan.solvers.slack_selection import MAX_PROGRAMS


def interval(low: float, high: float) -> Polytope:
    return Polytope.halfspaces(
        f"{low} to {high}", np.array([[1.0], [-1.0]]), np.array([high, -low])
    )


def on_a_line(alternatives: list[tuple[float, float]], room: float = 10.0) -> Instance:
    """A point of a line within `room` of 5, in one of some intervals, drawn to 0."""
    p = Program("line")
    x = p.continuous("x", (1,), -20.0, 20.0)
    p.ball("room", np.array([[x[0] - 5.0, 0 * x[0]]]), room)
    p.one_of("where", x[None, :], [[interval(*a) for a in alternatives]])
    p.minimise("cost", x[0] ** 2)
    return p.instantiate()


def test_slacks_are_distances_to_alternatives() -> None:
    instance = on_a_line([(1.0, 2.0), (6.0, 8.0)])
    form = SlackRelaxation().apply(instance)
    assert form.relaxation
    assert form.instance.features == {"balls"}
    for at, slacks in ((1.5, (0.0, 4.5)), (4.0, (2.0, 2.0)), (7.0, (5.0, 0.0))):
        held = replace(
            form.instance,
            lower=np.concatenate([[at], np.zeros(2)]),
            upper=np.concatenate([[at], np.full(2, np.inf)]),
        )
        found = solve_convex(held, "clarabel").x
        assert found is not None
        np.testing.assert_allclose(form.split_slacks(found)[0], slacks, atol=1e-6)
        np.testing.assert_allclose(form.invert(found), [at])


def test_an_equation_is_opened_to_both_sides() -> None:
    p = Program("planes")
    x = p.continuous("x", (1,), -9.0, 9.0)
    none = np.zeros((0, 1)), np.zeros(0)
    planes = [Polytope(f"x = {v}", *none, np.eye(1), np.array([v])) for v in (-2.0, 3.0)]
    p.one_of("where", x[None, :], [planes])
    p.minimise("cost", (x[0] - 1.0) ** 2)
    found = solve(p.instantiate(), "sl1-relaxation")
    assert found.x is not None
    assert found.x[0] in (pytest.approx(-2.0, abs=1e-6), pytest.approx(3.0, abs=1e-6))


@pytest.mark.parametrize("seed", range(12))
def test_what_is_found_is_feasible_and_no_better_than_the_best(seed: int) -> None:
    instance = stepping_scene(seed).instantiate()
    best = solve(instance, "branch-and-bound", gap=1e-6)
    found = solve(instance, "sl1-relaxation")
    if best.status == "infeasible":
        assert found.x is None
        assert found.status == "limit"  # rounding proves nothing
        return
    assert found.bound == -np.inf
    if found.x is None:
        assert "settles" in found.log[-1]
        return
    assert found.assignment is not None
    assert instance.violation(found.x, found.assignment) <= FEASIBILITY
    assert best.objective is not None
    assert found.objective is not None
    assert found.objective >= best.objective * (1 - 1e-5) - 1e-9


def test_it_finds_most_of_what_there_is_and_says_what_settled_it() -> None:
    both = [
        (solve(i, "branch-and-bound"), solve(i, "sl1-relaxation"))
        for i in (stepping_scene(seed).instantiate() for seed in range(12))
    ]
    there = [(b, f) for b, f in both if b.x is not None]
    assert len(there) >= 6
    assert sum(f.x is not None for _, f in there) >= 0.7 * len(there)
    assert all("convex programs, the first" in f.log[-1] for _, f in both)


def test_what_no_alternative_allows_is_not_found() -> None:
    found = solve(on_a_line([(-9.0, -8.0), (18.0, 19.0)], room=1.0), "sl1-relaxation")
    assert found.x is None
    assert found.status == "limit"
    assert "all that was left open is tried" in found.log[-1]


def test_work_is_bounded() -> None:
    # Every pair of neighbours excludes the other: nothing is settled, all is enumerated
    p = Program("apart")
    x = p.continuous("x", (12,), 0.0, 1.0)
    p.one_of("end", x[:, None], [[interval(0.0, 0.1), interval(0.9, 1.0)]] * 12)
    p.between("half", np.array([np.sum(x)]), 6.0 - 1e-3 - 0.55, 6.0 - 0.55)
    p.minimise("cost", np.sum(x**2))
    found = solve(p.instantiate(), "sl1-relaxation")
    assert found.nodes <= MAX_PROGRAMS + 5
