"""The force planner: admissible, optimal, unique, and never taken on a solver's word."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.climb.literal_solvers import solve_cvxpy, solve_literal
from climbplan.arrays import Array
from climbplan.climb.forces import solving as forces_module
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.forces.reduction import ReducedForces
from climbplan.climb.forces.solving import SolvedForces, solve_forces
from climbplan.climb.forces.statement import (
    ForceStatement,
    build_force_statement,
    check_forces,
    compute_commands,
    compute_objective,
)
from climbplan.climb.forces.unreduced import build_unreduced_problems
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Instants
from climbplan.climb.scene.climb_scene import ClimbScene
from climbplan.errors import LimitReached, Unresolved, UsageError
from climbplan.instances.straight_climb import interpolate_rounds
from climbplan.mechanics.stability import loaded_stiffness
from climbplan.mechanics.stiffness import contact_forces, limb_stiffness
from climbplan.robots.kinematics import toe_world
from climbplan.robots.model import Robot
from climbplan.schema.robots.robot import RobotSpec

SceneMaker = Callable[..., ClimbScene]
RobotMaker = Callable[..., RobotSpec]

# Relative differences of optima: inscribed pyramids are conservative, exact cones are not.
PYRAMID, EXACT, CVXPY = 4e-3, 1e-6, 2e-5


def rows_of(instants: Instants, rows: list[int]) -> Instants:
    return replace(instants, **{name: value[rows] for name, value in vars(instants).items()})


@pytest.fixture(scope="module")
def statement(demo_scene: ClimbScene, demo_instants: Instants) -> ForceStatement:
    return build_force_statement(demo_scene, demo_instants).as_published()


@pytest.fixture(scope="module")
def exact(statement: ForceStatement) -> SolvedForces:
    return solve_forces(statement, "clarabel", 16)


@pytest.mark.parametrize("garbage", [np.nan, np.inf, 1e200])
def test_numbers_of_a_solver_that_gives_up_are_no_forces(
    statement: ForceStatement,
    exact: SolvedForces,
    monkeypatch: pytest.MonkeyPatch,
    garbage: float,
) -> None:
    solve_by_daqp = forces_module.SOLVERS["daqp"]

    def give_up(group: ReducedForces, facets: int) -> forces_module._Answers:
        answers = solve_by_daqp(group, facets)
        force = answers.force.copy()
        force[0] = garbage
        return replace(answers, force=force)

    monkeypatch.setitem(forces_module.SOLVERS, "daqp", give_up)
    solution = solve_forces(statement, "daqp", 16)
    assert solution.num_resolved >= 1
    assert not len(solution.missing)
    optimum = compute_objective(statement, exact.force)
    np.testing.assert_allclose(compute_objective(statement, solution.force), optimum, rtol=PYRAMID)


@pytest.mark.parametrize("solver", ["daqp", "clarabel", "osqp"])
def test_planned_forces_hold_every_constraint(
    demo_scene: ClimbScene, demo_instants: Instants, solver: str
) -> None:
    """Checked limb by limb in plain arithmetic, apart from the planner's own check."""
    if solver == "osqp":
        demo_instants = rows_of(demo_instants, list(range(12)))
    robot, spec = demo_scene.robot, demo_scene.spec.force
    found = plan_forces(demo_scene, demo_instants, solver)
    for k in range(demo_instants.count):
        total, moment = np.array([0, 0, -robot.weight]), np.zeros(3)
        use, ratio = 0.0, np.inf
        for i in range(robot.limb_count):
            f, n = found.force[k, i], demo_instants.normal[k, i]
            if not demo_instants.contact[k, i]:
                assert not f.any()
                assert not found.joint_torques[k, i].any()
                assert not found.wall_deflection[k, i].any()
                continue
            total = total + f
            moment = moment + np.cross(demo_instants.toes[k, i] - demo_instants.com[k], f)
            pressure = f @ n
            assert pressure >= 0
            shear = np.linalg.norm(f - pressure * n)
            assert shear <= demo_instants.mu[k, i] / spec.safety_friction * pressure * (1 + 1e-9)
            assert found.mu_critical[k, i] == pytest.approx(shear / pressure, rel=1e-9)
            ratio = min(ratio, demo_instants.mu[k, i] * pressure / shear)
            use = max(use, (np.abs(found.joint_torques[k, i]) / robot.max_torque[i]).max())
        assert np.linalg.norm(total) <= 1e-7 * robot.weight
        assert np.linalg.norm(moment) <= 1e-7 * robot.weight
        assert found.safety_torque[k] == pytest.approx(1 / use)
        assert found.safety_torque[k] >= spec.safety_torque
        assert found.safety_friction[k] == pytest.approx(ratio, rel=1e-9)
        assert found.safety_friction[k] >= spec.safety_friction


