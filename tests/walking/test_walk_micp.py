"""The mixed-integer relaxation contains the motions that it is to bound."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import highspy
import numpy as np
import pytest
from walk_tasks import shorter, stairs_task, walk_task

from climbplan.robots.rotations import rotation_world_body, skew
from climbplan.solvers.highs.model import highs, rows_model
from climbplan.walking.answer import WalkAnswer
from climbplan.walking.check.checker import LIMITS, check_trajectory, failures
from climbplan.walking.check.truth import euler_rates
from climbplan.walking.cost import objective
from climbplan.walking.draws import StartRanges, drawn_start
from climbplan.walking.micp.covering import covering, halves
from climbplan.walking.micp.frame import Frame
from climbplan.walking.micp.given_gait import bound_of_gait
from climbplan.walking.micp.heads import (
    Drawn,
    Stated,
    bound_drawn,
    drawn_by_heads,
    first_intervals,
)
from climbplan.walking.micp.kept import Decision, Kept
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.method import solve_micp
from climbplan.walking.micp.mirror import left_first, own_image, with_images
from climbplan.walking.micp.model import Lin, LinearModel
from climbplan.walking.micp.ranges import Box, ranges_below
from climbplan.walking.micp.relaxed import infeasible, linear, relaxed
from climbplan.walking.micp.shrinking import shrunk
from climbplan.walking.micp.smooth import Function, sine, straight
from climbplan.walking.micp.spinning import Spinning
from climbplan.walking.micp.statement import Relaxation, relaxation
from climbplan.walking.micp.tree import Search
from climbplan.walking.micp.tube import Tube, tube_about, turning
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.task import Array, Flags, Gait, WalkTask, WalkTrajectory

ANGLES, SPIN = np.array([0.1, 0.2, 0.1]), np.array([1.5, 3.0, 1.5])


def known(task: WalkTask, qps: int = 60) -> WalkAnswer:
    answer = search(task, SearchLimits(60.0, qps=qps))
    assert answer.trajectory is not None
    return answer


def lifted_cost(task: WalkTask, answer: WalkAnswer, spoil: float = 0.0) -> float:
    """Cost of the relaxed program with states, forces and binaries held to a motion's."""
    found = answer.trajectory
    assert found is not None
    tube = tube_about(task, found.state, ANGLES, SPIN)
    assert tube.holds(found.state)
    program = relaxation(task, tube, answer.objective * 1.01, 2, 2, 1.5)
    return program_cost(program, found, spoil)


def program_cost(program: Relaxation, found: WalkTrajectory, spoil: float = 0.0) -> float:
    """As of `lifted_cost`."""
    model = rows_model(program.model, relaxed=True)
    low, high = np.array(model.col_lower_), np.array(model.col_upper_)
    for column, value in program.point(found).items():
        low[column], high[column] = value - 1e-6, value + 1e-6
    if spoil:
        column = program.states[2][3].column  # a velocity that no force brings about
        low[column], high[column] = low[column] + spoil, high[column] + spoil
    model.col_lower_, model.col_upper_ = low, high
    solver = highs(30.0)
    solver.setOptionValue("primal_feasibility_tolerance", 1e-7)
    solver.passModel(model)
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        return np.inf
    return float(solver.getInfo().objective_function_value)


@pytest.mark.parametrize("seed", range(4))
def test_true_motions_are_in_the_relaxation(seed: int) -> None:
    ranges = StartRanges(1.0, 5.0, 0.3, 0.1, 0.1, 0.5, 0.02)
    task = drawn_start(shorter(walk_task((1.0, 0, 0)), 5), ranges, np.random.default_rng(seed)).task
    answer = known(task)
    cost = lifted_cost(task, answer)
    assert 0.9 * answer.objective < cost <= answer.objective * (1 + 1e-6)
    assert lifted_cost(task, answer, spoil=0.3) == np.inf


