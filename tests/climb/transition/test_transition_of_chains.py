"""From the ground to the walls with legs of four joints from a URDF."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from climbplan.arrays import IntArray
from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan, Instants
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.transition.following_climb import join_instants
from climbplan.climb.transition.motion import TransitionMotion, plan_motion
from climbplan.climb.transition.motion_data import (
    build_motion_data,
    build_shape,
    find_links_to_separate,
)
from climbplan.climb.transition.motion_formulation import POINTS, formulate_motion
from climbplan.climb.transition.planner import plan_transition, search_sequences
from climbplan.climb.transition.scene import TransitionScene, build_transition
from climbplan.climb.transition.search import SequenceSearch
from climbplan.climb.transition.stance_forces import SearchTables, solve_stance_forces
from climbplan.climb.transition.standing_clearance import compute_standing_clearance
from climbplan.errors import SpecError, Unresolved
from climbplan.robots.capsules import limb_capsules
from climbplan.robots.kinematics import solve_inverse_kinematics, to_body, toe_world
from climbplan.robots.self_clearance import compute_limb_clearance, list_clearance_pairs

SPECS = Path(__file__).parents[3] / "specs"
SPEC = """kind: transition
robot: robot_walker.yaml
terrain:
  friction: 1.2
  walls: {gap: 1.23, along: [-0.8, 0.8], up: [0.0, 1.6]}
  ground: {height: 0.0, across: [-0.615, 0.615], along: [-0.8, 0.8]}
task:
  rounds: 4
  start:
    com: [0, 0, 0.24]
    toes: {L1: [-0.45, 0.35, 0], R1: [0.45, 0.35, 0], L2: [-0.45, -0.35, 0], R2: [0.45, -0.35, 0]}
  goal: {com: [0, 0, 0.32]}