def test_joint_torques_are_the_work_of_the_forces(
    demo_scene: ClimbScene, demo_instants: Instants
) -> None:
    found = plan_forces(demo_scene, demo_instants)
    robot, step = demo_scene.robot, 1e-6
    for joint in range(3):
        turned = demo_instants.joint_angles.copy()
        turned[..., joint] += step
        ends = [
            toe_world(robot, demo_instants.com, demo_instants.rpy, angles)
            for angles in (turned, demo_instants.joint_angles)
        ]
        work = (found.force * (ends[0] - ends[1])).sum(axis=-1) / step
        np.testing.assert_allclose(found.joint_torques[..., joint], work, atol=1e-4)


@pytest.mark.parametrize("sag", ["predicted", "compensated"])
def test_deflections_produce_the_forces(
    demo_climb: SceneMaker, demo_instants: Instants, sag: str
) -> None:
    scene = demo_climb(force={"deflection_compensation": sag})
    found = plan_forces(scene, demo_instants)
    statement = build_force_statement(scene, demo_instants)
    stiffness = limb_stiffness(scene.robot, statement.jacobian)
    stiffness *= demo_instants.contact[..., None, None]
    back = contact_forces(stiffness, statement.arms, found.wall_deflection, found.com_deflection)
    np.testing.assert_allclose(back, found.force, atol=1e-6)
    turned = demo_instants.joint_angles - found.joint_command
    imposed = np.einsum("knij,knj->kni", statement.jacobian, turned)
    np.testing.assert_allclose(imposed, found.wall_deflection, atol=1e-12)
    toes = toe_world(scene.robot, demo_instants.com, demo_instants.rpy, found.joint_command)
    np.testing.assert_array_equal(found.toe_command, toes)
    assert bool(found.com_deflection.any()) == (sag == "predicted")


def spread(robot: Robot, command: Array) -> float:
    """Least distance of joint commands from their bounds [rad], negative outside."""
    return float(np.minimum(command - robot.joint_lower, robot.joint_upper - command).min())


def test_commands_are_within_bounds(
    demo_scene: ClimbScene, demo_instants: Instants, statement: ForceStatement
) -> None:
    """With forces planned for their own sake some commands would be out of bounds."""
    free = solve_forces(statement, "daqp", 16).force
    assert spread(demo_scene.robot, compute_commands(statement, free)) < 0
    found = plan_forces(demo_scene, demo_instants)
    assert spread(demo_scene.robot, found.joint_command) > 1e-3


@pytest.mark.parametrize("solver", ["daqp", "clarabel"])
def test_restrictions_leave_the_optimum_where_they_do_not_matter(
    demo_climb: SceneMaker, solver: str
) -> None:
    """A softer robot is commanded further: forces change where they must, only for the worse."""
    scene = demo_climb()
    robot = replace(scene.robot, joint_stiffness=0.8 * scene.robot.joint_stiffness)
    soft = replace(scene, robot=robot)
    instants = plan_instants(scene, interpolate_rounds(scene))
    statement = build_force_statement(soft, instants).as_published()
    optimal = solve_forces(statement, solver, 16).force
    solved = solve_forces(build_force_statement(soft, instants), solver, 16)
    assert not len(solved.missing)
    assert check_forces(build_force_statement(soft, instants), solved.force).worst.max() <= 1e-7
    worse = compute_objective(statement, solved.force) - compute_objective(statement, optimal)
    assert worse.min() >= -1e-3
    assert worse.max() > 5e-3
    assert np.median(worse) < 1e-3