def test_a_motion_on_steps_is_in_the_relaxation() -> None:
    task = shorter(stairs_task(), 6)
    answer = known(task, 150)
    assert lifted_cost(task, answer) <= answer.objective * (1 + 1e-6)


def test_ways_of_cheaper_motions_are_shorter_than_their_fastest() -> None:
    task = shorter(stairs_task(), 6)
    answer = known(task, 150)
    found = answer.trajectory
    assert found is not None
    tube = tube_about(task, found.state, ANGLES, SPIN)
    frame = Frame(task, tube, answer.objective * 1.01, 1, 1, 1.5, None)
    spared = []
    for n in range(6):
        for last in range(n + 1, 6):
            way = found.state[last, :2] - found.state[n, :2]
            least, most = frame.ways(n, last)
            assert (way >= least - 1e-9).all()
            assert (way <= most + 1e-9).all()
            fastest = task.step * frame.v_high[n:last, 0].sum()
            spared.append(most[0] < fastest - 0.02)
    assert sum(spared) >= 3
    cost = answer.objective * 1.01
    off = np.array([1e-4, 1e-4])  # next to nothing is left for other velocities
    box = replace(Box.open(task, cost, frame.most), off=off)
    narrow = Frame(task, tube, cost, 1, 1, 1.5, box)
    least, most = narrow.ways(1, 5)
    assert most[0] - least[0] < 0.002
    assert 0.5 * (most + least)[0] == pytest.approx(4 * 0.08 * 0.8, rel=1e-3)


@pytest.mark.slow
def test_shrinking_keeps_cheaper_motions() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    answer = known(task)
    found = answer.trajectory
    assert found is not None
    tube = tube_about(task, found.state, ANGLES, SPIN)
    program = relaxation(task, tube, answer.objective * 1.02, 1, 1, 1.5)
    box = shrunk(program, 240.0)
    assert box is not None
    assert (found.state >= box.low - 1e-6).all()
    assert (found.state <= box.high + 1e-6).all()
    weights = task.weights.velocity[:2] + task.weights.motion * task.step**2
    cheapest = task.weights.velocity[:2] / weights * task.reference.velocity[:-1, :2]
    paid = (weights * (found.state[1:-1, 3:5] - cheapest) ** 2).sum(axis=0)
    assert (paid <= box.off).all()
    assert (box.off < answer.objective).all()
    force, contact = found.force[:-1] / (task.weight / 4), found.gait.contact[:-1]
    assert (force.sum(axis=1) >= box.push_low - 1e-6).all()
    assert (force.sum(axis=1) <= box.push_high + 1e-6).all()
    assert (contact >= box.stands_low).all()
    assert (contact <= box.stands_high).all()
    arms = (found.toes - found.state[:, None, :3])[:-1, :, :2]
    assert (arms >= box.arm_low - 1e-6)[contact].all()
    assert (arms <= box.arm_high + 1e-6)[contact].all()
    assert (force >= box.force_low - 1e-6)[contact].all()
    assert (force <= box.force_high + 1e-6)[contact].all()
    assert np.ptp([box.push_low[1:], box.push_high[1:]], axis=0).max() < 0.9 * 2 * 4 * 40 / 15.45
    again = relaxation(task, tube, answer.objective * 1.02, 1, 1, 1.5, box)
    assert program_cost(again, found) <= answer.objective * (1 + 1e-6)
    closer = box.tube(tube)
    assert closer.holds(found.state)
    before = ranges_below(task, answer.objective * 1.02).velocity
    assert (box.high - box.low)[2:, 3].sum() < 0.9 * (before[1] - before[0])[2:, 0].sum()
    assert shrunk(relaxation(task, tube, 0.2 * answer.objective, 1, 1, 1.5), 20.0) is None


