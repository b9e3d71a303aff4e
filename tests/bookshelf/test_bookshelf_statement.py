"""The bookshelf as a program: what it lets pass is what the exact checks let pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from climbplan.bookshelf.check.checker import check_contact
from climbplan.bookshelf.check.published import ROUNDING, check_published, infer_published_states
from climbplan.bookshelf.exact.method import ExactSolver
from climbplan.bookshelf.methods.table_method import build_published_partitions
from climbplan.bookshelf.plan.answer import Placement
from climbplan.bookshelf.scene.scene_file import read_scenes
from climbplan.bookshelf.scene.shelf_scene import Scenes, Shelf, ShelfScene
from climbplan.bookshelf.statement.points import (
    build_initial_placement,
    build_point,
    build_theta,
    extract_placement,
    snap_to_states,
)
from climbplan.bookshelf.statement.statement import build_bookshelf_program
from climbplan.reformulations.mccormick import McCormick
from climbplan.solvers.ipopt.instances import solve_fixed_integers
from climbplan.solvers.scip.bilinear import solve_minlp_scip

SHELF = Shelf()


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    return read_scenes(Path(__file__).parents[2] / "specs" / "bookshelf_scenes.h5")


@pytest.fixture(scope="module")
def optima(scenes: Scenes) -> list[Placement]:
    solver = ExactSolver(SHELF)
    found = [solver.solve(scene).placement for scene in scenes]
    return [placement for placement in found if placement is not None]


def test_optima_satisfy_the_statement(scenes: Scenes, optima: list[Placement]) -> None:
    program = build_bookshelf_program(3, SHELF)
    for scene, placement in zip(scenes, optima, strict=True):
        x = build_point(program, scene, placement)
        report = program.check(x, build_theta(scene))
        assert max(block.residual for block in report.blocks) < 1e-4
        back = extract_placement(program, scene, x)
        np.testing.assert_allclose(back.pose, placement.pose, atol=1e-12)
        np.testing.assert_array_equal(back.state, placement.state)
        assert back.slot == placement.slot


def test_the_statement_and_the_check_refuse_the_same(
    scenes: Scenes, optima: list[Placement]
) -> None:
    """Poses moved and states changed at random: both refuse, or both accept."""
    rng, program, refused, passed = (
        np.random.default_rng(0),
        build_bookshelf_program(3, SHELF),
        0,
        0,
    )
    for scene, placement in zip(scenes, optima, strict=True):
        for size in (0.0, 1e-3, 5e-3, 2e-2):
            pose, state = placement.pose.copy(), placement.state.copy()
            pose[rng.integers(4), 0] += size * rng.choice([-1, 1])
            if rng.random() < 0.2:
                state[rng.integers(3)] = rng.integers(5)
            changed = snap_to_states(scene, Placement(pose, state, 0))
            one = Scenes.of([scene])
            check = check_contact(one, changed.pose[None], changed.state[None], SHELF)
            x = build_point(program, scene, changed)
            violation = program.instantiate(build_theta(scene)).violation(x)
            if check.passed[0]:
                passed += 1
                assert violation < 1.5e-2  # [mm], or twice the check's limit of an angle
            elif check.worst(0).severity[0] > 3:
                refused += 1
                assert violation > 1e-5, check.explain(0)
    assert passed > 40
    assert refused > 40


def test_published_points_break_the_statement_where_they_break_the_check(
    scenes: Scenes, optima: list[Placement]
) -> None:
    program = build_bookshelf_program(3, SHELF, "published")
    compared = 0
    for scene, placement in zip(scenes, optima, strict=True):
        one, pose = Scenes.of([scene]), placement.pose.copy()
        pose[:, 0] *= 0.88  # books into each other
        state = infer_published_states(one, pose[None], SHELF)[0]
        check = check_published(one, pose[None], state[None], SHELF)
        if not np.isfinite(check["book.state"].residual[0]):
            continue
        x = build_point(program, scene, Placement(pose, state, placement.slot))
        blocks = program.check(x, build_theta(scene)).blocks
        separation = check["book.separation"]
        stated = max(b.residual for b in blocks if b.name in ("line.left", "line.right"))
        leaning = np.isin(state, (1, 3)).any()
        beyond = separation.residual[0] - separation.limit + ROUNDING
        if beyond > 1e-6:
            compared += 1
            # A line that passes two corners may separate worse than the best one
            assert stated >= beyond - 1e-9
            if not leaning:
                assert stated == pytest.approx(beyond, abs=1e-9)
    assert compared > 5


def test_pinned_states_lead_back_to_the_optimum(scenes: Scenes, optima: list[Placement]) -> None:
    """IPOPT from a point nearby, integers kept, finds the optimum that branch and bound proved."""
    program, solver = build_bookshelf_program(3, SHELF), ExactSolver(SHELF)
    near = 0
    for k in range(6):
        scene = scenes[k]
        best = solver.solve(scene)
        start = build_point(program, scene, optima[k])
        instance = program.instantiate(build_theta(scene))
        found = solve_fixed_integers(instance, start)
        assert instance.violation(found.v) < 1e-5
        assert instance.objective(found.v) > best.bound - 1e-3
        near += instance.objective(found.v) <= 1.001 * best.objective + 1e-3
    assert near == 6


def test_scip_bounds_hold(scenes: Scenes) -> None:
    """With normals known to 1e-3 SCIP's own tolerances would cut the optimum off."""
    pose = np.array(
        [
            [-0.05082238, 0.03984111, 0.48375245],
            [0.04454982, 0.03595502, -0.00057094],
            [0.06952621, 0.03991404, -0.00065498],
        ]
    )
    size = np.array([[0.075, 0.029], [0.072, 0.019], [0.080, 0.023]])
    scene = ShelfScene(pose, size, np.array([0.086, 0.040]))
    program, best = build_bookshelf_program(3, SHELF), ExactSolver(SHELF).solve(scene)
    assert best.placement is not None
    x = build_point(program, scene, best.placement)
    instance = program.instantiate(build_theta(scene))
    normal = program.variables["normal"]
    lower, upper = instance.lower.copy(), instance.upper.copy()
    here = slice(normal.start, normal.stop)
    lower[here], upper[here] = x[here] - 1e-3, x[here] + 1e-3
    result = solve_minlp_scip(replace(instance, lower=lower, upper=upper), time_limit=20)
    assert result.bound <= best.objective + 1e-9


