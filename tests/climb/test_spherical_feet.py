"""A climb on spherical feet: where they touch, what they press with, and what a plan file says."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import build_scene
from climbplan.climb.scene.footing import build_footing
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError
from climbplan.robots.foot import Foot
from climbplan.robots.kinematics import contact_jacobian
from climbplan.verification.check import FEET_LIMITS

SPECS = Path(__file__).parents[2] / "specs"
RADIUS = 0.03
# The walls of climb_walker.yaml, that much farther apart
WALLS = "terrain.walls.gap=1.29"
ONE_ROUND = ["task.rounds=1", "task.goal.com=[0, 0, 0.12]", WALLS]


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("feet")
    for name in ("climb_walker.yaml", "robot_walker.yaml", "walker.urdf"):
        shutil.copy(SPECS / name, folder)
    robot = folder / "robot_walker.yaml"
    robot.write_text(f"{robot.read_text()}\nfoot: {{radius: {RADIUS}}}\n")
    return folder / "climb_walker.yaml"


@pytest.fixture(scope="module")
def made(spec: Path, tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    path = tmp_path_factory.mktemp("plan") / "plan.h5"
    write_climb(plan_climb(load_climb(spec, ONE_ROUND)), path)
    return read_climb(path)


def failed(plan: ClimbPlan) -> set[str]:
    return {check.name for check in verify_plan(plan).checks if not check.passed}


def test_the_plan_is_verified_with_its_feet(made: ClimbPlan) -> None:
    assert made.robot.foot == Foot(RADIUS)
    verification = verify_plan(made)
    assert verification.passed, verification.table()
    assert set(FEET_LIMITS) <= {check.name for check in verification.checks}
    # Centres of feet stay their radius off the walls
    walls = np.abs(made.rounds.toes[..., 0])
    np.testing.assert_allclose(walls, 1.29 / 2 - RADIUS, atol=1e-9)
    torque = np.einsum(
        "knij,kni->knj",
        contact_jacobian(
            made.robot, made.instants.rpy, made.instants.joint_angles, made.instants.normal
        ),
        made.forces.force,
    )
    np.testing.assert_allclose(torque, made.forces.joint_torques, atol=1e-9)
    smaller = replace(made, robot=replace(made.robot, foot=Foot(RADIUS / 2)))
    assert "terrain.data" in failed(smaller)


def test_feet_of_another_size_are_found(made: ClimbPlan) -> None:
    """Surfaces moved with the radius: forces no longer balance where feet touch."""
    radius = RADIUS / 2
    surfaces = tuple(replace(surface, standoff=radius) for surface in made.terrain.surfaces)
    other = replace(
        made,
        robot=replace(made.robot, foot=Foot(radius)),
        terrain=replace(made.terrain, surfaces=surfaces),
    )
    wrong = failed(other)
    assert {"robot.spec", "terrain.spec", "force.equilibrium", "torque.from_forces"} <= wrong


def test_stated_toes_are_where_feet_touch(spec: Path) -> None:
    loaded = load_climb(spec, ONE_ROUND)
    stance = build_scene(loaded.spec, loaded.robot, loaded.source).start.toes
    touching = stance + np.sign(stance) * [RADIUS, 0.0, 0.0]
    names = loaded.robot.limb_names
    toes = ", ".join(
        f"{name}: [{x}, {y}, {z}]" for name, (x, y, z) in zip(names, touching, strict=True)
    )
    loaded = load_climb(spec, [*ONE_ROUND, f"task.start.toes={{{toes}}}"])
    stated = build_scene(loaded.spec, loaded.robot, loaded.source).start.toes
    np.testing.assert_allclose(stated, stance, atol=1e-12)
    x, y, z = stance[0]
    loaded = load_climb(spec, [*ONE_ROUND, f"task.start.toes={{{names[0]}: [{x}, {y}, {z}]}}"])
    with pytest.raises(SpecError, match=r"30\.00 mm off"):
        build_scene(loaded.spec, loaded.robot, loaded.source)


def test_feet_keep_off_what_rises_beside_them(spec: Path) -> None:
    """Ground between walls: feet on it stay their radius off these, those on walls off it."""
    ground = "terrain.ground={across: [-0.645, 0.645], along: [-0.8, 0.8], height: -0.8}"
    loaded = load_climb(spec, [*ONE_ROUND, ground])
    scene = build_scene(loaded.spec, loaded.robot, loaded.source)
    regions = {region.name: region for region in build_footing(scene.terrain, 0.0, Foot(RADIUS))}
    level = regions["ground"].vertices
    np.testing.assert_allclose(np.abs(level[:, 0]), 0.645 - RADIUS, atol=1e-6)
    np.testing.assert_allclose(np.abs(level[:, 1]), 0.8, atol=1e-6)
    np.testing.assert_allclose(level[:, 2], RADIUS - 0.8, atol=1e-9)
    assert regions["left"].vertices[:, 2].min() == pytest.approx(RADIUS - 0.8, abs=1e-6)


@pytest.mark.slow
def test_feet_roll_in_simulation_as_planned(made: ClimbPlan, tmp_path: Path) -> None:
    import climbplan

    pytest.importorskip("mujoco", reason="mujoco is missing: pip install '.[simulate]'")
    write_climb(made, tmp_path / "plan.h5")
    found = climbplan.load_plan(tmp_path / "plan.h5").simulate()
    assert found.passed
    assert found.slips == 0