def test_bound_and_incumbent_enclose_what_is_best() -> None:
    task = shorter(walk_task((0.5, 0, 0), least_contacts=2), 3)
    first, best = known(task, 10), known(task, 400)
    limits = MicpLimits(4.0, 0.01, angles=(0.05, 0.1, 0.05), spin=(0.5, 1.0, 0.5))
    found = solve_micp(task, limits, first)
    assert found.trajectory is not None
    assert found.bound is not None
    assert found.objective <= first.objective + 1e-9
    assert 0 < found.bound <= best.objective + 1e-6
    assert not failures(check_trajectory(task, found.trajectory))
    bounds = [step.bound for step in found.history]
    assert bounds == sorted(bounds)
    assert "within" in found.word


def test_the_contacts_of_a_motion_are_bounded_beside_all_others() -> None:
    task = shorter(walk_task((0.5, 0, 0), least_contacts=2), 3)
    best = known(task, 200)
    found = best.trajectory
    assert found is not None
    cost, contact = best.objective * 1.001, found.gait.contact[:-1]
    tube, open_box = tube_about(task, found.state, ANGLES, SPIN), Box.open(task, cost, 4.0)
    held = relaxation(task, tube, cost, 1, 1, 1.5, open_box.standing(contact))
    assert program_cost(held, found) <= best.objective * (1 + 1e-6)
    if not contact.all():  # all legs down is none of them
        other = open_box.standing(np.ones_like(contact))
        assert program_cost(relaxation(task, tube, cost, 1, 1, 1.5, other), found) == np.inf
    limits = MicpLimits(1.0, 0.02, angles=(0.05, 0.1, 0.05), spin=(0.5, 1.0, 0.5))
    bound = bound_of_gait(task, limits, [best])
    assert 0.8 * best.objective < bound <= 0.98 * best.objective * (1 + 1e-9)
    assert bound_of_gait(task, limits, [WalkAnswer(None, np.inf, 0.0, "none")]) == 0.0


def swaying(task: WalkTask, *rolls: float) -> Array:
    """Motions that differ in their roll from knot 2 on (M, N + 1, 12)."""
    state = np.tile(task.start.state, (len(rolls), task.knots + 1, 1))
    state[:, 2:, 6] = np.array(rolls)[:, None]
    return state


def test_tubes_of_several_motions_hold_all_of_them() -> None:
    task = shorter(walk_task((0.5, 0, 0)), 4)
    motions, width = swaying(task, -0.2, 0.0, 0.3), (np.full(3, 0.01), np.full(3, 0.1))
    tube = tube_about(task, motions, *width)
    assert all(tube.holds(state) for state in motions)
    assert tube.angles_half[2:, 0] == pytest.approx(0.26)
    assert not tube_about(task, motions[0], *width).holds(motions[2])
    parts = halves(motions, *width)
    assert parts is not None
    assert sorted(len(part) for part in parts) == [1, 2]
    assert halves(swaying(task, 0.0, 0.005), *width) is None


@pytest.mark.parametrize(("worth", "count"), [(1.0, 2), (0.0, 1)])
def test_a_tube_is_parted_where_that_raises_the_bound(worth: float, count: int) -> None:
    task = shorter(walk_task((0.5, 0, 0)), 4)
    motions = swaying(task, -0.3, -0.1, 0.1, 0.3)
    width = np.full(3, 0.01), np.full(3, 0.1)

    def bound(tube: Tube) -> float:
        return 1.0 - worth * float(tube.angles_half.max())

    leaves = covering(task, motions, width, 2.0, bound, lambda: True)
    assert len(leaves) == count  # each as far as the reference, so that more gain nothing
    assert sum(len(leaf.motions) for leaf in leaves) == 4
    assert all(leaf.tube.holds(state) for leaf in leaves for state in leaf.motions)
    assert all(any(leaf.tube.holds(state) for leaf in leaves) for state in motions)
    assert len(covering(task, motions, width, 0.5, bound, lambda: True)) == 1  # enough at once
    assert len(covering(task, motions, width, 2.0, bound, lambda: False)) == 1  # out of time