posture: {steps: {com_shift_max: 0.2, com_max: 0.3}}
search: {lateral_offset: 0.08, heights: 3}
force: {safety_torque: 1.2}
"""
FAR = np.inf


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("walker")
    for name in ("robot_walker.yaml", "walker.urdf"):
        shutil.copy(SPECS / name, folder)
    (folder / "wall.yaml").write_text(SPEC)
    return folder / "wall.yaml"


@pytest.fixture(scope="module")
def scene(spec: Path) -> TransitionScene:
    return build_transition(load_transition(spec))


def without_shift(scene: TransitionScene) -> TransitionScene:
    steps = scene.spec.posture.steps.model_copy(update={"com_shift_max": 0.0})
    posture = scene.spec.posture.model_copy(update={"steps": steps})
    return replace(scene, spec=scene.spec.model_copy(update={"posture": posture}))


def test_a_quadruped_has_to_shift_before_its_first_lift(scene: TransitionScene) -> None:
    search, found = search_sequences(scene, FAR)
    assert found
    for sequence in found:
        assert (sequence.moves.sum(axis=1) == 1).all()
        first = search.tables.poses.com[sequence.poses[0]] - scene.start.com
        assert 0 < np.linalg.norm(first) <= scene.spec.posture.steps.com_shift_max
    with pytest.raises(Unresolved) as refused:
        search_sequences(without_shift(scene), FAR)
    assert "does not balance" in str(refused.value)
    remedies = [r for conflict in refused.value.conflicts for r in conflict.remedies]
    assert {r.key for r in remedies} == {"posture.steps.com_shift_max"}


def test_a_refusal_tells_weak_motors_from_smooth_walls() -> None:
    """How far S_tau is off is right: motors that are so much stronger hold, these do not."""
    changes = ["terrain.friction=0.3", "task.sequence=RF RR LM | RM LR LF"]
    smooth = build_transition(load_transition(SPECS / "transition_flat.yaml", changes))
    with pytest.raises(Unresolved, match="motors would have S_tau") as refused:
        search_sequences(smooth, FAR)
    told = " ".join(r.words for c in refused.value.conflicts for r in c.remedies)
    found = re.search(r"([0-9.]+) times the torque limits", told)
    assert found is not None
    times = float(found[1])
    stance: IntArray = np.array([[1, -1, 1, -1, 1, -1]])  # RM LR LF lifted, the others on the walls
    for factor, holds in ((1.0, False), (1.01 * times, True)):
        robot = replace(smooth.robot, max_torque=factor * smooth.robot.max_torque)
        tables = SequenceSearch(replace(smooth, robot=robot)).tables
        pose = np.flatnonzero(tables.reach.valid[:, stance[0] >= 0, 1].all(axis=1))
        use = solve_stance_forces(tables, np.repeat(stance, len(pose), axis=0), pose).torque_use
        assert bool(np.isfinite(use).any()) is holds


def test_limbs_that_meet_are_not_chosen(scene: TransitionScene) -> None:
    """The table of two limbs on two footholds is what the distance of their capsules says."""
    robot = replace(scene.robot, capsules=None, limb_radius=0.15)  # thick, so that some meet
    scene, com = replace(scene, robot=robot), np.array([scene.start.com, scene.goal.com])
    rng = np.random.default_rng(3)
    share = rng.random((2, robot.limb_count, 5, robot.joint_count))
    span = robot.joint_upper - robot.joint_lower
    angles = robot.joint_lower[:, None] + share * span[:, None]
    table = compute_standing_clearance(scene, com, np.zeros((2, 3)), angles)
    meets = 0
    for state in rng.integers(0, 5, (40, robot.limb_count)):
        own = angles[:, np.arange(robot.limb_count), state]
        links = limb_capsules(robot, own)
        room = compute_limb_clearance(links, list_clearance_pairs(robot, links)[1])
        apart = np.asarray((room > 1e-3).all(axis=-1))
        np.testing.assert_array_equal(table.find_clear_poses(tuple(state)), apart)
        meets += int((~apart).sum())
    assert meets


def test_mistakes_in_a_urdf_stay_at_their_keys(spec: Path) -> None:
    with pytest.raises(SpecError, match=r"step_max.*L9"):
        load_transition(spec, ["task.step_max={L9: 0.1}"])
    with pytest.raises(SpecError, match="4 limbs"):
        load_transition(spec, ["task.min_supporting_limbs=4"])


MISSION = ("climb={rounds: 1, goal: {com: [0, 0, 0.4]}}",)


@pytest.fixture(scope="module")
def plan(spec: Path) -> ClimbPlan:
    return plan_transition(load_transition(spec, [*MISSION, "solver.time_limit=600"]))


@pytest.mark.merge
def test_a_mission_is_verified_from_its_file(plan: ClimbPlan, tmp_path: Path) -> None:
    assert any(text.startswith("assumed of walker: ") for text in plan.warnings)
    write_climb(plan, tmp_path / "plan.h5")
    verification = verify_plan(read_climb(tmp_path / "plan.h5"))
    assert verification.passed, verification.table()
    assert {"steps.shift", "limbs.self_collision"} <= {c.name for c in verification.checks}


@pytest.mark.merge
def test_a_push_before_a_climb_leads_to_its_first_lift(plan: ClimbPlan) -> None:
    """The body may wait for it off the straight way, as far as `steps.shift` allows."""
    count = plan.instants.count // 2
    first, tail = (
        Instants(**{name: value[rows].copy() for name, value in vars(plan.instants).items()})
        for rows in (slice(count), slice(count, None))
    )
    tail.com[0] += [0.005, -0.003, 0.0]
    push = count - 1
    joined = join_instants(plan.robot, first, tail)
    np.testing.assert_array_equal(joined.com[push], tail.com[0])
    toes = toe_world(plan.robot, joined.com, joined.rpy, joined.joint_angles)
    standing = joined.contact[push]
    np.testing.assert_allclose(toes[push, standing], first.toes[push, standing], atol=1e-7)


@pytest.mark.merge
def test_a_shift_beyond_its_bound_is_caught(plan: ClimbPlan) -> None:
    limits = replace(plan.limits, shift_max=0.01)
    failed = {c.name for c in verify_plan(replace(plan, limits=limits)).checks if not c.passed}
    assert "steps.shift" in failed


def test_rows_part_two_limbs_by_what_they_have(scene: TransitionScene) -> None:
    """Where the search has them a pair's least row is its capsules' room less what is asked."""
    search, found = search_sequences(scene, FAR)
    moved, beside = found[0].moves, ((0, 1, 2, 1), (1, 2, 3, 1), (0, 2, 3, 2))
    stated = formulate_motion(build_shape(scene, len(moved), separate=True, link_pairs=beside))
    numbers = build_motion_data(
        search.tables, stated, found[0], 1.2, separate=True, link_pairs=beside
    )
    rows = ca.Function("rows", [stated.x, stated.p], [stated.rows])
    value = np.array(rows(numbers.start, stated.theta(numbers.parameters))).ravel()
    own = value[stated.block("limbs.self_collision")][:, -4 * POINTS * len(beside) :]
    least = own.reshape(len(moved), POINTS, len(beside), 4).min(axis=-1)
    shape = len(moved), POINTS, scene.robot.limb_count, scene.robot.joint_count
    angles = numbers.start[stated.place("angles")].reshape(shape)
    there = np.where(moved[:, None, :, None], angles, angles[:, :1])
    room = compute_limb_clearance(limb_capsules(scene.robot, there), np.array(beside))
    goes = np.array([[moved[j, [i, k]].any() for i, _, k, _ in beside] for j in range(len(moved))])
    looked = np.repeat(goes[:, None], POINTS, axis=1)
    looked[:, 0] = True
    assert 0 < looked.sum() < looked.size
    np.testing.assert_allclose(least[looked], room[looked] - 2e-3, atol=1e-9)
    np.testing.assert_array_equal(least[~looked], 1.0)  # planes of zeros, which all are beyond


def test_links_that_come_close_are_found(scene: TransitionScene) -> None:
    search, found = search_sequences(scene, FAR)
    assert find_links_to_separate(search.tables, found[0]) == ()
    capsules = scene.robot.capsules
    assert capsules is not None
    thick = replace(capsules, radius=capsules.radius + 0.12)
    tables = replace(
        search.tables, scene=replace(scene, robot=replace(scene.robot, capsules=thick))
    )
    near = find_links_to_separate(tables, found[0])
    assert near
    for i, _, k, _ in near:
        assert {scene.robot.limb_names[i][0], scene.robot.limb_names[k][0]} == {"L", "R"}


def test_rows_move_the_body_so_that_limbs_do_not_meet() -> None:
    """Shins 2 mm too thick for the motion without rows: with them the body goes another way."""
    flat = build_transition(load_transition(SPECS / "transition_flat.yaml"))
    search, found = search_sequences(flat, FAR)
    limbs, last = range(flat.robot.limb_count), flat.robot.joint_count - 1
    others = [
        (i, c, k, d)
        for i in limbs
        for k in limbs[i + 1 :]
        for c in range(last + 1)
        for d in range(last + 1)
        if (c, d) != (last, last)
    ]
    others += [(i, c, -1, 0) for i in limbs for c in range(last + 1)]

    def room(tables: SearchTables, motion: TransitionMotion) -> float:
        # After the first round, whose pose is the start's
        moved, rounds = found[0].moves[1:], motion.rounds
        toes = np.stack([rounds.toes[1:-1], rounds.toes[2:]], axis=1)
        pose = rounds.com[1:-1, None], rounds.rpy[1:-1, None]
        angles = solve_inverse_kinematics(tables.scene.robot, to_body(*pose, toes)).best()
        there = np.where(moved[:, None, :, None], angles, angles[:, :1])
        links = limb_capsules(tables.scene.robot, there)
        return float(
            compute_limb_clearance(links, list_clearance_pairs(tables.scene.robot, links)[1]).min()
        )

    def as_thick(radius: float) -> SearchTables:
        robot = replace(flat.robot, limb_radius=radius, touching=np.array(others))
        return replace(search.tables, scene=replace(flat, robot=robot))

    thin = as_thick(flat.robot.limb_radius)
    plain = plan_motion(thin, found[0])
    assert plain.is_accepted
    thick = as_thick(flat.robot.limb_radius + (room(thin, plain) + 2e-3) / 2)
    assert room(thick, plain) == pytest.approx(-2e-3, abs=1e-6)
    parted = plan_motion(thick, found[0], separate=True, colliding_motion=plain.rounds)
    assert parted.is_accepted, parted.block
    assert room(thick, parted) > -1e-5
