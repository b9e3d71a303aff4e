"""Method `admm`: both blocks, their agreement, and the plan that is made of it."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limms_scenes import loaded, scene

from climbplan.errors import LimitReached, Unresolved
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.consensus.admm import AdmmParameters, compute_residual, run_admm
from climbplan.limms.consensus.block_solution import BlockSolution, LocalCopy
from climbplan.limms.consensus.link_cuts import LENGTH_TOLERANCE
from climbplan.limms.consensus.mixed_integer import MixedIntegerBlock
from climbplan.limms.consensus.nonlinear import NonlinearBlock, select_regions
from climbplan.limms.consensus.planner import PlanningProgress, find_first_integers
from climbplan.limms.consensus.problem import (
    FREE,
    HELD,
    STABLE,
    ConsensusProblem,
    build_problem,
    compute_start_points,
)
from climbplan.limms.consensus.projection import Projection
from climbplan.limms.consensus.refinement import build_action
from climbplan.limms.modules.chain import forward
from climbplan.limms.pages.figure_convergence import plot_convergence
from climbplan.limms.plan.convergence import RESIDUALS
from climbplan.limms.plan.file import read_limms_plan, write_limms_plan
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.scene.limms_scene import GRAVITY, FramePoses


@pytest.fixture(scope="module")
def setting() -> ConsensusProblem:
    return build_problem(scene("limms_throw"), 8)


@pytest.fixture(scope="module")
def block(setting: ConsensusProblem) -> MixedIntegerBlock:
    return MixedIntegerBlock(setting)


@pytest.fixture(scope="module")
def first(block: MixedIntegerBlock) -> BlockSolution:
    block.fix_behaviour("arms")
    return block.find_feasible(600)


@pytest.fixture(scope="module")
def thrown() -> LimmsPlan:
    return plan_limms(loaded("limms_throw", "solver.method=admm"))


def test_first_block_throws_and_obeys_its_dynamics(
    setting: ConsensusProblem, first: BlockSolution
) -> None:
    assert first.modes is not None
    assert first.copy is not None
    assert first.velocity is not None
    box, held = first.modes.box, first.modes.box == HELD
    assert box[0] == STABLE
    assert box[-1] == FREE
    assert build_action(first.modes).kind == "throw"
    assert first.goal_error < 1e-3
    # Held from the wall wherever it is held, and nothing else ever
    assert ((first.modes.hold[0] >= 0) == held).all()
    assert (first.modes.wall[0, held] == 0).all()
    at, v = first.copy.box, first.velocity
    for k in range(setting.intervals):
        h = setting.formulation.interval_seconds[box[k]]
        assert np.allclose(at[k + 1] - at[k], h * (v[k] + v[k + 1]) / 2, atol=1e-6)
        if box[k] == FREE:
            assert np.allclose(v[k + 1] - v[k], [0, 0, -GRAVITY * h], atol=1e-6)
        if box[k] == STABLE:
            assert np.allclose(at[k + 1], at[0], atol=1e-6)


def test_links_of_the_first_answer_are_not_too_long(
    setting: ConsensusProblem, first: BlockSolution
) -> None:
    assert first.copy is not None
    lengths = np.linalg.norm(np.diff(first.copy.points, axis=2), axis=-1)
    assert (lengths <= (1 + LENGTH_TOLERANCE) * setting.link_lengths + 1e-6).all()


def test_frozen_block_projects(
    setting: ConsensusProblem, block: MixedIntegerBlock, first: BlockSolution
) -> None:
    assert first.copy is not None
    assert first.modes is not None
    assert first.x is not None
    projection = Projection(block, first.x)
    again = projection.solve(first.copy, 100.0, first.modes.region)
    assert again.copy is not None
    assert again.worst_rows is not None
    assert np.abs(again.copy.points - first.copy.points).max() < 0.01
    # Far away: as near as rows, goal and links allow, nearer than the answer before
    points = first.copy.points + np.array([0.05, -0.1, 0.15])
    far = projection.solve(LocalCopy(first.copy.box, points), 100.0, first.modes.region)
    assert far.copy is not None
    assert far.worst_rows is not None
    assert far.worst_rows.residual < 1e-6
    assert far.goal_error < 1e-3
    gone = np.linalg.norm(far.copy.points - points), np.linalg.norm(first.copy.points - points)
    assert gone[0] < 0.9 * gone[1]
    lengths = np.linalg.norm(np.diff(far.copy.points, axis=2), axis=-1)
    assert (lengths <= (1 + LENGTH_TOLERANCE) * setting.link_lengths + 1e-6).all()


def test_links_go_to_the_free_blocks_that_they_are_in() -> None:
    heavy = build_problem(scene("limms_lift_heavy"), 8)
    module, count = heavy.scene.module, heavy.scene.num_modules
    stand = [FramePoses(at, np.eye(3)) for at in heavy.scene.start_position]
    placed = [forward(module, base, np.zeros(6)) for base in stand]
    low, ledge = 0, 1
    found = select_regions(heavy, placed, np.full((count, 4), low))
    # A and B stand upright on the ledge, C and D below it, and rise into both blocks
    assert found.tolist() == [[ledge] * 4, [ledge] * 4, [low] * 4, [low] * 4]
    found = select_regions(heavy, placed, np.full((count, 4), ledge))
    assert found[:2].tolist() == [[ledge] * 4, [ledge] * 4]
    assert (found[2:, 0] == low).all()
    assert (found[2:, -1] == ledge).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["limms_lift_heavy", "limms_lift_light"])
def test_blocks_agree_within_a_centimetre(name: str) -> None:
    """Feet that stand still, free blocks of links, and an arm that planes round balls let reach."""
    given = build_problem(scene(name), 8)
    block = MixedIntegerBlock(given)
    found = find_first_integers(given.scene, block, PlanningProgress(), time.monotonic() + 600)
    assert found is not None
    parameters = AdmmParameters(15, 1.3, 1.0, 0)
    agreement = run_admm(block, NonlinearBlock(given), found, parameters, time.monotonic() + 600)
    assert agreement is not None
    best = agreement.best
    assert best.residual.has_converged
    assert best.violation < 1e-4
    assert max(best.residual.box) < 0.01
    assert best.residual.points[0] < 0.005


def test_second_block_has_exact_links_and_latches(
    setting: ConsensusProblem, first: BlockSolution
) -> None:
    assert first.modes is not None
    assert first.copy is not None
    bent = NonlinearBlock(setting).solve(first.copy, first.modes, time.monotonic() + 60)
    assert bent.violation < 1e-4
    assert bent.penetration < 1e-3
    links = np.linalg.norm(np.diff(bent.copy.points, axis=2), axis=-1)
    assert np.allclose(links, setting.link_lengths, atol=1e-9)
    assert np.array_equal(bent.copy.points[0], compute_start_points(setting))
    k = int(np.flatnonzero(first.modes.box == HELD)[0])
    side = int(first.modes.hold[0, k])
    hand = bent.copy.box[k] + setting.scene.side_offset(0, side)
    assert np.abs(bent.copy.points[k, 0, 0] - hand).max() < 1e-4
    assert np.abs(bent.copy.points[k, 0, 4] - setting.scene.wall_position[0]).max() < 1e-4


def test_residuals_are_those_of_the_definition(
    setting: ConsensusProblem, first: BlockSolution
) -> None:
    assert first.copy is not None
    same = compute_residual(setting, first.copy, first.copy)
    assert same.box == same.points == same.axes == (0.0, 0.0)
    moved = first.copy.points.copy()
    moved[3, 0] += [0.0, 0.03, 0.04]  # a whole module at one knot, by 5 cm
    off = compute_residual(setting, first.copy, LocalCopy(first.copy.box, moved))
    assert off.points == pytest.approx((0.05 / setting.intervals, 0.05))
    assert off.axes == pytest.approx((0.0, 0.0), abs=1e-9)
    assert off.box == (0.0, 0.0)


def test_blocks_agree_and_integers_can_be_cut_off(
    setting: ConsensusProblem, block: MixedIntegerBlock, first: BlockSolution
) -> None:
    agreement = run_admm(
        block,
        NonlinearBlock(setting),
        first,
        AdmmParameters(15, 1.3, 1.0, 0),
        time.monotonic() + 60,
    )
    assert agreement is not None
    assert agreement.best.residual.has_converged
    assert len(agreement.steps) <= 15
    means = [step.residual.points[0] for step in agreement.steps]
    assert means[-1] < 0.2 * means[0]
    assert first.x is not None
    assert first.modes is not None
    block.add_no_good_cut(first.x)
    again = block.find_feasible(600)
    assert again.modes is None or build_action(again.modes) != build_action(first.modes)


def test_plan_is_verified_and_keeps_its_record(thrown: LimmsPlan, tmp_path: Path) -> None:
    assert verify_plan(thrown).passed
    assert thrown.method == "admm"
    assert thrown.sequence.startswith("throw")
    record = thrown.convergence
    assert record is not None
    assert min(record.box_mean) <= 0.01
    assert min(record.points_mean) <= 0.01
    assert min(record.axes_mean) <= 0.1
    for name in RESIDUALS:
        assert (vars(record)[f"{name}_mean"] <= vars(record)[f"{name}_max"]).all()
    assert thrown.sizes["mip_binaries"] < thrown.sizes["mip_variables"]
    path = tmp_path / "plan.h5"
    write_limms_plan(thrown, path)
    again = read_limms_plan(path).convergence
    assert again is not None
    for key, values in vars(record).items():
        assert np.array_equal(vars(again)[key], values)
    figure = plot_convergence(thrown)
    left, right = figure.axes
    lines = [*left.lines, *right.lines]
    drawn = {tuple(np.asarray(line.get_ydata()).tolist()) for line in lines}
    assert tuple(record.box_mean.tolist()) in drawn
    assert tuple(record.axes_max.tolist()) in drawn


def test_plans_of_the_other_method_have_no_record(throw: LimmsPlan, throw_file: Path) -> None:
    assert throw.convergence is None
    assert read_limms_plan(throw_file).convergence is None


def test_what_conflicts_is_named() -> None:
    # Six intervals are too few for a module that crawls
    spec = loaded("limms_throw", "solver.method=admm", "solver.admm.intervals=6")
    slow = replace(spec, module=spec.module.model_copy(update={"ground_speed": 0.05}))
    with pytest.raises(Unresolved) as refused:
        plan_limms(slow)
    said = str(refused.value)
    assert "speed on the ground" in said
    assert "force" not in said
    (conflict,) = refused.value.conflicts
    assert conflict.names[:2] == ("goal.position", "ground.speed")
    assert said.splitlines()[1].endswith(f"[{', '.join(conflict.names)}]")
    # It comes far nearer than it begins, 1.35 m off
    off = re.search(r"goal, (\S+) m off in the best plan seen", said)
    assert off is not None
    assert float(off.group(1)) < 0.5


def test_a_limit_is_overall() -> None:
    began = time.perf_counter()
    with pytest.raises(LimitReached):
        plan_limms(loaded("limms_throw", "solver.method=admm", "solver.time_limit=0.05"))
    assert time.perf_counter() - began < 20  # nowhere near the limits of single programs