def test_bounds_about_several_searches_say_so() -> None:
    task = shorter(walk_task((0.5, 0, 0), least_contacts=2), 3)
    first, second = known(task, 10), known(task, 60)
    found = solve_micp(task, MicpLimits(2.0, 0.3), first, [second])
    assert found.bound is not None
    assert 0 < found.bound <= second.objective + 1e-6
    assert found.tubes >= 1
    assert "what 2 searches found" in found.word


def test_shares_of_a_square_are_its_perspective() -> None:
    model = LinearModel()
    x, share = model.variable(-2.0, 2.0), model.variable(0.0, 1.0)
    epigraph = model.square("cost", 3.0, x, (-2.0, 2.0), 1.2, share)
    rows, low = model.matrix().toarray(), model.row_lower
    for value, part in ((1.0, 1.0), (0.5, 0.5), (-0.3, 0.25), (0.0, 0.0)):
        at = np.zeros(len(model.lower))
        at[[x.column, share.column]] = value, part
        lowest = float((low - rows @ at).max())
        true = 3.0 * value**2 / part if part else 0.0
        assert 0.95 * true <= lowest + 1e-12
        assert lowest <= true + 1e-12
        assert (rows[:, epigraph.column] == 1.0).all()


def test_mixtures_of_contacts_cost_what_they_do() -> None:
    # Half of each leg on the ground all the time is no gait: it would cost next to nothing.
    task = shorter(stairs_task(), 6)
    answer = known(task, 150)
    assert answer.trajectory is not None
    tube = tube_about(task, answer.trajectory.state, 0.3 * ANGLES, 0.3 * SPIN)
    program = relaxation(task, tube, answer.objective, 1, 1, 1.5)
    solver = highs(30.0)
    solver.passModel(rows_model(program.model, relaxed=True))
    solver.run()
    assert solver.getModelStatus() == highspy.HighsModelStatus.kOptimal
    assert solver.getInfo().objective_function_value > 0.15 * answer.objective


def test_nothing_to_start_from() -> None:
    task = shorter(walk_task((0.5, 0, 0)), 3)
    found = solve_micp(task, MicpLimits(1.0), WalkAnswer(None, np.inf, 0.0, "no gait"))
    assert found.trajectory is None
    assert "no gait" in found.word


def test_what_turns_stays_within_its_bounds() -> None:
    task = shorter(walk_task((0.5, 0, 0)), 3)
    middle, half = np.array([0.1, -0.2, 0.7]), np.array([0.1, 0.25, 0.2])
    spin, spin_half = np.array([1.0, -2.0, 5.0]), np.array([1.0, 2.0, 1.0])
    tube = Tube(*(np.tile(row, (4, 1)) for row in (middle, half, spin, spin_half)))
    t = turning(task, tube, 2)
    rng = np.random.default_rng(0)
    inertia = task.body.inertia
    for _ in range(300):
        angles = middle + half * rng.uniform(-1, 1, 3)
        omega = spin + spin_half * rng.uniform(-1, 1, 3)
        R = rotation_world_body(angles)
        assert (np.abs(R - t.R) <= t.R_off + 1e-12).all()
        turn = t.axes @ (angles - middle)
        assert (np.abs(turn) <= t.turn_half + 1e-12).all()
        beyond = R.T @ t.R - (np.eye(3) - skew(turn))
        assert (beyond >= t.seen_low - 1e-12).all()
        assert (beyond <= t.seen_high + 1e-12).all()
        assert (np.abs(t.R.T @ R - np.eye(3)) <= t.off + 1e-12).all()
        inverse = R @ np.linalg.inv(inertia) @ R.T
        assert (np.abs(inverse - t.inverse) <= t.inverse_off + 1e-9).all()
        world = R @ inertia @ R.T
        assert (np.abs(world - t.inertia) <= t.inertia_off + 1e-9).all()
        about = t.principal.T @ R.T @ omega
        assert (about >= t.about_low).all()
        assert (about <= t.about_high).all()
    axes = t.principal
    assert np.allclose(axes @ np.diag(t.moments) @ axes.T, inertia, atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)


