"""Commands that press inward: kept by every solver, named in conflicts, checked from the file."""

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
from climbplan.climb.forces.statement import (
    ForceStatement,
    build_force_statement,
    check_forces,
    compute_commands,
    compute_objective,
)
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.climb.schema.loading import load_climb, load_text
from climbplan.errors import Unresolved
from climbplan.robots.kinematics import toe_world

SceneMaker = Callable[..., ClimbScene]
ASKED = 0.02  # [m]
SPEC = """
kind: climb
robot: silvia
terrain: {friction: 1.0, walls: {gap: 1.23, along: [-0.8, 0.8], up: [-0.8, 1.4]}}
task: {rounds: 1, start: {com: [0, 0, 0]}, goal: {com: [0, 0, 0.05]}}
"""


def depths(statement: ForceStatement, force: Array) -> Array:
    """(P,) of the commands of toes in contact by the rows of the statement [m]."""
    return np.einsum("kiml,kml->ki", statement.penetration_per_force, force)[statement.contact]


@pytest.mark.parametrize("sag", ["compensated", "predicted"])
def test_rows_are_where_commands_put_toes(
    demo_climb: SceneMaker, demo_instants: Instants, sag: str
) -> None:
    scene = demo_climb(**{"force.deflection_compensation": sag})
    statement = build_force_statement(scene, demo_instants)
    slight = 1e-3 * plan_forces(scene, demo_instants).force  # within the first order
    commanded = toe_world(
        scene.robot, demo_instants.com, demo_instants.rpy, compute_commands(statement, slight)
    )
    moved = np.einsum("kni,kni->kn", demo_instants.toes - commanded, demo_instants.normal)
    np.testing.assert_allclose(
        depths(statement, slight), moved[statement.contact], atol=1e-7, rtol=1e-2
    )


@pytest.mark.parametrize("solver", ["daqp", "clarabel"])
def test_every_command_is_inside(
    demo_climb: SceneMaker, demo_instants: Instants, solver: str
) -> None:
    free, bound = (demo_climb(**{"force.min_penetration": least}) for least in (None, ASKED))
    statement = build_force_statement(bound, demo_instants)
    loose = plan_forces(free, demo_instants, solver)
    assert depths(statement, loose.force).min() < ASKED - 1e-3
    held = plan_forces(bound, demo_instants, solver)
    assert depths(statement, held.force).min() >= ASKED - 1e-7
    assert check_forces(statement, held.force).worst.max() < 1e-7
    assert check_forces(statement, loose.force).inward.max() > 1e-3
    dearer = compute_objective(statement, held.force) - compute_objective(statement, loose.force)
    assert dearer.min() > -1e-6
    assert dearer.max() > 1e-4


def test_solvers_agree(demo_climb: SceneMaker, demo_instants: Instants) -> None:
    statement = build_force_statement(demo_climb(**{"force.min_penetration": ASKED}), demo_instants)
    costs = [
        compute_objective(statement, solve_forces(statement, solver, 16).force)
        for solver in ("daqp", "clarabel")
    ]
    np.testing.assert_allclose(costs[0], costs[1], rtol=4e-3)


def test_conflict_names_the_depth(demo_climb: SceneMaker, demo_instants: Instants) -> None:
    with pytest.raises(Unresolved, match="command 500 mm inside its surface of"):
        plan_forces(demo_climb(**{"force.min_penetration": 0.5}), demo_instants)


def test_file_is_checked_against_its_spec(tmp_path: Path) -> None:
    plan = plan_climb(load_text(SPEC, "short", ["force.min_penetration=0.004"]))
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    good = verify(path)
    assert good.passed
    (check,) = [c for c in good.checks if c.name == "force.penetration"]
    least = float(check.margin.split(" mm")[0])
    assert least >= 4.0
    text = plan.spec_text.replace(
        "min_penetration: 0.004", f"min_penetration: {least / 1e3 + 1e-3:.4f}"
    )
    assert text != plan.spec_text
    more = replace(plan, spec_text=text, spec_sha256=hashlib.sha256(text.encode()).hexdigest())
    write_climb(more, path)
    assert [c.name for c in verify(path).failed] == ["force.penetration"]


def test_commands_outside_are_told_where_nothing_is_asked(tmp_path: Path) -> None:
    plan = plan_climb(
        load_climb("specs/climb_region.yaml", ["study=null", "margins=none", "terrain.friction=1"])
    )
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    (check,) = [c for c in verify(path).checks if c.name == "force.penetration"]
    assert not check.judged
    assert "not asked" in check.margin
    assert "commands outside" in check.margin
