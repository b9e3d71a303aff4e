"""Least pressure of toes: kept by every solver, named in conflicts, checked from the file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.arrays import Array
from climbplan.climb.check.verification import verify
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.solving import solve_forces
from climbplan.climb.forces.statement import build_force_statement, check_forces, compute_objective
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.loading import load_text
from climbplan.errors import Unresolved

SceneMaker = Callable[..., ClimbScene]
ASKED = 20.0  # [N]
SPEC = """
kind: climb
robot: silvia
terrain: {friction: 1.0, walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.4]}}
task: {rounds: 1, start: {com: [0, 0, 0]}, goal: {com: [0, 0, 0.05]}}
"""


def pressures(instants: Instants, force: Array) -> Array:
    """(P,) of the toes in contact."""
    return np.einsum("kni,kni->kn", force, instants.normal)[instants.contact]


@pytest.mark.parametrize("solver", ["daqp", "clarabel"])
def test_every_toe_presses(demo_climb: SceneMaker, demo_instants: Instants, solver: str) -> None:
    free, bound = (demo_climb(**{"force.min_normal_force": least}) for least in (0.0, ASKED))
    loose = plan_forces(free, demo_instants, solver)
    assert pressures(demo_instants, loose.force).min() < ASKED - 1
    held = plan_forces(bound, demo_instants, solver)
    assert pressures(demo_instants, held.force).min() >= ASKED - 1e-4
    statement = build_force_statement(bound, demo_instants)
    assert check_forces(statement, held.force).worst.max() < 1e-7
    assert check_forces(statement, loose.force).contact.max() > 1e-3
    # A constraint costs, if anything.
    dearer = compute_objective(statement, held.force) - compute_objective(statement, loose.force)
    assert dearer.min() > -1e-6
    assert dearer.max() > 1e-4


def test_solvers_agree(demo_climb: SceneMaker, demo_instants: Instants) -> None:
    statement = build_force_statement(
        demo_climb(**{"force.min_normal_force": ASKED}), demo_instants
    )
    costs = [
        compute_objective(statement, solve_forces(statement, solver, 16).force)
        for solver in ("daqp", "clarabel")
    ]
    np.testing.assert_allclose(costs[0], costs[1], rtol=4e-3)


def test_conflict_names_the_pressure(demo_climb: SceneMaker, demo_instants: Instants) -> None:
    with pytest.raises(Unresolved, match="pressure of 500 N at") as caught:
        plan_forces(demo_climb(**{"force.min_normal_force": 500.0}), demo_instants)
    assert "push-only" not in str(caught.value)


def test_file_is_checked_against_its_spec(tmp_path: Path) -> None:
    plan = plan_climb(load_text(SPEC, "short", ["force.min_normal_force=8"]))
    assert pressures(plan.instants, plan.forces.force).min() >= 8 - 1e-4
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    assert verify(path).passed
    text = plan.spec_text.replace("min_normal_force: 8", "min_normal_force: 90")
    assert text != plan.spec_text
    more = replace(plan, spec_text=text, spec_sha256=hashlib.sha256(text.encode()).hexdigest())
    write_climb(more, path)
    assert any("min_normal_force" in check.worst_at for check in verify(path).failed)
