"""Footsteps and graphs of convex sets as the benchmark `conic` states them."""

from __future__ import annotations

import io
import warnings
from dataclasses import replace
from itertools import permutations
from typing import Any

import cvxpy
import numpy as np
import pytest

import climbplan
from benchmarks.engine import conic
from benchmarks.engine.stated_problems import (
    STATED_PROBLEMS,
    StatedProblems,
    _draw_boxes,
    state_traveling_salesman,
)

cp: Any = cvxpy  # whose functions have no types
_SMALL = [stated for stated in STATED_PROBLEMS if stated.fits_licence]


@pytest.mark.parametrize(
    "stated",
    [replace(_SMALL[0], sizes={"steps": 5}), *(s for s in _SMALL[1:] if "tour" not in s.name)],
    ids=lambda stated: stated.name,
)
def test_values_are_those_of_scip(stated: StatedProblems) -> None:
    problem = stated.generate(np.random.default_rng(1), **stated.sizes)
    value = problem.solve(solver=climbplan.CVXPY())
    assert problem.status == "optimal"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        best = problem.solve(solver=cp.SCIP, scip_params={"limits/gap": 1e-5})
    assert value == pytest.approx(best, rel=3e-4)


def test_a_tour_is_the_best_of_all_orders() -> None:
    count = 4
    value = state_traveling_salesman(np.random.default_rng(3), count).solve(
        solver=climbplan.CVXPY(gap=1e-6)
    )
    rng = np.random.default_rng(3)
    lower, upper = _draw_boxes(rng, rng.uniform(0.0, 3.0, (count, 2)), 0.4)
    x = cp.Variable((count, 2))
    lengths = []
    for rest in permutations(range(1, count)):
        order = [0, *rest]
        length = cp.sum(cp.norm(x[order] - x[[*rest, 0]], 2, axis=1))
        tour = cp.Problem(cp.Minimize(length), [x >= lower, x <= upper])
        lengths.append(tour.solve(solver=cp.CLARABEL))
    assert value == pytest.approx(min(lengths), rel=1e-5)


def test_a_row_for_each_kind_and_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conic, "QUICK_COUNT", 2)
    monkeypatch.setattr(conic, "STATED_PROBLEMS", _SMALL[1:2])  # steps on stairs
    stream = io.StringIO()
    conic.run_conic(0, True, stream)
    lines = [line.split("  ") for line in stream.getvalue().splitlines()]
    rows = [[cell.strip() for cell in line if cell.strip()] for line in lines][2:]
    rows = [row for row in rows if len(row) == 9 and row[0] != "problem"]
    assert {row[1] for row in rows} >= {"scip", "climbplan", "daqp"}
    for row in rows:
        assert row[4] == "0"  # wrong
        assert row[3] == ("0" if row[1] == "daqp" else row[2])  # proved
        assert float(row[5]) < 1e-3  # cost off by
