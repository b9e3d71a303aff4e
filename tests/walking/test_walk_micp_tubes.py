"""Tubes of attitudes: what turns within them, and what they are parted for."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace

import highspy
import numpy as np
import pytest
from walk_relaxations import known
from walk_tasks import shorter, walk_task

from climbplan.arrays import Array
from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.solvers.highs.model import build_rows_model
from climbplan.walking.check.reference_dynamics import euler_rates
from climbplan.walking.micp.attitude_box import AttitudeBox, bound_rotation, build_attitude_box
from climbplan.walking.micp.attitude_partition import partition_attitudes, split_motions
from climbplan.walking.micp.dynamics_rows import DynamicsRows
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.linear_model import LinearModel, LinExpr
from climbplan.walking.micp.outer_approximation import create_lp_solver
from climbplan.walking.micp.rotation_rows import TrigFunction, fit_line, fit_sine
from climbplan.walking.micp.solver import solve_micp
from climbplan.walking.task.task import WalkTask


def swaying(task: WalkTask, *rolls: float) -> Array:
    """Motions that differ in their roll from knot 2 on (M, N + 1, 12)."""
    state = np.tile(task.start.state, (len(rolls), task.knots + 1, 1))
    state[:, 2:, 6] = np.array(rolls)[:, None]
    return state


def tube_of(middle: Array, half: Array, spin: Array, spin_half: Array) -> AttitudeBox:
    """The same at four knots, with a heading that is not its middle."""
    a, b, c, d = (np.tile(row, (4, 1)) for row in (middle, half, spin, spin_half))
    return AttitudeBox(a, b, c, d, np.full(4, middle[2] + 0.05))


def test_tubes_of_several_motions_hold_all_of_them() -> None:
    task = shorter(walk_task((0.5, 0, 0)), 4)
    motions, width = swaying(task, -0.2, 0.0, 0.3), (np.full(3, 0.01), np.full(3, 0.1))
    tube = build_attitude_box(task, motions, *width)
    assert all(tube.contains(state) for state in motions)
    assert tube.angles_half[2:, 0] == pytest.approx(0.26)
    assert not build_attitude_box(task, motions[0], *width).contains(motions[2])
    parts = split_motions(motions, *width)
    assert parts is not None
    assert sorted(len(part) for part in parts) == [1, 2]
    assert split_motions(swaying(task, 0.0, 0.005), *width) is None


@pytest.mark.parametrize(("worth", "count"), [(1.0, 2), (0.0, 1)])
def test_a_tube_is_parted_where_that_raises_the_bound(worth: float, count: int) -> None:
    task = shorter(walk_task((0.5, 0, 0)), 4)
    motions = swaying(task, -0.3, -0.1, 0.1, 0.3)
    width = np.full(3, 0.01), np.full(3, 0.1)

    def bound(tube: AttitudeBox) -> float:
        return 1.0 - worth * float(tube.angles_half.max())

    cells = partition_attitudes(task, motions, width, 2.0, bound, lambda: True)
    assert len(cells) == count  # each as far as the reference, so that more gain nothing
    assert sum(len(cell.motions) for cell in cells) == 4
    assert all(cell.attitude_box.contains(state) for cell in cells for state in cell.motions)
    assert all(any(cell.attitude_box.contains(state) for cell in cells) for state in motions)
    assert (
        len(partition_attitudes(task, motions, width, 0.5, bound, lambda: True)) == 1
    )  # enough at once
    assert (
        len(partition_attitudes(task, motions, width, 2.0, bound, lambda: False)) == 1
    )  # out of time


def test_bounds_about_several_searches_say_so() -> None:
    task = shorter(walk_task((0.5, 0, 0), min_contacts=2), 3)
    first, second = known(task, 10), known(task, 60)
    found = solve_micp(task, MicpLimits(2.0, 0.3), first, [second])
    assert found.bound is not None
    assert 0 < found.bound <= second.objective + 1e-6
    assert found.tubes >= 1
    assert "what 2 searches found" in found.word


@pytest.mark.slow
def test_several_processes_prove_what_one_does() -> None:
    task = shorter(walk_task((0.5, 0.2, 0), min_contacts=2), 3)
    first, second = known(task, 10), known(task, 60)
    limits = MicpLimits(40.0, 0.3, clock=time.process_time)
    alone = solve_micp(task, limits, first, [second])
    abreast = solve_micp(task, replace(limits, processes=2), first, [second])
    assert alone.bound == pytest.approx(0.7 * second.objective)
    assert abreast.bound == pytest.approx(alone.bound)
    assert abreast.tubes == alone.tubes
    bounds = [entry.bound for entry in abreast.history]
    assert bounds == sorted(bounds)
    short = solve_micp(task, replace(limits, seconds=1e-3, processes=2), first, [second])
    assert short.bound is not None
    assert 0.0 <= short.bound <= alone.bound


def within(value: Array, low: Array, high: Array) -> bool:
    return bool((value >= low - 1e-12).all() and (value <= high + 1e-12).all())


def test_what_turns_stays_within_its_bounds() -> None:
    task = shorter(walk_task((0.5, 0, 0)), 3)
    middle, half = np.array([0.1, -0.2, 0.7]), np.array([0.1, 0.25, 0.2])
    spin, spin_half = np.array([1.0, -2.0, 5.0]), np.array([1.0, 2.0, 1.0])
    tube = tube_of(middle, half, spin, spin_half)
    t = bound_rotation(task, tube, 2)
    rng = np.random.default_rng(0)
    inertia = task.body.inertia
    for _ in range(300):
        angles = middle + half * rng.uniform(-1, 1, 3)
        omega = spin + spin_half * rng.uniform(-1, 1, 3)
        R = rotation_world_body(angles)
        assert (np.abs(R - t.R) <= t.R_error + 1e-12).all()
        turn = t.turn_jacobian @ (angles - middle)
        assert (np.abs(turn) <= t.max_turn + 1e-12).all()
        beyond = R.T @ t.R - (np.eye(3) - skew(turn))
        assert within(beyond @ t.R.T @ omega, t.omega_remainder_low, t.omega_remainder_high)
        toes = task.body.toe_center + task.body.toe_half * rng.choice((-1.0, 1.0), (4, 3))
        assert within(toes @ R.T @ t.heading_axes, t.arm_low, t.arm_high)
        assert within(toes @ R.T, t.world_arm_low, t.world_arm_high)
        assert within(toes @ R.T @ t.R, t.middle_arm_low, t.middle_arm_high)
        assert within(toes @ R.T @ t.R @ beyond.T, t.toe_remainder_low, t.toe_remainder_high)
        inverse = R @ np.linalg.inv(inertia) @ R.T
        assert (np.abs(inverse - t.inverse_inertia) <= t.inverse_inertia_error + 1e-9).all()
        Q, across = (
            t.principal_axes.T @ t.R.T @ R @ t.principal_axes,
            skew(t.principal_axes.T @ turn),
        )
        assert within(Q - np.eye(3) - across, t.rotation_remainder_low, t.rotation_remainder_high)
        world = R @ inertia @ R.T
        assert (np.abs(world - t.inertia) <= t.inertia_error + 1e-9).all()
        heavy = np.diag(t.principal_moments)
        assert within(
            Q @ heavy @ Q.T - heavy - (across @ heavy - heavy @ across),
            t.inertia_remainder_low,
            t.inertia_remainder_high,
        )
        about = t.principal_axes.T @ R.T @ omega
        assert (about >= t.principal_omega_low).all()
        assert (about <= t.principal_omega_high).all()
    axes = t.principal_axes
    assert np.allclose(axes @ np.diag(t.principal_moments) @ axes.T, inertia, atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    heading = rotation_world_body(np.array([0.0, 0.0, middle[2] + 0.05]))
    assert np.allclose(t.heading_axes, heading)


@pytest.mark.parametrize("middle", [-0.4, 0.0, 0.7])
@pytest.mark.parametrize("half", [0.0, 0.05, 0.45])
def test_straight_lines_are_off_by_no_more_than_they_say(middle: float, half: float) -> None:
    x = np.linspace(-half, half, 3001)
    slope, off = fit_sine(half)
    assert (np.abs(np.sin(x) - slope * x) <= off).all()
    assert off <= half**3 / 20.0 + 2e-9
    shapes: dict[TrigFunction, Array] = {
        "secant": 1 / np.cos(middle + x),
        "tangent": np.tan(middle + x),
    }
    for name, values in shapes.items():
        line = fit_line(name, middle, half)
        beyond = np.abs(values - line.middle - line.slope * x)
        assert (beyond <= line.max_error).all()
        assert beyond.max() >= 0.9 * line.max_error - 1e-9


def test_spins_and_rates_of_a_tube_are_in_its_rows() -> None:
    # Envelopes of rates, gyroscopic moments and inertia hold all that turns in a wide tube.
    task = shorter(walk_task((0.5, 0, 0)), 3)
    rng = np.random.default_rng(1)
    middle, half = np.array([0.1, -0.2, 0.7]), np.array([0.2, 0.25, 0.4])
    spin, spin_half = np.array([1.0, -2.0, 4.0]), np.array([2.0, 2.0, 2.0])
    tube = tube_of(middle, half, spin, spin_half)
    t = bound_rotation(task, tube, 1)
    frame = DynamicsRows(task, tube, 3000.0, 1, 1, 3.0)
    frame.add_attitude_rows(1)
    moments, largest = frame.add_gyroscopic_moment(1)
    pushed = [frame.model.add_variable(-np.inf, np.inf) for _ in range(3)]
    frame.add_rotated_inertia_rows(1, pushed, moments, largest)
    for _ in range(20):
        angles = middle + half * rng.uniform(-1, 1, 3)
        omega = spin + spin_half * rng.uniform(-1, 1, 3)
        about = t.principal_axes.T @ rotation_world_body(angles).T @ omega
        true = -np.cross(about, t.principal_moments * about)
        assert (np.abs(true) <= largest + 1e-9).all()
        model = frame.model
        after = angles + task.dt * euler_rates(angles, omega)
        given = {frame.angles[1][k].column: angles[k] for k in range(3)}
        given |= {frame.omega[1][k].column: omega[k] for k in range(3)}
        later = spin + spin_half * rng.uniform(-1, 1, 3)
        R = rotation_world_body(angles)
        moment = R @ (task.body.inertia @ R.T @ (later - omega) / task.dt - t.principal_axes @ true)
        given |= {frame.omega[2][k].column: later[k] for k in range(3)}
        given |= {pushed[k].column: moment[k] / frame.force_unit for k in range(3)}
        solver = create_lp_solver()
        solver.passModel(build_rows_model(model, relaxed=True))
        for column, value in given.items():
            solver.changeColBounds(column, value, value)
        for k in range(3):
            solver.changeColBounds(frame.angles[2][k].column, after[k], after[k])
            ((column, factor),) = moments[k].terms.items()
            solver.changeColBounds(column, true[k] / factor, true[k] / factor)
        solver.run()
        assert solver.getModelStatus() == highspy.HighsModelStatus.kOptimal
        other = moment / frame.force_unit + np.array([0.0, 1.0, 0.0])  # nothing turns that fast
        for k in range(3):
            solver.changeColBounds(pushed[k].column, other[k], other[k])
        solver.run()
        assert solver.getModelStatus() == highspy.HighsModelStatus.kInfeasible


def test_products_of_narrow_ranges_are_lines_that_hold_them() -> None:
    task = shorter(walk_task((0.5, 0, 0)), 3)
    tube = build_attitude_box(task, swaying(task, 0.0), np.full(3, 0.1), np.full(3, 0.1))
    frame = DynamicsRows(task, tube, 1000.0, 1, 1, 3.0)
    model, (low, high), (least, most) = frame.model, (0.3, 0.3 + 2e-6), (-4.0, 6.0)
    x, y, chosen = (
        model.add_variable(low, high),
        model.add_variable(least, most),
        model.add_variable(1.0, 1.0),
    )
    rows = len(model)
    lines = (
        frame.add_switched_product(x, (low, high), y, (least, most), chosen),
        frame.add_envelope("dynamics.angular_velocity", x, high, y, 1.0, 1.0 + 1e-5),
    )
    assert len(model) == rows  # no envelope
    ranges = ((least, 1.0, most), (1.0, 1.0 + 1e-5))
    for line, sizes in zip(lines, ranges, strict=True):
        off = model.upper[max(line.terms)]  # of the remainder, which is 0 at the point
        assert 0.0 < off <= 1e-5
        for one, other in itertools.product((low, high), sizes):
            at = np.zeros(len(model.lower))
            at[[x.column, y.column, chosen.column]] = one, other, 1.0
            assert abs(line.evaluate(at) - one * other) <= off + 1e-12
    wide = frame.add_switched_product(x, (0.0, 0.4), y, (least, most), chosen)
    assert len(model) == rows + 4
    assert model.upper[wide.column] > 0.4 * most  # its own bounds are never met


def test_tangents_are_below_their_square() -> None:
    model = LinearModel()
    x = model.add_variable(-2.0, 2.0)
    model.add_square("cost", 3.0, x - 0.5, (-2.5, 1.5), 1.4)
    rows = model.matrix().toarray()
    for value in np.linspace(-2, 2, 41):
        lowest = float(((model.row_lower - rows[:, x.column] * value) / rows[:, 1]).max())
        true = 3.0 * (value - 0.5) ** 2
        assert lowest <= true + 1e-9
        if abs(value - 0.5) > 0.1:
            assert lowest > 0.9 * true
    assert LinExpr({0: 2.0}, 1.0).evaluate(np.array([3.0])) == 7.0
