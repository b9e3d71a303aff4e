"""Quadrupeds on ground: the body stands over the legs that stay before each lift."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.gait.balance import find_balancing_shifts, sample_body_path
from climbplan.climb.gait.balance_program import LiftBalance
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.gait.instants import build_instants, compute_joint_angles
from climbplan.climb.plan.climb_plan import ClimbPlan, Instants
from climbplan.climb.plan.file import read_as_found, write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import NoPlanFound
from climbplan.schema.examples import read_example_data

SPEC = """
kind: climb
robot: robot_walker.yaml
terrain: {friction: 0.8, ground: {across: [-1.5, 1.5], along: [-1.5, 1.5]}}
task:
  rounds: 1
  start: {com: [0, 0, 0.3]}
  payload: {mass: 1, offset: [0.2, 0, 0]}
  goal: {com: [0, 0.05, 0.3]}
  stance: {L1: [-0.35, 0.33, -0.3], R1: [0.35, 0.33, -0.3],
           L2: [-0.35, -0.33, -0.3], R2: [0.35, -0.33, -0.3]}
  gait: [L2, L1, R2, R1]
posture: {steps: {com_shift_max: 0.3}}
force: {safety_friction: 1.2}
"""


@pytest.fixture(scope="module", name="spec")
def _spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ground")
    (folder / "ground.yaml").write_text(SPEC)
    for name, content in read_example_data("climb_walker").items():
        (folder / name).write_bytes(content)
    return folder / "ground.yaml"


@pytest.fixture(scope="module", name="plan")
def _plan(spec: Path) -> ClimbPlan:
    return plan_climb(load_climb(spec))


@pytest.fixture(scope="module", name="scene")
def _scene(spec: Path) -> ClimbScene:
    loaded = load_climb(spec)
    return build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)


@pytest.fixture(scope="module", name="loads")
def _loads(spec: Path) -> ClimbScene:
    """Shifts for loads alone: no depth of commands is asked for, which takes larger ones."""
    loaded = load_climb(spec, ["margins.depth=0"])
    return build_scene(loaded.spec, loaded.robot, loaded.source, loaded.directory)


def standing(scene: ClimbScene, lifted: int, com: tuple[float, float, float]) -> Instants:
    """The start's toes with one limb lifted and the body at `com`."""
    count = scene.robot.limb_count
    return build_instants(
        scene,
        np.array([1]),
        np.array([com]),
        np.zeros((1, 3)),
        scene.start.toes[None],
        region=scene.start.region[None],
        lifted=np.arange(count)[None] == lifted,
    )


def test_a_quadruped_walks_and_is_verified(plan: ClimbPlan) -> None:
    verification = verify_plan(plan)
    assert verification.passed, verification.failed
    shift = next(c for c in verification.checks if c.name == "steps.shift")
    assert 0.02 < shift.used * 0.3 < 0.3
    # Forces straight above three toes: where weight and payload act is inside their triangle
    lift = plan.instants.lifted.any(axis=1)
    mass = plan.robot.mass
    off = plan.robot.centre_of_mass(plan.instants.joint_angles[lift]) * mass / (mass + 1.0)
    off[:, 0] += 0.2 * 1.0 / (mass + 1.0)
    for toes, com, up in zip(
        plan.instants.toes[lift],
        plan.instants.com[lift] + off,
        plan.instants.contact[lift],
        strict=True,
    ):
        corners = np.vstack([toes[up][:, :2].T, np.ones(3)])
        assert (np.linalg.solve(corners, [*com[:2], 1.0]) > 0.05).all()


def test_the_shift_leaves_room_for_commands_inside_surfaces(plan: ClimbPlan) -> None:
    """A toe that bears only what pressure asks for is pressed aside to be commanded deep enough."""
    lift = plan.instants.lifted.any(axis=1)
    assert plan.forces.margin_share is not None
    assert plan.forces.margin_share[lift].min() > 0.5  # 0.41 by the shift for loads alone


