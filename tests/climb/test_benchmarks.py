"""Benchmarks run and print their tables; their figures are not judged."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import TextIO

import pytest

from benchmarks.climb.coupled import bench_coupled
from benchmarks.climb.plan import bench_plan
from benchmarks.climb.posture import bench_growth, bench_posture, published_scene
from climbplan.climb.postures.statement import build_posture_program


def table(measure: Callable[[int, bool, TextIO], None]) -> str:
    out = io.StringIO()
    measure(0, True, out)
    return out.getvalue()


def test_growth_has_a_row_for_each_size_and_ratios_to_one() -> None:
    text = table(bench_growth)
    rows = [line.split() for line in text.splitlines()[1:]]
    assert [(int(r[0]), int(r[1])) for r in rows] == [(2, 6), (4, 6), (8, 6), (8, 4)]
    assert float(rows[2][-1]) == 1.0
    assert [int(r[3]) for r in rows] == [36, 72, 144, 96]
    assert all(float(r[-2]) <= 1e-4 for r in rows)


@pytest.mark.slow
def test_whole_plan_lists_its_stages() -> None:
    text = table(bench_plan)
    for stage in ("posture", "kinematics", "force", "plan"):
        assert re.search(rf"^{stage} +\d", text, re.MULTILINE), text


@pytest.mark.slow
def test_posture_is_compared_with_scip() -> None:
    text = table(bench_posture)
    assert len(re.findall(r"^goal \d, 144 binaries", text, re.MULTILINE)) == 2
    assert "ratio SCIP / ours" in text


def test_published_setting_has_its_published_size() -> None:
    """Table 5.1: 144 binaries; 104 balls beside those of the goal; 144 + 48 coordinates."""
    counts = build_posture_program(published_scene(0)).counts()
    assert counts["continuous"] == 192
    assert counts["binary"] == 144
    goal = counts["by_block"]["goal.com"] + counts["by_block"]["goal.toes"]
    assert counts["balls"] - goal == 104
    assert build_posture_program(published_scene(0, free_sides=True)).counts()["binary"] == 288


@pytest.mark.slow
def test_coupled_stages_are_faster_than_a_modelling_layer_and_agree() -> None:
    text = table(bench_coupled)
    costs = [float(c) for c in re.findall(r"\d+\.\d +\d+\.\d +(0\.\d+)$", text, re.MULTILINE)]
    assert len(costs) == 4
    assert max(costs) - min(costs) <= 2e-5
    assert re.search(r"^coupled +\d of 2", text, re.MULTILINE)
