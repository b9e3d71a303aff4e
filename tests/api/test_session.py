"""One problem at parameters that change, through the public door."""

from __future__ import annotations

import numpy as np
import pytest
from cart_pole import problem as damped
from cart_pole import springs

import climbplan
from climbplan.errors import UsageError

_START = np.array([0.30, 0.05, 0.3, -0.4])
_WALLS = np.array([0.35, 0.40])


@pytest.mark.slow
@pytest.mark.parametrize("method", ["branch-and-bound", "benders"])
def test_a_session_agrees_with_single_solves(method: str) -> None:
    problem = springs()
    session = climbplan.Session(problem, gap=1e-4, method=method)
    state = _START
    for t in range(8):
        theta = {"start": state, "walls": _WALLS + 0.01 * np.sin(t)}
        warm = session.solve(theta, horizon_shift=int(t > 0))
        cold = climbplan.solve(problem, theta, gap=1e-4)
        assert cold.method_name.startswith("branch-and-bound")
        assert warm.status == cold.status == "optimal"
        assert warm.objective == pytest.approx(cold.objective, rel=2e-4)
        assert warm.gap is not None
        assert warm.gap <= 1e-4
        assert warm.check().passed(1e-6)
        state = warm["state"][1]
    assert "remembered" in warm.candidate
    session.reset()
    assert "remembered" not in session.solve(theta).candidate


def test_a_session_that_may_not_work_long_says_how_far_it_came() -> None:
    problem = springs()
    theta = {"start": np.array([0.30, 0.05, 0.6, -1.4]), "walls": _WALLS}
    best = climbplan.solve(problem, theta, gap=1e-6)
    session = climbplan.Session(problem, gap=1e-6, work=100)
    first = session.solve(theta)
    assert first.status in ("feasible", "limit")
    assert best.objective is not None
    assert first.bound <= best.objective
    for _ in range(4):
        last = session.solve(theta)
        if last.objective is not None:
            assert last.check().passed(1e-6)
            assert last.objective >= best.objective * (1 - 1e-6)
    assert last.status == "optimal"


def test_a_session_remembers_boxes_of_products() -> None:
    problem = damped()
    session = climbplan.Session(problem, gap=1e-3)
    state = _START
    for t in range(4):
        theta = {"start": state, "walls": _WALLS}
        warm = session.solve(theta, horizon_shift=int(t > 0))
        cold = climbplan.solve(problem, theta, gap=1e-3)
        assert warm.status == cold.status == "optimal"
        assert warm.objective == pytest.approx(cold.objective, rel=2e-3)
        assert warm.check().passed(1e-6)
        state = warm["state"][1]
    assert "remembered" in warm.candidate


def test_a_session_refuses_what_the_tree_cannot_hold() -> None:
    session = climbplan.Session(damped(), method="benders")
    with pytest.raises(UsageError, match="by benders, whose memory holds no products"):
        session.solve({"start": _START, "walls": _WALLS})
    with pytest.raises(UsageError, match="branch-and-bound or benders, got 'mpcc'"):
        climbplan.Session(springs(), method="mpcc")
    with pytest.raises(UsageError, match="no setting solver of a session"):
        climbplan.Session(springs(), solver="highs")
    with pytest.raises(UsageError, match="1 dual step or more"):
        climbplan.Session(springs(), work=0)
    with pytest.raises(UsageError, match="0 steps or more"):
        climbplan.Session(springs()).solve({"start": _START, "walls": _WALLS}, horizon_shift=-1)