def test_without_leave_to_shift_there_are_no_forces(spec: Path) -> None:
    with pytest.raises(NoPlanFound, match=r"force\.unilateral"):
        plan_climb(load_climb(spec, ["posture.steps.com_shift_max=0", "solver.method=micp"]))


def test_auto_finds_the_shift_where_the_spec_leaves_it_open(spec: Path) -> None:
    text = SPEC.replace("posture: {steps: {com_shift_max: 0.3}}\n", "")
    other = spec.with_name("open.yaml")
    other.write_text(text)
    plan = plan_climb(load_climb(other))
    assert verify_plan(plan).passed
    assert "posture.steps.com_shift_max" in plan.notes[0]
    assert plan.limits.shift_max > 0


def test_the_shift_is_the_least_that_loads_every_toe(loads: ClimbScene) -> None:
    middle = (0.0, 0.0, 0.3)
    lift = standing(loads, 0, middle)
    shift = find_balancing_shifts(loads, lift)[0]
    toes = loads.start.toes[1:]
    corners = np.vstack([toes[:, :2].T, np.ones(3)])

    payload, mass = loads.spec.task.payload.mass, loads.robot.mass
    off = 0.2 * payload / (mass + payload)

    def pressed(at: np.ndarray) -> np.ndarray:
        """Of the toes, as shares of the robot's weight, with the body at `at`."""
        moved = replace(lift, com=np.array([[at[0], at[1], middle[2]]]))
        angles = compute_joint_angles(loads.robot, moved, moved.toes)
        legs = loads.robot.centre_of_mass(angles)[0] * mass / (mass + payload)
        assert np.abs(legs[:2]).max() < 0.02
        places = [at[0] + off + legs[0], at[1] + legs[1], 1.0]
        return np.linalg.solve(corners, places) * (mass + payload) / mass

    pressure = loads.spec.margins.normal_force
    assert pressed(np.array(middle) + shift).min() == pytest.approx(pressure, abs=1e-4)
    # No shorter one loads every toe as much
    angle = np.linspace(0, 2 * np.pi, 720)
    around = 0.995 * np.linalg.norm(shift) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert max(pressed(np.array([x, y])).min() for x, y in around) < pressure
    # Where all toes bear enough already, there is none
    assert not find_balancing_shifts(
        loads, standing(loads, 0, tuple(np.array(middle) + 1.1 * shift))
    )[0].any()


def test_a_load_that_no_shift_within_bounds_carries_leaves_the_body_where_it_is(
    loads: ClimbScene,
) -> None:
    steps = loads.spec.posture.steps.model_copy(update={"com_shift_max": 0.001})
    posture = loads.spec.posture.model_copy(update={"steps": steps})
    short = replace(loads, spec=loads.spec.model_copy(update={"posture": posture}))
    assert not find_balancing_shifts(short, standing(loads, 0, (-0.05, 0.05, 0.3))).any()


def test_pushes_take_the_body_to_the_next_lift(plan: ClimbPlan, scene: ClimbScene) -> None:
    com = plan.instants.com
    assert np.allclose(com[1:-1:2], com[2::2], atol=1e-12)
    assert np.allclose(com[-1], plan.rounds.com[-1], atol=1e-12)
    assert np.allclose(plan_instants(scene, plan.rounds).com, com)
    way, _ = sample_body_path(plan.rounds, plan.instants)
    assert np.array_equal(way[0, 0], plan.rounds.com[0])
    assert np.allclose(way[-1, -1], plan.rounds.com[-1], atol=1e-12)
    assert np.allclose(way[1:, 0], way[:-1, -1], atol=1e-12)