@pytest.mark.parametrize("middle", [-0.4, 0.0, 0.7])
@pytest.mark.parametrize("half", [0.0, 0.05, 0.45])
def test_straight_lines_are_off_by_no_more_than_they_say(middle: float, half: float) -> None:
    x = np.linspace(-half, half, 3001)
    slope, off = sine(half)
    assert (np.abs(np.sin(x) - slope * x) <= off).all()
    assert off <= half**3 / 20.0 + 2e-9
    shapes: dict[Function, Array] = {
        "secant": 1 / np.cos(middle + x),
        "tangent": np.tan(middle + x),
    }
    for name, values in shapes.items():
        line = straight(name, middle, half)
        beyond = np.abs(values - line.middle - line.slope * x)
        assert (beyond <= line.off).all()
        assert beyond.max() >= 0.9 * line.off - 1e-9


def test_spins_and_rates_of_a_tube_are_in_its_rows() -> None:
    # Envelopes of rates and of gyroscopic moments hold every attitude and turning of a wide tube.
    task = shorter(walk_task((0.5, 0, 0)), 3)
    rng = np.random.default_rng(1)
    middle, half = np.array([0.1, -0.2, 0.7]), np.array([0.2, 0.25, 0.4])
    spin, spin_half = np.array([1.0, -2.0, 4.0]), np.array([2.0, 2.0, 2.0])
    tube = Tube(*(np.tile(row, (4, 1)) for row in (middle, half, spin, spin_half)))
    t = turning(task, tube, 1)
    frame = Spinning(task, tube, 3000.0, 1, 1, 3.0, None)
    frame.attitude(1)
    moments, largest = frame.gyroscopic(1)
    for _ in range(20):
        angles = middle + half * rng.uniform(-1, 1, 3)
        omega = spin + spin_half * rng.uniform(-1, 1, 3)
        about = t.principal.T @ rotation_world_body(angles).T @ omega
        true = -np.cross(about, t.moments * about)
        assert (np.abs(true) <= largest + 1e-9).all()
        model = frame.model
        after = angles + task.step * euler_rates(angles, omega)
        given = {frame.angles[1][k].column: angles[k] for k in range(3)}
        given |= {frame.spin[1][k].column: omega[k] for k in range(3)}
        solver = linear()
        solver.passModel(rows_model(model, relaxed=True))
        for column, value in given.items():
            solver.changeColBounds(column, value, value)
        for k in range(3):
            solver.changeColBounds(frame.angles[2][k].column, after[k], after[k])
            ((column, factor),) = moments[k].terms.items()
            solver.changeColBounds(column, true[k] / factor, true[k] / factor)
        solver.run()
        assert solver.getModelStatus() == highspy.HighsModelStatus.kOptimal


def test_tangents_are_below_their_square() -> None:
    model = LinearModel()
    x = model.variable(-2.0, 2.0)
    model.square("cost", 3.0, x - 0.5, (-2.5, 1.5), 1.4)
    rows = model.matrix().toarray()
    for value in np.linspace(-2, 2, 41):
        lowest = float(((model.row_lower - rows[:, x.column] * value) / rows[:, 1]).max())
        true = 3.0 * (value - 0.5) ** 2
        assert lowest <= true + 1e-9
        if abs(value - 0.5) > 0.1:
            assert lowest > 0.9 * true
    assert Lin({0: 2.0}, 1.0).at(np.array([3.0])) == 7.0


OWN = {"cost.tracking", "cost.force_difference", "cost.known", "contact.endurance"}


@pytest.mark.parametrize("on_steps", [False, True])
def test_rows_have_the_names_of_the_checks(on_steps: bool) -> None:
    task = shorter(stairs_task() if on_steps else walk_task((1.0, 0, 0)), 5)
    state = np.tile(task.start.state, (6, 1))
    program = relaxation(task, tube_about(task, state, ANGLES, SPIN), 3000.0, 2, 2, 1.5)
    names = set(program.model.names.names)
    assert names - OWN <= set(LIMITS)
    assert {"dynamics.spin", "force.friction", "workspace.toe", "contact.no_slip"} <= names