def test_softness_is_answered_with_the_stiffness_that_is_enough(demo_climb: SceneMaker) -> None:
    scene = demo_climb()
    stiffness = 0.3 * scene.robot.joint_stiffness

    def softened(factor: float) -> ClimbScene:
        robot = replace(scene.robot, joint_stiffness=factor * stiffness)
        return replace(scene, robot=robot)

    instants = plan_instants(scene, interpolate_rounds(scene))
    with pytest.raises(Unresolved, match="no admissible contact forces") as caught:
        plan_forces(softened(1.0), instants)
    text = str(caught.value)
    assert re.search("(command within bounds of .* coxa|stability of the braced body)", text)
    enough = re.search(r"all have with .*?([\d.]+) times the joint stiffness", text)
    assert enough
    plan_forces(softened(float(enough[1])), instants)
    with pytest.raises(Unresolved):
        plan_forces(softened(0.9 * float(enough[1])), instants)


def test_forces_leave_the_stiffness_asked_for(demo_climb: SceneMaker) -> None:
    scene = demo_climb()
    instants = plan_instants(scene, interpolate_rounds(scene))
    free = build_force_statement(scene, instants)
    left = loaded_stiffness(free.braced_body, solve_forces(free, "daqp", 16).force).left
    asked = float(left.min()) + 0.05
    firm = build_force_statement(demo_climb(**{"force": {"min_stiffness_ratio": asked}}), instants)
    solved = solve_forces(firm, "daqp", 16)
    assert not len(solved.missing)
    assert loaded_stiffness(firm.braced_body, solved.force).left.min() >= asked - 1e-7


@pytest.mark.parametrize(("solver", "count"), [("daqp", 36), ("osqp", 12)])
def test_pyramids_come_close_to_the_cones(
    statement: ForceStatement,
    exact: SolvedForces,
    solver: str,
    count: int,
    demo_scene: ClimbScene,
    demo_instants: Instants,
) -> None:
    rows = rows_of(demo_instants, list(range(count)))
    part = build_force_statement(demo_scene, rows).as_published()
    solved = solve_forces(part, solver, 16)
    assert solved.num_resolved <= count // 3
    best = compute_objective(statement, exact.force)[:count]
    off = compute_objective(part, solved.force) / best - 1
    assert off.min() >= -EXACT
    assert off.max() <= PYRAMID


def test_more_facets_come_closer(statement: ForceStatement, exact: SolvedForces) -> None:
    best = compute_objective(statement, exact.force)
    off = [
        (
            compute_objective(statement, solve_forces(statement, "daqp", facets).force) / best - 1
        ).max()
        for facets in (4, 8, 64)
    ]
    assert off[0] > off[1] > off[2]
    assert off[2] < 1e-4


def test_literal_form_has_the_same_optimum(statement: ForceStatement, exact: SolvedForces) -> None:
    best = compute_objective(statement, exact.force)
    problems = build_unreduced_problems(statement)
    assert 7 + 9 * len(problems[0].normal) == 61
    answers = [solve_literal(problem) for problem in problems]
    force = np.stack([a.force for a in answers if a is not None])
    assert check_forces(statement, force).worst.max() < 1e-6
    np.testing.assert_allclose(compute_objective(statement, force), best, rtol=EXACT)


