"""Postures by nonlinear programming: plans, starts, the exact check, and what fails."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import yaml

from benchmarks.climb.random_climbs import random_climb
from climbplan.arrays import Array
from climbplan.climb.clearance.body import compute_body_shortfall, hull_world
from climbplan.climb.clearance.limbs import INTERPOLATION_MARGIN, compute_limb_points
from climbplan.climb.gait.gait import plan_instants
from climbplan.climb.plan.climb_plan import Rounds
from climbplan.climb.postures.nlp.check import check_postures, compute_posture_cost
from climbplan.climb.postures.nlp.layout import build_variable_layout
from climbplan.climb.postures.nlp.method import plan_postures_nlp, refine_attempt, solve_from
from climbplan.climb.postures.nlp.parameters import (
    build_initial_point,
    build_parameters,
    build_shape,
    build_variable_bounds,
    extract_rounds,
    find_separating_planes,
)
from climbplan.climb.postures.nlp.problem import build_posture_problem
from climbplan.climb.postures.nlp.starts import build_convex_guess, build_straight_guess
from climbplan.climb.postures.nlp.statement import bound_chord_deviation, compile_posture_nlp
from climbplan.climb.postures.planner import plan_postures
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_climb
from climbplan.errors import LimitReached, NoPlanFound, ReachFailure, Unresolved
from climbplan.methods.table import solve_instance
from climbplan.methods.task import Method
from climbplan.program.layout import MatrixLayout
from climbplan.robots.kinematics import joint_points_body
from climbplan.robots.rotations import rotation_world_body
from climbplan.schema.terrain.terrain import SolidSpec
from climbplan.terrain.solids import Solid
from climbplan.terrain.surfaces import Tube

SPECS = Path(__file__).parents[3] / "specs"
FOREVER = float("inf")


def scene_of(base: dict[str, Any], *overrides: str, tmp_path: Path) -> ClimbScene:
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(base))
    loaded = load_climb(path, overrides)
    return build_scene(loaded.spec, loaded.robot)


WALLS: dict[str, Any] = {
    "kind": "climb",
    "robot": "silvia",
    "terrain": {
        "friction": 1.0,
        "walls": {"gap": 1.23, "along": [-0.8, 0.8], "up": [-1.0, 2.0]},
    },
    "task": {
        "rounds": 4,
        "start": {"com": [0.0, 0.0, 0.0]},
        "goal": {"com": [0.0, 0.0, 0.4]},
    },
    "solver": {"method": "nlp", "starts": 2},
}


@pytest.fixture
def walls(tmp_path: Path) -> ClimbScene:
    return scene_of(WALLS, tmp_path=tmp_path)


def shipped(name: str, *overrides: str) -> ClimbScene:
    loaded = load_climb(SPECS / f"{name}.yaml", overrides)
    return build_scene(loaded.spec, loaded.robot)


def test_spiral_up_the_tube() -> None:
    scene = shipped("climb_tube")
    result = plan_postures_nlp(scene)
    rounds = result.rounds

    assert result.status == "feasible"
    assert result.bound is None
    assert result.gap is None
    assert result.sizes["accepted"] == scene.spec.solver.starts
    tube = scene.terrain.surfaces[0]
    assert isinstance(tube, Tube)
    np.testing.assert_allclose(
        np.linalg.norm(rounds.toes[..., :2], axis=-1), tube.radius, atol=1e-9
    )
    # The turn is far beyond the limit that holds roll and pitch
    limit = scene.spec.posture.rotation_limit_deg
    assert np.rad2deg(rounds.rpy[-1, 2]) == pytest.approx(75.0, abs=0.5)
    assert np.rad2deg(np.abs(rounds.rpy[:, :2])).max() < limit < 75.0
    np.testing.assert_allclose(rounds.com[-1], scene.goal.com, atol=0.02)
    assert np.isfinite(plan_instants(scene, rounds).joint_angles).all()
    assert result.objective == pytest.approx(compute_posture_cost(scene, rounds))


def test_agrees_with_the_convex_optimum_where_both_apply(walls: ClimbScene) -> None:
    convex, local = plan_postures(walls), plan_postures_nlp(walls)
    assert local.objective == pytest.approx(convex.objective, rel=2e-4)
    assert convex.bound is not None
    assert local.objective >= convex.bound - 1e-9


def test_convex_plan_is_the_first_start(walls: ClimbScene, tmp_path: Path) -> None:
    guess = build_convex_guess(walls, time_limit=60.0)
    assert guess is not None
    assert solve_from(walls, guess, FOREVER).is_accepted
    turned = scene_of(WALLS, "task.goal.rpy_deg=[0, 0, 18]", tmp_path=tmp_path)
    assert build_convex_guess(turned, time_limit=60.0) is None
    assert build_convex_guess(shipped("climb_tube"), time_limit=60.0) is None


def test_lower_step_bounds_hold_and_cost(walls: ClimbScene, tmp_path: Path) -> None:
    least = scene_of(
        WALLS,
        "posture.steps.com_min=0.11",
        "posture.steps.toe_min=0.13",
        tmp_path=tmp_path,
    )
    free, bound = plan_postures_nlp(walls), plan_postures_nlp(least)
    com = np.linalg.norm(np.diff(bound.rounds.com, axis=0), axis=-1)
    toes = np.linalg.norm(np.diff(bound.rounds.toes, axis=0), axis=-1)
    assert com.min() >= 0.11 - 1e-6
    assert toes.min() >= 0.13 - 1e-6
    assert toes.min() < 0.131  # the bound is what holds the steps up
    assert bound.objective > free.objective


def test_way_round_the_obstacle() -> None:
    scene = shipped("climb_obstacle", "solver.method=nlp")
    share = np.linspace(0.0, 1.0, scene.spec.task.rounds + 1)[:, None]
    line = scene.start.com + share * (scene.goal.com - scene.start.com)
    start = build_straight_guess(scene, 0, 0.0).rounds
    assert (
        compute_body_shortfall(scene, replace(start, com=line)).max() > 0.1
    )  # the beam is in the way
    assert compute_body_shortfall(scene, start).max() < 0.02  # already the start goes round it
    attempts = [
        solve_from(scene, build_straight_guess(scene, k, float(k > 0)), FOREVER) for k in range(2)
    ]
    assert all(attempt.is_accepted for attempt in attempts)
    for attempt in attempts:
        assert compute_body_shortfall(scene, attempt.rounds).max() <= 1e-6
        assert link_room(scene, attempt.rounds).min() >= 0.8 * scene.robot.limb_radius
        assert (attempt.rounds.region[1:-1] != attempt.rounds.region[0]).any()
    # Starts differ in what they pin, so they end in different plans
    assert len({round(attempt.objective, 6) for attempt in attempts}) > 1

    best = min(attempts, key=lambda attempt: attempt.objective)
    again = refine_attempt(scene, best, FOREVER)
    assert again.is_accepted
    assert again.objective < 0.999 * best.objective  # pins chosen anew at the plan


def link_room(scene: ClimbScene, rounds: Rounds) -> Array:
    """Least room (K, N) between link axes and obstacles, followed closely along every link."""
    instants = plan_instants(scene, rounds)
    points = joint_points_body(scene.robot, instants.joint_angles)
    turned = np.einsum("kab,knjb->knja", rotation_world_body(instants.rpy), points)
    points = instants.com[:, None, None] + turned
    share = np.linspace(0.0, 1.0, 401)[:, None, None]
    axes = points[..., None, :-1, :] * (1 - share) + points[..., None, 1:, :] * share
    room = [solid.face_distance(axes).min(axis=(-2, -1)) for solid in scene.terrain.obstacles]
    least: Array = np.min(room, axis=0)
    return least


def test_limbs_do_not_pass_through_what_the_convex_plan_ignores() -> None:
    scene = shipped("climb_tube")
    free = solve_from(scene, build_straight_guess(scene, 0, 0.0), FOREVER)
    # A bar beside the body, where two limbs stand in the plan without it
    bar = SolidSpec(name="bar", lower=(-0.5, 0.3, 0.1), upper=(0.5, 0.34, 0.2))
    terrain = scene.spec.terrain.model_copy(update={"obstacles": (bar,)})
    solid = Solid.from_spec(bar)
    blocked = replace(
        scene,
        spec=scene.spec.model_copy(update={"terrain": terrain}),
        terrain=replace(scene.terrain, obstacles=(solid,)),
    )
    failing = [v for v in check_postures(blocked, free.rounds) if not v.holds]
    assert [violation.name for violation in failing] == ["limbs.axis_collision"]
    assert "RF" in str(failing[0]) or "LF" in str(failing[0])
    # The way out is no shorter than the links are deep
    asked = blocked.robot.limb_radius + INTERPOLATION_MARGIN
    assert failing[0].amount >= asked - link_room(blocked, free.rounds).min() - 1e-3


def test_links_beside_a_bar_need_room_for_their_radius() -> None:
    scene = shipped("climb_tube")
    free = solve_from(scene, build_straight_guess(scene, 0, 0.0), FOREVER)
    instants = plan_instants(scene, free.rounds)
    points = compute_limb_points(scene, instants.com, instants.rpy, instants.toes)
    highest = points[..., 2].max()
    for gap, holds in ((0.020, False), (0.026, True)):
        lower = np.array([-0.6, -0.6, highest + gap])
        lid = Solid.from_box("lid", lower, lower + np.array([1.2, 1.2, 0.1]))
        under = replace(scene, terrain=replace(scene.terrain, obstacles=(lid,)))
        found = {v.name: v for v in check_postures(under, free.rounds)}["limbs.axis_collision"]
        # Between the instants, too, the highest point may rise a little
        assert found.holds == holds or found.amount < 1e-4
        assert found.amount == pytest.approx(
            scene.robot.limb_radius + INTERPOLATION_MARGIN - gap, abs=1e-3
        )


def test_parting_planes_touch_the_solid_and_part_what_is_apart() -> None:
    box = Solid.from_box("box", np.array([-0.2, -0.1, 0.0]), np.array([0.2, 0.1, 0.3]))
    rng = np.random.default_rng(0)
    starts, ends = rng.uniform(-0.6, 0.6, (2, 500, 3))
    planes = find_separating_planes(box, starts, ends)
    normals, offsets = planes[:, :3], planes[:, 3]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    np.testing.assert_allclose((normals @ box.vertices.T).max(axis=1), offsets)
    ends_room = [np.einsum("ka,ka->k", normals, x) - offsets for x in (starts, ends)]
    parted = np.minimum(*ends_room) > 0
    share = np.linspace(0.0, 1.0, 201)[:, None, None]
    inside = (box.face_distance(starts + share * (ends - starts)) < 0).any(axis=0)
    assert not (parted & inside).any()
    # Edges and corners part what no face does
    by_face = np.minimum(*(x @ box.A.T - box.b for x in (starts, ends))).max(axis=1) > 0
    assert (parted | ~by_face).all()
    assert by_face.sum() < parted.sum() > 0.85 * (~inside).sum()


def test_same_seed_same_plan_whatever_ran_before(walls: ClimbScene, tmp_path: Path) -> None:
    first = plan_postures_nlp(walls)
    other = scene_of(WALLS, "task.goal.com=[0, 0.1, 0.3]", "seed=5", tmp_path=tmp_path)
    plan_postures_nlp(other)  # shares the built program
    assert build_shape(other) == build_shape(walls)
    again = plan_postures_nlp(walls)
    np.testing.assert_array_equal(first.rounds.com, again.rounds.com)
    np.testing.assert_array_equal(first.rounds.toes, again.rounds.toes)
    assert not np.array_equal(
        build_straight_guess(walls, 1, 1.0).rounds.toes,
        build_straight_guess(walls, 2, 1.0).rounds.toes,
    )


def test_a_start_does_not_depend_on_how_many_there_are(walls: ClimbScene) -> None:
    alone = build_straight_guess(walls, 3, 1.0)
    for k in range(3):
        build_straight_guess(walls, k, 1.0)
    np.testing.assert_array_equal(
        alone.rounds.toes, build_straight_guess(walls, 3, 1.0).rounds.toes
    )


def test_yaw_is_bounded_on_flat_terrain_only(walls: ClimbScene, tmp_path: Path) -> None:
    turned = scene_of(WALLS, "task.start.rpy_deg=[0, 0, 5]", tmp_path=tmp_path)
    limits = ((walls, 20.0), (turned, 25.0), (shipped("climb_tube"), np.inf))
    for scene, expected in limits:
        _, upper = build_variable_bounds(scene, 0.0)
        layout = build_variable_layout(scene.robot.limb_count, scene.robot.joint_count)
        upper = layout.unpack(upper.reshape(-1, layout.size))["rpy"]
        np.testing.assert_allclose(upper[:, 2, 0], np.deg2rad(expected))


def test_statement_and_check_agree(walls: ClimbScene) -> None:
    """Rows of the NLP and the exact check call the same postures good and bad."""
    for scene in (walls, shipped("climb_tube"), shipped("climb_obstacle", "solver.method=nlp")):
        program = compile_posture_nlp(build_shape(scene), 150)
        guess = build_straight_guess(scene, 0, 0.0)
        good = solve_from(scene, guess, FOREVER)
        assert good.is_accepted
        good_guess = replace(guess, rounds=good.rounds)
        x = build_initial_point(scene, good_guess, build_variable_bounds(scene, 0.0))
        numbers = program.formulation.theta(build_parameters(scene, good_guess))
        blocks = program.formulation.residuals(program.solver.rows(x, numbers))
        assert max(block.residual for block in blocks) < 1e-6
        assert {block.unit for block in blocks} == {"m", "rad"}
        judged = {v.name for v in check_postures(scene, good.rounds)}
        assert {block.name for block in blocks} <= judged

        # Any posture moved by a few centimetres breaks some row, and the check sees it too
        rng = np.random.default_rng(1)
        for _ in range(5):
            moved = x + 0.0
            layout = build_variable_layout(scene.robot.limb_count, scene.robot.joint_count)
            j = int(rng.integers(scene.spec.task.rounds))
            moved[j * layout.size : j * layout.size + 3] += rng.normal(0.0, 0.3, 3)
            blocks = program.formulation.residuals(program.solver.rows(moved, numbers))
            assert max(block.residual for block in blocks) > 1e-3
            found = check_postures(scene, extract_rounds(scene, good_guess, moved))
            assert any(violation.amount > 1e-3 for violation in found)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("steps.com", lambda r: r.com.__setitem__((2, 2), r.com[2, 2] + 0.2)),
        ("steps.rotation", lambda r: r.rpy.__setitem__((2, 0), 0.3)),
        ("rotation.limit", lambda r: r.rpy.__setitem__((slice(1, None), 1), 0.4)),
        ("steps.toe", lambda r: r.toes.__setitem__((2, 4, 2), r.toes[2, 4, 2] + 0.3)),
        ("workspace.stance", lambda r: r.toes.__setitem__((2, 4, 2), r.toes[2, 4, 2] + 0.2)),
        ("workspace.reach", lambda r: r.toes.__setitem__((2, 4, 2), r.toes[2, 4, 2] + 0.7)),
        ("contact.region", lambda r: r.toes.__setitem__((3, 1, 0), 0.61)),
        ("goal.position", lambda r: r.com.__setitem__((4, 2), 0.43)),
        ("goal.position", lambda r: r.toes.__setitem__((4, 0, 2), r.toes[4, 0, 2] + 0.03)),
        ("goal.rotation", lambda r: r.rpy.__setitem__((4, 2), 0.1)),
        ("kinematics.forward", lambda r: r.com.__setitem__((2, 0), 0.4)),
    ],
)
def test_check_and_statement_name_what_is_broken(walls: ClimbScene, name: str, change: Any) -> None:
    guess = build_straight_guess(walls, 0, 0.0)
    rounds = solve_from(walls, guess, FOREVER).rounds
    broken = replace(rounds, com=rounds.com.copy(), rpy=rounds.rpy.copy(), toes=rounds.toes.copy())
    assert all(violation.holds for violation in check_postures(walls, broken))
    change(broken)
    failing = {v.name: v for v in check_postures(walls, broken) if not v.holds}
    assert name in failing
    assert "round" in str(failing[name])
    if name == "rotation.limit":
        return  # bounds of variables
    program = compile_posture_nlp(build_shape(walls), 150)
    there = replace(guess, rounds=broken)
    x = build_initial_point(walls, there, build_variable_bounds(walls, 0.0))
    rows = program.solver.rows(x, program.formulation.theta(build_parameters(walls, guess)))
    blocks = {block.name for block in program.formulation.residuals(rows) if block.residual > 1e-3}
    assert blocks >= {v.name for v in failing.values() if v.amount > 1e-2} - {"rotation.limit"}
    assert name in blocks


@pytest.mark.parametrize("method", ["nlp", "mpcc"])
def test_methods_of_the_common_table_take_the_program(walls: ClimbScene, method: Method) -> None:
    guess = build_straight_guess(walls, 0, 0.0)
    problem, theta = build_posture_problem(walls, guess)
    sizes = compile_posture_nlp(build_shape(walls), 150).formulation.sizes()
    counts = problem.program.counts()
    assert counts["by_block"] == {name: rows for name, rows in sizes.items() if rows}
    assert 0 < counts["linear_rows"] < counts["smooth_rows"]
    answer = solve_instance(problem, theta, method).result
    assert answer.x is not None
    rounds = extract_rounds(walls, guess, answer.x)
    assert all(violation.holds for violation in check_postures(walls, rounds))
    own = solve_from(walls, guess, FOREVER)
    assert answer.objective == pytest.approx(own.objective, rel=1e-6)
    np.testing.assert_allclose(rounds.com, own.rounds.com, atol=1e-5)


def test_a_goal_missed_names_body_or_limb(walls: ClimbScene) -> None:
    for moved, where in (("com", "body"), ("toes", "limb LM")):
        rounds = build_straight_guess(walls, 0, 0.0).rounds
        limb = walls.robot.limb_names.index("LM")
        point = rounds.com[4] if moved == "com" else rounds.toes[4, limb]
        point[2] += walls.spec.task.goal.tolerance + 0.03
        found = {v.name: v for v in check_postures(walls, rounds)}
        assert str(found["goal.position"]) == f"goal.position at round 4, {where} by 30 mm"


def test_check_refuses_a_diverged_answer(walls: ClimbScene) -> None:
    rounds = build_straight_guess(walls, 0, 0.0).rounds
    rounds.com[2] = np.nan
    found = {v.name: v for v in check_postures(walls, rounds)}
    assert found["steps.com"].amount == np.inf


def test_bulge_covers_every_way_of_the_body() -> None:
    turn = ca.SX.sym("turn", 3)
    bulge = ca.Function("bulge", [turn], [bound_chord_deviation(turn, 1.0)])
    rng = np.random.default_rng(0)
    share = np.linspace(0.0, 1.0, 101)
    for _ in range(200):
        start, step = rng.uniform(-1.0, 1.0, 3), rng.uniform(-0.5, 0.5, 3)
        corner = rng.normal(size=3)
        corner /= np.linalg.norm(corner)
        way = rotation_world_body(start + share[:, None] * step) @ corner
        chord = way[0] + share[:, None] * (way[-1] - way[0])
        assert np.linalg.norm(way - chord, axis=1).max() <= float(bulge(step)) + 1e-12


def test_body_stays_inside_a_narrow_tube() -> None:
    """Turned in a tube hardly wider than its body, the robot keeps the clearance all the way."""
    scene = shipped("climb_tube", "posture.body_clearance=0.35")
    rounds = solve_from(scene, build_straight_guess(scene, 1, 1.0), FOREVER).rounds
    corners = hull_world(scene, rounds.com, rounds.rpy)
    assert np.linalg.norm(corners[..., :2], axis=-1).max() <= 0.615 - 0.35 + 1e-6


def test_layout_finds_what_it_packs() -> None:
    layout = MatrixLayout((("a", (3, 2)), ("b", (1, 4)), ("c", (1, 1))))
    rng = np.random.default_rng(0)
    values = {name: rng.normal(size=shape) for name, shape in layout.shapes}
    one = layout.pack(values)
    assert one.tolist()[:4] == [*values["a"].T.ravel()[:4]]  # by columns
    many = layout.pack(values | {"a": np.stack([values["a"] + k for k in range(4)])})
    np.testing.assert_array_equal(many[0], one)
    found = layout.unpack(many)
    for name, value in values.items():
        np.testing.assert_array_equal(found[name][3], value + 3 * (name == "a"))
    np.testing.assert_array_equal(layout.pack(values | {"b": np.array(2.0)})[6:10], 2.0)


def test_a_way_that_steps_cannot_cover_needs_no_solver(tmp_path: Path) -> None:
    far = scene_of(WALLS, "task.goal.com=[0, 0, 0.9]", tmp_path=tmp_path)
    with pytest.raises(Unresolved, match=r"0\.880 m in steps of at most 150 mm, takes 6 rounds"):
        plan_postures_nlp(far)
    turn = shipped("climb_tube", "task.goal.rpy_deg=[0, 0, 150]")
    with pytest.raises(Unresolved, match=r"147\.0 deg in steps of at most 10 deg, takes 15"):
        plan_postures_nlp(turn)


def test_start_out_of_reach_names_the_limb() -> None:
    scene = shipped("climb_tube", "task.start.com=[0.25, 0, 0]")
    with pytest.raises(ReachFailure, match=r"start posture: \w\w cannot reach its toe: \w+"):
        plan_postures_nlp(scene)


def test_failure_names_the_constraint_and_proves_nothing() -> None:
    scene = shipped(
        "climb_tube",
        "posture.body_clearance=0.37",
        "solver.starts=2",
        "task.rounds=2",
        "task.goal={com: [0, 0, 0.1], rpy_deg: [0, 0, 10]}",
    )
    with pytest.raises(Unresolved) as failure:
        plan_postures_nlp(scene)
    assert "no start of 2 converged: the closest violates body.clearance at round" in str(
        failure.value
    )
    assert " by " in str(failure.value)


def test_time_limit_stops_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    # The convex guess may already be a plan when time is up; the straight way hits the beam.
    monkeypatch.setattr(
        "climbplan.climb.postures.nlp.method.build_convex_guess", lambda *_, **__: None
    )
    scene = shipped("climb_obstacle", "solver.method=nlp", "solver.time_limit=1e-6")
    with pytest.raises(LimitReached, match=r"no start of 1 \(of 4 asked for\) converged"):
        plan_postures_nlp(scene)


def test_progress_is_reported(walls: ClimbScene) -> None:
    seen: list[float] = []
    plan_postures_nlp(walls, lambda stage, fraction: seen.append(fraction))
    assert seen == [0.0, 0.5]


def test_rows_that_are_always_zero_are_taken(tmp_path: Path) -> None:
    """Limbs straight out from the middle of the body leave some rows without any entry."""
    scene = load_climb(random_climb(13, tmp_path), ["solver.starts=1", "solver.time_limit=5"])
    built = build_scene(scene.spec, scene.robot, scene.source, scene.directory)
    with contextlib.suppress(NoPlanFound):
        plan_postures_nlp(built)
