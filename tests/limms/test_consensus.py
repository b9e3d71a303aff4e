"""Method `admm`: both blocks, their agreement, and the plan that is made of it."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from limms_scenes import loaded, scene

from climbplan.errors import LimitReached, NotProved
from climbplan.limms.check.verification import verification_of
from climbplan.limms.consensus.copies import Copy, Found
from climbplan.limms.consensus.iteration import Parameters, agree, residual_of
from climbplan.limms.consensus.mixed_integer import MixedInteger
from climbplan.limms.consensus.nonlinear import Nonlinear
from climbplan.limms.consensus.refinement import action_of
from climbplan.limms.consensus.setting import (
    FREE,
    HELD,
    SECONDS,
    STABLE,
    Setting,
    setting_of,
    start_points,
)
from climbplan.limms.convergence import RESIDUALS
from climbplan.limms.plan import LimmsPlan
from climbplan.limms.plan_file import read_limms_plan, write_limms_plan
from climbplan.limms.planner import plan_limms
from climbplan.limms.scene import GRAVITY
from climbplan.reports.limms.figure_convergence import convergence


@pytest.fixture(scope="module")
def setting() -> Setting:
    return setting_of(scene("limms_throw"), 8)


@pytest.fixture(scope="module")
def block(setting: Setting) -> MixedInteger:
    return MixedInteger(setting)


@pytest.fixture(scope="module")
def first(block: MixedInteger) -> Found:
    block.choose("arms")
    return block.first(600)


@pytest.fixture(scope="module")
def thrown() -> LimmsPlan:
    return plan_limms(loaded("limms_throw", "solver.method=admm"))


def test_first_block_throws_and_obeys_its_dynamics(setting: Setting, first: Found) -> None:
    assert first.modes is not None
    assert first.copy is not None
    assert first.velocity is not None
    box, held = first.modes.box, first.modes.box == HELD
    assert box[0] == STABLE
    assert box[-1] == FREE
    assert action_of(first.modes).kind == "throw"
    assert first.missed < 1e-3
    # Held from the wall wherever it is held, and nothing else ever
    assert ((first.modes.hold[0] >= 0) == held).all()
    assert (first.modes.wall[0, held] == 0).all()
    at, v = first.copy.box, first.velocity
    for k in range(setting.intervals):
        h = SECONDS[box[k]]
        assert np.allclose(at[k + 1] - at[k], h * (v[k] + v[k + 1]) / 2, atol=1e-6)
        if box[k] == FREE:
            assert np.allclose(v[k + 1] - v[k], [0, 0, -GRAVITY * h], atol=1e-6)
        if box[k] == STABLE:
            assert np.allclose(at[k + 1], at[0], atol=1e-6)


def test_second_block_has_exact_links_and_latches(setting: Setting, first: Found) -> None:
    assert first.modes is not None
    assert first.copy is not None
    bent = Nonlinear(setting).solve(first.copy, first.modes, time.monotonic() + 60)
    assert bent.violation < 1e-4
    assert bent.penetration < 1e-3
    links = np.linalg.norm(np.diff(bent.copy.points, axis=2), axis=-1)
    assert np.allclose(links, setting.links, atol=1e-9)
    assert np.array_equal(bent.copy.points[0], start_points(setting))
    k = int(np.flatnonzero(first.modes.box == HELD)[0])
    side = int(first.modes.hold[0, k])
    hand = bent.copy.box[k] + setting.scene.side_offset(0, side)
    assert np.abs(bent.copy.points[k, 0, 0] - hand).max() < 1e-4
    assert np.abs(bent.copy.points[k, 0, 4] - setting.scene.wall_position[0]).max() < 1e-4


def test_residuals_are_those_of_the_definition(setting: Setting, first: Found) -> None:
    assert first.copy is not None
    same = residual_of(setting, first.copy, first.copy)
    assert same.box == same.points == same.axes == (0.0, 0.0)
    moved = first.copy.points.copy()
    moved[3, 0] += [0.0, 0.03, 0.04]  # a whole module at one knot, by 5 cm
    off = residual_of(setting, first.copy, Copy(first.copy.box, moved))
    assert off.points == pytest.approx((0.05 / setting.intervals, 0.05))
    assert off.axes == pytest.approx((0.0, 0.0), abs=1e-9)
    assert off.box == (0.0, 0.0)


def test_blocks_agree_and_integers_can_be_cut_off(
    setting: Setting, block: MixedInteger, first: Found
) -> None:
    agreement = agree(
        block, Nonlinear(setting), first, Parameters(15, 1.3, 1.0, 0), time.monotonic() + 60
    )
    assert agreement is not None
    assert agreement.best.residual.good
    assert len(agreement.steps) <= 15
    means = [step.residual.points[0] for step in agreement.steps]
    assert means[-1] < 0.2 * means[0]
    assert first.x is not None
    assert first.modes is not None
    block.forbid(first.x)
    again = block.first(600)
    assert again.modes is None or action_of(again.modes) != action_of(first.modes)


def test_plan_is_verified_and_keeps_its_record(thrown: LimmsPlan, tmp_path: Path) -> None:
    assert verification_of(thrown).passed
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
    figure = convergence(thrown)
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
    with pytest.raises(NotProved) as refused:
        plan_limms(slow)
    said = str(refused.value)
    assert "speed on the ground" in said
    assert "force" not in said
    (conflict,) = refused.value.conflicts
    assert conflict.names[:2] == ("goal.reached", "ground.speed")
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