def test_cvxpy_has_the_same_optimum(statement: ForceStatement, exact: SolvedForces) -> None:
    pytest.importorskip("cvxpy")
    best = compute_objective(statement, exact.force)
    problems = build_unreduced_problems(statement)
    for k in (0, 1, 2, 11):
        answer = solve_cvxpy(problems[k])
        assert answer is not None
        force = np.zeros_like(exact.force)
        force[k] = answer.force
        assert compute_objective(statement, force)[k] == pytest.approx(best[k], rel=CVXPY)


@pytest.mark.parametrize("limbs", range(4, 9))
def test_solvers_agree_on_robots_of_many_kinds(
    braced_robot: RobotMaker, demo_climb: SceneMaker, limbs: int
) -> None:
    """Pyramid and cone planners find the same instants feasible, with optima that agree."""
    feasible = 0
    for seed in range(1, 5):
        scene = demo_climb(
            braced_robot(limbs, seed),
            **{
                "terrain.friction": 1.2,
                "force": {"safety_friction": 1.3},
                "task.rounds": 1,
                "task.goal": {"com": (0.0, 0.0, 0.05)},
            },
        )
        instants = plan_instants(scene, interpolate_rounds(scene))
        statement = build_force_statement(scene, instants)
        cones, pyramids = (solve_forces(statement, name, 16) for name in ("clarabel", "daqp"))
        np.testing.assert_array_equal(cones.missing, pyramids.missing)
        there = np.setdiff1d(np.arange(instants.count), cones.missing)
        feasible += len(there)
        off = compute_objective(statement, pyramids.force)[there]
        off /= compute_objective(statement, cones.force)[there]
        assert (off >= 1 - EXACT).all()
        assert np.median(off) <= 1 + PYRAMID
        assert check_forces(statement, pyramids.force).worst[there].max() <= 1e-7
    assert feasible > 5 * limbs


def test_answers_are_unique_and_repeatable(demo_scene: ClimbScene, demo_instants: Instants) -> None:
    """Neither order nor neighbours of an instant matter, although DAQP starts from neighbours."""
    whole = solve_forces(build_force_statement(demo_scene, demo_instants), "daqp", 16).force
    again = solve_forces(build_force_statement(demo_scene, demo_instants), "daqp", 16).force
    np.testing.assert_array_equal(whole, again)
    order = np.random.default_rng(0).permutation(demo_instants.count).tolist()
    shuffled = build_force_statement(demo_scene, rows_of(demo_instants, order))
    np.testing.assert_allclose(solve_forces(shuffled, "daqp", 16).force, whole[order], atol=1e-4)