@pytest.mark.parametrize(
    ("dataset", "row", "by", "failing"),
    [
        ("instants/com", 2, [0.3, 0, 0], "steps.shift"),
        ("instants/com", 2, [0, 0, 0.01], "steps.shift"),
        ("instants/com", 3, [0.01, 0, 0], "gait.sequence"),
        ("trajectory/com", 3, [0, 0.01, 0], "trajectory.body"),
    ],
)
def test_bodies_elsewhere_are_found(
    plan: ClimbPlan, tmp_path: Path, dataset: str, row: int, by: list[float], failing: str
) -> None:
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    with h5py.File(path, "r+") as file:
        file[dataset][row] += by
    assert failing in {check.name for check in verify_plan(read_as_found(path)).failed}


def test_a_plan_may_not_give_itself_leave(plan: ClimbPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.h5"
    write_climb(plan, path)
    with h5py.File(path, "r+") as file:
        file["limits"].attrs["shift_max"] = 0.5
    assert "file.spec_values" in {c.name for c in verify_plan(read_as_found(path)).failed}
    with h5py.File(path, "r+") as file:
        del file["limits"].attrs["shift_max"]  # as plans of before: none
    failed = {c.name for c in verify_plan(read_as_found(path)).failed}
    assert {"gait.sequence", "file.spec_values"} <= failed


@pytest.mark.slow
def test_a_quadruped_climbs_a_stair(spec: Path) -> None:
    text = SPEC.replace(
        "terrain: {friction: 0.8, ground: {across: [-1.5, 1.5], along: [-1.5, 1.5]}}",
        """terrain:
  friction: 0.8
  regions:
    - {name: floor, rectangle: {center: [0, -0.55, 0], normal: [0, 0, 1], width: 3, height: 2.1}}
    - {name: stair, rectangle: {center: [0, 1, 0.04], normal: [0, 0, 1], width: 3, height: 1}}""",
    )
    text = text.replace("rounds: 1", "rounds: 3").replace(
        "com: [0, 0.05, 0.3]", "com: [0, 0.3, 0.32]"
    )
    other = spec.with_name("stair.yaml")
    other.write_text(text)
    plan = plan_climb(load_climb(other, ["task.goal.tolerance=0.05"]))
    assert verify_plan(plan).passed
    names = [surface.name for surface in plan.terrain.surfaces]
    stands = [names[r] for r in plan.rounds.region[-1]]
    assert stands.count("stair") == 2


def test_a_shift_keeps_torque_limits_where_it_leads(loads: ClimbScene) -> None:
    """Legs of a shifted body are bent otherwise: programs follow one another (`balance.py`)."""
    weak = replace(loads, robot=replace(loads.robot, max_torque=0.055 * loads.robot.max_torque))
    lift = standing(weak, 1, (0.0, 0.0, 0.3))

    def excess(follow: bool) -> float:
        shift = find_balancing_shifts(weak, lift, allow_sequence=follow)[0, :2]
        own = LiftBalance(weak, [lift], 0, 1.0)
        found = own.solve(own.compute_posture(shift), 0.0, shift, 0.0, 0.3, 10.0)
        assert found is not None
        return found.excess

    assert excess(follow=False) > 0.03
    assert excess(follow=True) < 0.005


def test_a_body_is_shifted_for_both_ends_of_a_swing(loads: ClimbScene) -> None:
    lift = standing(loads, 0, (0.0, 0.0, 0.3))
    above = lift.toes + np.array([0.0, 0.15, 0.05]) * lift.lifted[..., None]
    places = replace(lift, toes=above)
    one, other = (find_balancing_shifts(loads, x)[0] for x in (lift, places))
    both = find_balancing_shifts(loads, lift, places=places)[0]
    assert np.linalg.norm(one - other) > 1e-3
    # What holds at both ends is at least as far as what holds at one
    assert np.linalg.norm(both) > max(np.linalg.norm(one), np.linalg.norm(other)) - 1e-4
    weightless = replace(loads, robot=replace(loads.robot, links=None))
    same = [find_balancing_shifts(weightless, lift, places=p)[0] for p in (None, places)]
    assert np.array_equal(*same)