def test_an_answer_that_is_off_is_named() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    state = np.tile(task.start.state, (5, 1))
    program = relaxation(task, tube_about(task, state, ANGLES, SPIN), 3000.0, 1, 1, 1.5)
    solver = highs(30.0)
    solver.passModel(rows_model(program.model, relaxed=True))
    solver.run()
    x = np.array(solver.getSolution().col_value)
    worst = {block.name: block.residual for block in program.model.residuals(x)}
    assert max(value for name, value in worst.items() if name != "integrality") < 1e-6
    x[program.states[2][0].column] += 20.0  # no velocity leads there
    assert program.model.worst(x).name == "dynamics.position"


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_only_euler_steps_are_bounded(integrator: str) -> None:
    task = shorter(walk_task((1.0, 0, 0), integrator=integrator, whole_stance=True), 4)
    first = known(task, 20)
    answer = solve_micp(task, MicpLimits(seconds=2.5), first)
    assert answer.trajectory is not None
    assert answer.objective <= first.objective * (1 + 1e-9)
    assert not failures(check_trajectory(task, answer.trajectory))
    proved = [step.bound for step in answer.history if np.isfinite(step.bound)]
    if integrator == "euler":
        assert answer.bound is not None
        assert "bound of motions within" in answer.word
    else:
        assert answer.bound is None
        assert not proved
        assert "no bound" in answer.word


@dataclass(frozen=True)
class Cheap:
    """All motions of a short task that cost no more than a known one, and what heads tell."""

    stated: Stated
    found: WalkTrajectory
    cost: float
    drawn: Drawn


@pytest.fixture(scope="module")
def cheap() -> Cheap:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    answer = known(task)
    assert answer.trajectory is not None
    tube = tube_about(task, answer.trajectory.state, 0.3 * ANGLES, 0.3 * SPIN)
    stated = Stated(task, tube, answer.objective * 1.005, 1, 1, 3.0)
    drawn = drawn_by_heads(stated, stated.program(None), 3.0, time.process_time)
    assert drawn is not None
    return Cheap(stated, answer.trajectory, answer.objective, drawn)


def lowest(stated: Stated, program: Relaxation) -> float:
    """What the relaxed program costs at least."""
    return max(bound for bound, _ in relaxed(program.model, 1e-4 * stated.most, linear()))


def test_heads_keep_cheaper_motions_and_draw_ranges_closer(cheap: Cheap) -> None:
    stated, found, box = cheap.stated, cheap.found, cheap.drawn.box
    assert (found.state >= box.low - 1e-6).all()
    assert (found.state <= box.high + 1e-6).all()
    program, held = stated.program(None), stated.program(box)
    before = np.array(program.model.upper) - np.array(program.model.lower)
    asked = np.array([[c.column for c in row] for row in program.states])[2, 2:6]
    assert (box.high - box.low)[2, 2:6].sum() < 0.8 * before[asked].sum()
    assert (found.gait.contact[:-1] >= box.stands_low).all()
    assert (found.gait.contact[:-1] <= box.stands_high).all()
    for n in range(1, 4):
        begun = found.state[: n + 1], found.force[: n + 1]
        paid = cheap.cost - objective(first_intervals(stated.task, n), *begun)
        assert cheap.drawn.later[n] <= paid + 1e-9
    assert program_cost(held, found) <= cheap.cost * (1 + 1e-6)
    assert lowest(stated, program) + 0.005 * cheap.cost < lowest(stated, held) <= cheap.cost
    none = replace(stated, most=0.3 * cheap.cost)
    assert drawn_by_heads(none, none.program(None), 1.0, time.process_time) is None


def all_decided(kept: Kept, contact: Flags) -> tuple[Decision, ...]:
    rows = np.ndenumerate(kept.program.rows)
    return tuple(Decision(True, int(row), float(contact[at])) for at, row in rows)


