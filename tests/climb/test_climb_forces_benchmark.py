"""The comparison of force solvers prints what it promises."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest

from benchmarks.climb import force as benchmark_force
from benchmarks.climb.force import bench_force
from climbplan.errors import MissingSolver
from climbplan.instances.straight_climb import build_straight_climb


def test_quick_comparison_prints_ratios_and_agreement() -> None:
    pytest.importorskip("cvxpy")
    out = io.StringIO()
    bench_force(0, True, out)
    text = out.getvalue()
    for name in ("eliminated, 16 facets, DAQP", "exact cones, Clarabel", "CVXPY", "Gurobi"):
        assert name in text
    off = [float(v) for v in re.findall(r"(\d\.\de[-+]\d\d)$", text, re.MULTILINE)]
    assert len(off) == 4
    assert off[0] < 4e-3
    assert max(off[1:]) < 2e-5
    assert "960.0" in text


def test_missing_cvxpy_is_said_and_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(problem: object) -> None:
        raise MissingSolver("CVXPY is not installed: pip install 'climbplan[bench]'")

    monkeypatch.setattr(benchmark_force, "solve_cvxpy", missing)
    out = io.StringIO()
    bench_force(1, True, out)
    assert "left out: CVXPY is not installed" in out.getvalue()


def test_instances_follow_the_seed() -> None:
    one, same, other = (
        build_straight_climb(3).instants,
        build_straight_climb(3).instants,
        build_straight_climb(4).instants,
    )
    assert one.count == 96
    np.testing.assert_array_equal(one.toes, same.toes)
    assert np.abs(one.toes - other.toes).max() > 1e-3