def test_the_published_counts() -> None:
    """130 binaries with the published pieces, whatever the meaning."""
    for meaning in ("contact", "published"):
        program = build_bookshelf_program(3, SHELF, meaning)  # type: ignore[arg-type]
        assert program.counts()["binary"] == 18
        scene = ShelfScene(np.zeros((3, 3)), np.full((3, 2), 0.05), np.array([0.05, 0.02]))
        parts = build_published_partitions(program)
        form = McCormick(parts, "log2").apply(program.instantiate(build_theta(scene)))
        assert form.instance.binary_count == 130


@pytest.mark.parametrize("count", [1, 2, 4])
def test_any_number_of_books(count: int) -> None:
    half = 0.0223 * (count + 1)
    shelf = replace(SHELF, left=-half, right=half)
    x = np.linspace(-half + 0.01, half - 0.03, count)
    pose = np.column_stack([x, np.full(count, 0.03), np.zeros(count)])
    scene = ShelfScene(pose, np.full((count, 2), [0.06, 0.012]), np.array([0.07, 0.02]))
    answer = ExactSolver(shelf).solve(scene)
    assert answer.placement is not None
    program = build_bookshelf_program(count, shelf)
    point = build_point(program, scene, answer.placement)
    instance = program.instantiate(build_theta(scene))
    assert instance.violation(point) < 1e-6
    assert instance.objective(point) == pytest.approx(answer.objective, rel=1e-9, abs=1e-9)
    assert build_initial_placement(scene).pose.shape == (count + 1, 3)