def contacts_searched(kept: Kept) -> Search:
    return Search(kept, lambda bound: True, lambda: np.inf, lambda contacts: 0.0, lambda x: None)


def test_a_search_over_contacts_never_loses_a_motion(cheap: Cheap) -> None:
    stated, contact = cheap.stated, cheap.found.gait.contact[:-1]
    kept = Kept(stated.program(cheap.drawn.box), 1e-4 * stated.most)
    kept.begin()
    root = kept.solve(np.inf)
    assert root is not None
    assert root.x is not None
    ways = kept.next(root.x)
    assert ways is not None
    assert {way.value for way in ways} == {0.0, 1.0}
    kept.decide(all_decided(kept, contact))
    gait = kept.solve(np.inf)  # the motion is in it
    assert gait is not None
    assert root.bound <= gait.bound <= cheap.cost
    assert kept.contacts is not None
    assert np.array_equal(kept.contacts, contact)
    bounds = list[float]()

    def goes_on(bound: float) -> bool:
        bounds.append(bound)
        return len(bounds) < 12

    cut = replace(contacts_searched(kept), goes_on=goes_on).run()
    assert bounds == sorted(bounds)
    assert 0 <= cut <= gait.bound + 1e-9
    none = replace(stated, most=root.bound * 0.99)  # what is cheaper than all of its motions
    assert contacts_searched(Kept(none.program(None), 1e-4 * none.most)).run() == none.most


@pytest.mark.slow
def test_a_search_over_contacts_ends_where_highs_ends() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 3)
    answer = known(task, 20)
    assert answer.trajectory is not None
    tube = tube_about(task, answer.trajectory.state, 0.3 * ANGLES, 0.3 * SPIN)
    both = with_images(tube, 20 * ANGLES, 20 * SPIN)
    assert both is not None
    stated = Stated(task, both, answer.objective * 1.02, 1, 1, 1.5)
    program, sag = stated.program(None), 1e-4 * stated.most
    search = contacts_searched(Kept(program, sag))
    bound = search.run()
    first = search.nodes
    assert search.run() == bound  # whatever was asked before
    assert search.nodes == 2 * first
    halved = contacts_searched(Kept(stated.program(None), sag, images=True))
    assert halved.run() == pytest.approx(bound, rel=1e-3)
    assert halved.nodes < first
    solver = highs(60.0)
    solver.passModel(rows_model(program.model))
    solver.run()
    assert solver.getModelStatus() == highspy.HighsModelStatus.kOptimal
    found = solver.getInfo().objective_function_value
    assert bound <= answer.objective
    assert found == pytest.approx(bound, rel=0.01)  # tangents are others


def image(found: WalkTrajectory) -> WalkTrajectory:
    """The same motion with left and right exchanged."""
    across, legs = np.array([1.0, -1.0, 1.0]), np.array([1, 0, 3, 2])
    state = found.state * np.concatenate([across, across, -across, -across])
    gait = Gait(found.gait.contact[:, legs], found.gait.region[:, legs])
    return WalkTrajectory(state, found.toes[:, legs] * across, found.force[:, legs] * across, gait)


def test_of_two_motions_that_mirror_one_is_enough() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    assert own_image(task)
    assert own_image(shorter(stairs_task(), 4))
    turned = replace(task.reference, euler=task.reference.euler + 0.1 * np.eye(3)[2])
    aside = replace(task.start, state=task.start.state + 0.1 * np.eye(12)[4])
    assert not own_image(replace(task, reference=turned))
    assert not own_image(replace(task, start=aside))
    answer = known(task)
    found = answer.trajectory
    assert found is not None
    other = image(found)
    assert objective(task, other.state, other.force) == pytest.approx(answer.objective)
    checked = check_trajectory(task, other)
    assert not failures(checked)
    width = np.array([0.01, 0.02, 0.01]), np.array([0.2, 0.4, 0.2])
    about = tube_about(task, np.stack([found.state, other.state]), *width)
    tube = with_images(about, *width)
    assert tube is not None
    assert with_images(replace(about, angles=about.angles + 0.5), *width) is None
    stated = Stated(task, tube, 1.01 * answer.objective, 1, 1, 3.0)
    program = stated.program(None)
    first = []
    for motion in (found, other):
        assert tube.holds(motion.state)
        x = np.zeros(len(program.model.lower))
        for column, value in program.integers(motion).items():
            x[column] = value
        first.append(left_first(program).at(x))
    assert first[0] == pytest.approx(-first[1])