def test_a_lying_solver_is_found_out(
    monkeypatch: pytest.MonkeyPatch,
    demo_scene: ClimbScene,
    demo_instants: Instants,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def liar(group: ReducedForces, facets: int) -> forces_module._Answers:
        return forces_module._Answers(
            np.zeros(group.particular.shape), np.ones(len(group.instant), bool)
        )

    caplog.set_level(logging.INFO)
    truth = plan_forces(demo_scene, demo_instants, "clarabel")
    monkeypatch.setitem(forces_module.SOLVERS, "daqp", liar)
    found = plan_forces(demo_scene, demo_instants, "daqp")
    # Where restrictions matter, Clarabel alone keeps them without the reserve.
    off = np.abs(found.force - truth.force).max(axis=(1, 2))
    assert np.median(off) < 1e-3
    assert off.max() < 0.2
    assert "36 instants without an answer of daqp" in caplog.text
    monkeypatch.setitem(forces_module.SOLVERS, "clarabel", liar)
    with pytest.raises(LimitReached, match="round 1, RF lifted"):
        plan_forces(demo_scene, demo_instants, "daqp")


def test_unknown_solver_is_named(demo_scene: ClimbScene, demo_instants: Instants) -> None:
    with pytest.raises(UsageError, match="'gurobi': expected one of daqp"):
        plan_forces(demo_scene, demo_instants, "gurobi")


@pytest.mark.parametrize("solver", ["daqp", "clarabel", "osqp"])
def test_nothing_presses_without_gravity(
    demo_climb: SceneMaker, demo_instants: Instants, solver: str
) -> None:
    scene = demo_climb(force={"normal_force_weight": 0.0})
    scene = replace(scene, robot=replace(scene.robot, gravity=0.0))
    found = plan_forces(scene, rows_of(demo_instants, [0, 1]), solver)
    np.testing.assert_allclose(found.force, 0, atol=1e-5)
    assert (found.safety_torque > 1e5).all()
    assert (found.safety_friction >= 1.8).all()


def test_a_large_weight_presses_as_hard_as_torque_allows(
    demo_climb: SceneMaker, demo_instants: Instants
) -> None:
    soft, hard = (
        solve_forces(
            build_force_statement(
                demo_climb(force={"normal_force_weight": w}), demo_instants
            ).as_published(),
            "daqp",
            16,
        ).force
        for w in (0.0, 5e-3)
    )
    statement = build_force_statement(demo_climb(), demo_instants)
    use = np.abs(np.einsum("knij,kni->knj", statement.jacobian, hard)) / statement.max_torque
    np.testing.assert_allclose(use.max(axis=(1, 2)), 1.0, rtol=1e-6)
    pressure = [(f * statement.normal).sum(axis=(1, 2)) for f in (soft, hard)]
    assert (pressure[1] > 1.5 * pressure[0]).all()


def test_payload_and_wind_are_carried(demo_climb: SceneMaker) -> None:
    payload = {"mass": 1.5, "offset": (0.0, 0.05, 0.1)}
    wind = {"force": (10.0, 5.0, 0.0), "moment": (0.0, 1.0, 0.0)}
    scene = demo_climb(**{"task.payload": payload, "task.external_wrench": wind})
    instants = plan_instants(scene, interpolate_rounds(scene))
    found = plan_forces(scene, instants)
    g = scene.robot.gravity
    np.testing.assert_allclose(
        found.force.sum(axis=1), np.tile([-10.0, -5.0, (10.3 + 1.5) * g], (36, 1)), atol=1e-4
    )
    moment = np.cross(instants.toes - instants.com[:, None], found.force).sum(axis=1)
    expected = -np.cross([0.0, 0.05, 0.1], [0, 0, -1.5 * g]) - [0.0, 1.0, 0.0]
    np.testing.assert_allclose(moment, np.tile(expected, (36, 1)), atol=1e-4)


def test_each_contact_has_its_own_friction(demo_scene: ClimbScene, demo_instants: Instants) -> None:
    mu = demo_instants.mu.copy()
    mu[:, 1], mu[:, 4] = 0.2, 3.0
    found = plan_forces(demo_scene, replace(demo_instants, mu=mu))
    assert (found.mu_critical <= mu / 1.8 * (1 + 1e-9)).all()
    assert (found.mu_critical[:, 4] > 0.2 / 1.8).any()


@given(
    low=st.floats(0.35, 1.2),
    more=st.floats(1.001, 2.0),
    row=st.integers(0, 35),
    shift=st.floats(-0.04, 0.04),
)
def test_more_friction_never_hurts(
    demo_scene: ClimbScene, demo_instants: Instants, low: float, more: float, row: int, shift: float
) -> None:
    one = rows_of(demo_instants, [row])
    one = replace(one, com=one.com + np.array([shift, -shift, shift]))
    worse = build_force_statement(demo_scene, replace(one, mu=np.full_like(one.mu, low)))
    before = solve_forces(worse, "daqp", 16)
    if len(before.missing):
        return
    better = build_force_statement(demo_scene, replace(one, mu=np.full_like(one.mu, low * more)))
    after = solve_forces(better, "daqp", 16)
    assert not len(after.missing)
    # Pyramids differ a little from one friction to the next.
    assert compute_objective(better, after.force) <= compute_objective(worse, before.force) * (
        1 + PYRAMID
    )
