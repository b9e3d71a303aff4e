"""A biped on flat feet: steps over level ground, what a plan file says of soles, and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.check.anew.soles import (
    compute_corner_offsets,
    compute_sole_axes,
    distribute_to_corners,
)
from climbplan.climb.check.feet import check_feet
from climbplan.climb.check.forces import check_forces
from climbplan.climb.check.subject import build_subject
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.forces.explanation import NoForces
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.gait.instants import build_instants_at
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import SpecError, UsageError
from climbplan.mechanics.flat_contact import centre_of_pressure, moment_of
from climbplan.robots.kinematics import contact_jacobian
from climbplan.robots.rotations import rotation_world_body
from climbplan.verification.check import FEET_LIMITS, SOLE_LIMITS

SPECS = Path(__file__).parents[2] / "specs"
SPEC = SPECS / "climb_biped.yaml"
# Faster than a real robot would be: fewer samples to be checked
ONE_ROUND = [
    "task.rounds=1", "task.goal.com=[0, 0.1, 0.52]", "solver.method=micp", "trajectory.speed=0.1",
]  # fmt: skip


def scene_of(*changes: str) -> ClimbScene:
    loaded = load_climb(SPEC, [*ONE_ROUND, *changes])
    return build_scene(loaded.spec, loaded.robot, loaded.source)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ClimbPlan:
    path = tmp_path_factory.mktemp("plan") / "plan.h5"
    write_climb(plan_climb(load_climb(SPEC, ONE_ROUND)), path)
    return read_climb(path)


def failed(plan: ClimbPlan) -> set[str]:
    """Names of checks of forces and feet that fail."""
    subject = build_subject(plan)
    made = [*check_forces(subject), *check_feet(subject)]
    return {check.name for check in made if not check.passed}


def test_the_plan_is_verified_with_its_soles(made: ClimbPlan) -> None:
    verification = verify_plan(made)
    assert verification.passed, verification.table()
    assert not verification.fragile
    assert set(FEET_LIMITS) | set(SOLE_LIMITS) <= {check.name for check in verification.checks}
    sole, instants, forces = made.robot.sole, made.instants, made.forces
    assert sole is not None
    assert forces.corner_force is not None
    # The whole weight over one sole while the other foot swings, inside by the margin
    moment = moment_of(sole, instants.normal, forces.corner_force)
    centre = centre_of_pressure(sole, instants.normal, forces.force, moment)
    alone = instants.contact & instants.lifted.any(axis=1, keepdims=True)
    np.testing.assert_allclose(forces.force[alone][:, 2], made.robot.weight, rtol=1e-9)
    inside = 1 - np.abs(centre[instants.contact] / sole.half_size).max(axis=-1)
    assert inside.min() >= 0.3 - 1e-6
    # Torques of forces and moments by the six rows of Jacobians
    rotation = rotation_world_body(instants.rpy)[:, None]
    turning = rotation @ made.robot.limbs.turning(instants.joint_angles)
    jacobian = contact_jacobian(made.robot, instants.rpy, instants.joint_angles, instants.normal)
    torque = np.einsum("knij,kni->knj", jacobian, forces.force)
    torque += np.einsum("knij,kni->knj", turning, moment)
    np.testing.assert_allclose(torque, forces.joint_torques, atol=1e-9)


def test_what_is_wrong_with_soles_is_found(made: ClimbPlan) -> None:
    pushes = made.forces.corner_force
    assert pushes is not None
    assert made.robot.sole is not None
    swapped = replace(made, forces=replace(made.forces, corner_force=pushes[:, :, [1, 0, 3, 2]]))
    assert {"force.equilibrium", "torque.from_forces"} <= failed(swapped)
    more = replace(made, forces=replace(made.forces, corner_force=1.01 * pushes))
    assert "force.corners" in failed(more)
    # A sole that turned under the same toe
    angles = made.instants.joint_angles.copy()
    angles[:, 0, 5] += 0.01
    tilted = replace(made, instants=replace(made.instants, joint_angles=angles))
    assert "limbs.feet" in failed(tilted)
    # A narrower one, pressed with the same forces: their moments are others
    foot = replace(made.robot.foot, sole=replace(made.robot.sole, width=0.05))
    narrow = replace(made, robot=replace(made.robot, foot=foot))
    assert {"force.equilibrium", "torque.from_forces"} <= failed(narrow)
    # All pressure at one corner but a pull at another one
    pulled = pushes.copy()
    pulled[0, :, 0, 2] += 2 * pulled[0, :, 1, 2]
    pulled[0, :, 1, 2] *= -1
    wrong = failed(replace(made, forces=replace(made.forces, corner_force=pulled)))
    assert {"force.unilateral", "force.friction"} <= wrong
    # Ground that ends under a sole
    ground = made.terrain.surfaces[0]
    edge = float(made.rounds.toes[0, 1, 0]) + 0.03
    vertices = np.minimum(ground.vertices, [edge, np.inf, np.inf])
    short = replace(ground, vertices=vertices, b=(ground.A * vertices[:, None]).sum(-1).max(0))
    terrain = replace(made.terrain, surfaces=(short,))
    assert "limbs.feet" in failed(replace(made, terrain=terrain))


def test_corner_forces_make_the_wrench_within_friction() -> None:
    scene = scene_of()
    sole = scene.robot.sole
    assert sole is not None
    axes = compute_sole_axes(sole, np.array([[0.0, 0.0, 1.0]] * 3))
    arms = compute_corner_offsets(sole, axes)
    # Pressed in the middle; at a corner; turned on the spot by more than even pressure holds
    force = np.array([[5.0, 0.0, 100.0], [0.0, 10.0, 100.0], [0.0, 0.0, 100.0]])
    at = np.array([[0.0, 0.0, 0.0], [0.05, 0.1, 0.0], [0.0, 0.0, 0.0]])
    moment = np.cross(at, force)
    moment[2, 2] = 0.6 * 100.0 * np.hypot(0.055, 0.11)
    mu = np.full(3, 0.7)
    found = distribute_to_corners(sole, axes, force, moment, mu, 1e-6)
    np.testing.assert_allclose(found.sum(axis=1), force, atol=1e-9)
    np.testing.assert_allclose(np.cross(arms, found).sum(axis=1), moment, atol=1e-9)
    pressure, shear = found[..., 2], np.linalg.norm(found[..., :2], axis=-1)
    assert (pressure >= 0).all()
    assert (shear <= 0.7 * pressure + 1e-9).all()
    # More than friction holds at the corners
    moment[2, 2] = 0.8 * 100.0 * np.hypot(0.055, 0.11)
    none = distribute_to_corners(sole, axes, force, moment, mu, 1e-6)[2]
    assert (np.linalg.norm(none[:, :2], axis=-1) > 0.7 * none[:, 2]).any()


def test_a_load_beside_the_sole_is_told_by_how_much() -> None:
    scene = scene_of()
    lifted = np.array([[True, False]])
    com = scene.start.com[None] + [0.0, 0.0, 0.0]
    toes, region = scene.start.toes[None], scene.start.region[None]
    body = com, np.zeros((1, 3))
    instants = build_instants_at(
        scene, np.ones(1, np.int64), *body, toes, region=region, lifted=lifted
    )
    with pytest.raises(NoForces, match="centre of pressure 25 mm beyond the edge of its sole"):
        plan_forces(scene, instants)


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        ("solver.method=nlp", "solver.method", "`auto`, `micp`, `sl1-relaxation` alone"),
        (
            "force.deflection_compensation=predicted",
            "force.deflection_compensation",
            "would tilt them",
        ),
        ("terrain.ground={across: [-1, 1], along: [-0.1, 0.1]}", "terrain", "220 x 110 mm sole"),
        (
            "task.start.toes={L: [-0.98, 0, 0], R: [0.08, 0, 0]}",
            "task.start.toes.L",
            "35.0 mm beyond its edge",
        ),
    ],
)
def test_what_flat_feet_cannot_be_planned_with(change: str, key: str, words: str) -> None:
    with pytest.raises(SpecError) as caught:
        scene_of(change)
    told = [m for m in caught.value.mistakes if m.key == key]
    assert told, caught.value
    assert words in str(told[0])


def test_toes_left_open_stand_with_their_whole_soles() -> None:
    scene = scene_of("terrain.ground={across: [-0.5, 0.12], along: [-0.5, 0.5]}", "margins.edge=0")
    assert scene.start.toes[1, 0] == pytest.approx(0.12 - 0.055)
    standing = scene.standing[0].vertices
    np.testing.assert_allclose(standing.min(axis=0)[:2], [-0.5 + 0.055, -0.5 + 0.11], atol=1e-12)


@pytest.mark.slow
def test_a_biped_goes_up_stairs(tmp_path: Path) -> None:
    plan = plan_climb(load_climb(SPECS / "climb_biped_stairs.yaml", []))
    verification = verify_plan(plan)
    assert verification.passed, verification.table()
    assert set(plan.rounds.region[-1]) == {2}


@pytest.mark.slow
def test_a_biped_does_not_fall_in_simulation(tmp_path: Path) -> None:
    import climbplan

    pytest.importorskip("mujoco", reason="mujoco is missing: pip install '.[simulate]'")
    plan = plan_climb(load_climb(SPEC, [*ONE_ROUND, "trajectory.speed=0.01"]))
    write_climb(plan, tmp_path / "plan.h5")
    found = climbplan.load_plan(tmp_path / "plan.h5").simulate()
    assert found.passed
    assert found.slips == 0
    with pytest.raises(UsageError, match="not flat feet"):
        climbplan.load_plan(tmp_path / "plan.h5").simulate(regulator="joints")