@pytest.mark.slow
def test_a_search_over_contacts_keeps_what_other_seeds_find() -> None:
    task = shorter(stairs_task(), 7)
    answers = [search(task, SearchLimits(60.0, seed=k, qps=200)) for k in range(4)]
    motions = np.stack([a.trajectory.state for a in answers if a.trajectory is not None])
    tube = tube_about(task, motions, np.deg2rad([1.0, 2.0, 1.0]), np.array([0.25, 0.5, 0.25]))
    least = min(answer.objective for answer in answers)
    stated = Stated(task, tube, 1.001 * least, 1, 1, 3.0)
    kept = Kept(stated.program(None), 5e-4 * least)
    drawn = list[float]()

    def settled(contacts: Flags) -> float:
        held = kept.program.box.standing(contacts)
        drawn.append(bound_drawn(stated, held, 1, lambda: 30.0, time.process_time))
        for answer in answers:
            assert answer.trajectory is not None
            if np.array_equal(answer.trajectory.gait.contact[:-1], contacts):
                assert drawn[-1] <= answer.objective
        return drawn[-1]

    end = time.process_time() + 60.0
    found = replace(
        contacts_searched(kept), settled=settled, goes_on=lambda bound: time.process_time() < end
    )
    assert 0.6 * least < found.run() <= least


def test_what_has_no_point_is_asked_again_from_scratch() -> None:
    solver = linear()
    solver.addVar(0.0, 1.0)
    solver.addRow(2.0, 3.0, 1, np.array([0], np.int32), np.array([1.0]))
    solver.run()
    assert infeasible(solver)
    solver.changeRowBounds(0, 0.5, 3.0)
    assert not infeasible(solver)


@pytest.mark.slow
@pytest.mark.parametrize("disturbed", [False, True])
def test_heads_keep_what_other_seeds_find(disturbed: bool) -> None:
    # Of the whole task, in a tube about all of them, below a cost that most of them are below.
    task = walk_task((-1.0, 0, 0) if disturbed else (0, 0, 0))
    answers = [search(task, SearchLimits(60.0, seed=k, qps=300)) for k in range(4)]
    cost = 1.02 * min(answer.objective for answer in answers)
    found = [a.trajectory for a in answers if a.trajectory is not None and a.objective <= cost]
    width = np.deg2rad([1.0, 2.0, 1.0]), np.array([0.25, 0.5, 0.25])
    tube = tube_about(task, np.stack([one.state for one in found]), *width)
    stated = Stated(task, tube, cost, 1, 1, 3.0)
    drawn = drawn_by_heads(stated, stated.program(None), 10.0, time.process_time)
    assert drawn is not None
    held = stated.program(drawn.box)
    assert lowest(stated, stated.program(None)) + 0.03 * cost < lowest(stated, held)
    kept = Kept(held, 5e-4 * cost)  # as the search over contacts has it
    for one in found:
        kept.begin()
        kept.decide(all_decided(kept, one.gait.contact[:-1]))
        point = kept.solve(np.inf)
        assert point is not None
        assert point.bound <= objective(task, one.state, one.force) * (1 + 1e-6)
        assert (one.gait.contact[:-1] >= drawn.box.stands_low).all()
        assert (one.gait.contact[:-1] <= drawn.box.stands_high).all()
        assert program_cost(held, one) <= cost * (1 + 1e-6)
