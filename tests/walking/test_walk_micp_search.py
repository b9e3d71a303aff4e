"""Heads and the search over contacts: what they leave out is no cheaper motion."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import highspy
import numpy as np
import pytest
from walk_relaxations import ANGLES, SPIN, known, program_cost
from walk_tasks import shorter, stairs_task, walk_task

from climbplan.arrays import BoolArray
from climbplan.solvers.highs.model import build_rows_model, create_highs, run_highs
from climbplan.walking.check.checker import check_trajectory, format_failures
from climbplan.walking.dynamics.cost import compute_objective
from climbplan.walking.micp import branching as parts_of_tubes
from climbplan.walking.micp import outer_approximation as relaxed_programs
from climbplan.walking.micp.attitude_box import build_attitude_box
from climbplan.walking.micp.branch_and_bound import BranchAndBound
from climbplan.walking.micp.branching import WalkSubproblem, bisect_node, branch_on_contacts
from climbplan.walking.micp.contact_search import ContactSearch
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.node_lp import BranchingDecision, NodeLp
from climbplan.walking.micp.node_processing import process_node
from climbplan.walking.micp.outer_approximation import (
    confirm_infeasible,
    create_lp_solver,
    refine_outer_approximation,
    solve_lp,
)
from climbplan.walking.micp.prefix_relaxation import (
    TaskRelaxation,
    TightenedBounds,
    bound_by_prefix,
    bound_by_tightening,
    bound_tail_cost,
    tighten_by_prefix,
    tighten_by_prefixes,
    truncate_task,
)
from climbplan.walking.micp.relaxation import MixedIntegerRelaxation
from climbplan.walking.micp.symmetry import (
    build_symmetry_breaker,
    include_mirror_images,
    is_mirror_symmetric,
)
from climbplan.walking.offline.search import SearchLimits, search
from climbplan.walking.task.task import Gait, WalkTrajectory


@dataclass(frozen=True)
class Cheap:
    """All motions of a short task that cost no more than a known one, and what heads tell."""

    stated: TaskRelaxation
    found: WalkTrajectory
    cost: float
    drawn: TightenedBounds


@pytest.fixture(scope="module")
def cheap() -> Cheap:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    answer = known(task)
    assert answer.trajectory is not None
    tube = build_attitude_box(task, answer.trajectory.state, 0.3 * ANGLES, 0.3 * SPIN)
    stated = TaskRelaxation(task, tube, answer.objective * 1.005, 1, 1, 3.0)
    drawn = tighten_by_prefixes(stated, stated.build(None), 20.0, time.process_time)
    assert drawn is not None
    return Cheap(stated, answer.trajectory, answer.objective, drawn)


def lowest(stated: TaskRelaxation, program: MixedIntegerRelaxation) -> float:
    """What the relaxed program costs at least."""
    return max(
        bound
        for bound, _ in refine_outer_approximation(
            program.model, 1e-4 * stated.cutoff, create_lp_solver()
        )
    )


def test_heads_keep_cheaper_motions_and_draw_ranges_closer(cheap: Cheap) -> None:
    stated, found, box = cheap.stated, cheap.found, cheap.drawn.bounds
    assert (found.state >= box.state_low - 1e-6).all()
    assert (found.state <= box.state_high + 1e-6).all()
    program, held = stated.build(None), stated.build(box)
    before = np.array(program.model.upper) - np.array(program.model.lower)
    asked = np.array([[c.column for c in row] for row in program.states])[2, 2:6]
    assert (box.state_high - box.state_low)[2, 2:6].sum() < 0.8 * before[asked].sum()
    assert (found.gait.contact[:-1] >= box.contact_low).all()
    assert (found.gait.contact[:-1] <= box.contact_high).all()
    for n in range(1, 4):
        begun = found.state[: n + 1], found.force[: n + 1]
        paid = cheap.cost - compute_objective(truncate_task(stated.task, n), *begun)
        assert cheap.drawn.tail_costs[n] <= paid + 1e-9
    assert program_cost(held, found) <= cheap.cost * (1 + 1e-6)
    assert lowest(stated, program) + 0.005 * cheap.cost < lowest(stated, held) <= cheap.cost
    none = replace(stated, cutoff=0.3 * cheap.cost)
    assert tighten_by_prefixes(none, none.build(None), 1.0, time.process_time) is None


def held_by(part: WalkSubproblem, found: WalkTrajectory) -> bool:
    """Whether a motion is in a part: its states, contacts, and arms of legs that stand."""
    box = part.bounds
    if box is None:
        return part.formulation.attitude_box.contains(found.state)
    contact, program = found.gait.contact[:-1], part.formulation.build(box)
    arms = ((found.toes - found.state[:, None, :3])[:-1] @ program.heading_axes)[:, :, :2]
    inside = (found.state >= box.state_low - 1e-6) & (found.state <= box.state_high + 1e-6)
    reached = (arms >= box.arm_low - 1e-6) & (arms <= box.arm_high + 1e-6)
    stands = (contact >= box.contact_low) & (contact <= box.contact_high)
    return bool(inside[:-1].all() and reached[contact].all() and stands.all())


def test_parts_by_contacts_and_halves_are_all_motions_together(
    cheap: Cheap, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated, found, box = cheap.stated, cheap.found, cheap.drawn.bounds
    contact = found.gait.contact[:-1]
    after = cheap.cost - compute_objective(
        truncate_task(stated.task, 3), found.state[:4], found.force[:4]
    )
    part, program = WalkSubproblem(stated, breaks_symmetry=False, bounds=box), stated.build(box)
    monkeypatch.setattr(parts_of_tubes, "_MAX_CHILDREN", 1)
    assert branch_on_contacts(part, program, 1e-4 * stated.cutoff, lambda: True) is None
    monkeypatch.setattr(parts_of_tubes, "_MAX_CHILDREN", 100)
    for decided in (2, 3):  # of four intervals the first three are early ones
        parts = branch_on_contacts(part, program, 1e-4 * stated.cutoff, lambda: True)
        assert parts is not None
        assert {one.num_decided for one in parts} == {decided}
        begun = [one.bounds.contact_low[:decided] for one in parts if one.bounds is not None]
        assert len({one.tobytes() for one in begun}) == len(parts)
        (part,) = (
            one
            for one, stands in zip(parts, begun, strict=True)
            if np.array_equal(stands, contact[:decided])
        )
        assert part.lower_bound <= cheap.cost
        assert part.bounds is not None
        program = stated.build(part.bounds)
        later = bound_tail_cost(program, 3)
        assert later is not None
        assert later <= after + 1e-9
        drawn = tighten_by_prefix(stated, part.bounds, 3, {3: later}, 0)
        assert drawn is not None
        part = replace(part, bounds=drawn, tail_cost=later)
    assert part.bounds is not None
    assert bound_by_prefix(stated, part.bounds, 3, 0.0) <= cheap.cost
    for _ in range(3):
        two = bisect_node(part)
        assert two is not None
        held = [one for one in two.children if held_by(one, found)]
        assert held
        assert held[0].lower_bound <= cheap.cost
        part = held[0]
        assert part.bounds is not None
        assert program_cost(stated.build(part.bounds), found) <= cheap.cost * (1 + 1e-6)
    undecided = branch_on_contacts(WalkSubproblem(stated, False, box), program, 1e-4, lambda: False)
    assert undecided is not None
    assert [one.num_decided for one in undecided] == [0]  # out of time: nothing is left out


def test_turning_of_late_knots_is_left_out_of_a_relaxation(cheap: Cheap) -> None:
    stated, box = cheap.stated, cheap.drawn.bounds
    bounds, rows = [], []
    for knots in (None, 3, 2):
        less = replace(stated, num_rotation_knots=knots)
        program = less.build(box)
        bounds.append(lowest(less, program))
        rows.append(len(program.model))
        assert program_cost(program, cheap.found) <= cheap.cost * (1 + 1e-6)
    assert bounds[0] + 1e-3 >= bounds[1] >= bounds[2] - 1e-3
    assert rows[0] > rows[1] > rows[2] > 0


def all_decided(kept: NodeLp, contact: BoolArray) -> tuple[BranchingDecision, ...]:
    rows = np.ndenumerate(kept.program.contact_rows)
    return tuple(BranchingDecision(True, int(row), float(contact[at])) for at, row in rows)


def contacts_searched(kept: NodeLp) -> ContactSearch:
    return ContactSearch(
        kept, lambda bound: True, lambda: np.inf, lambda contacts: 0.0, lambda x: None
    )


def test_a_search_over_contacts_never_loses_a_motion(cheap: Cheap) -> None:
    stated, contact = cheap.stated, cheap.found.gait.contact[:-1]
    kept = NodeLp(stated.build(cheap.drawn.bounds), 1e-4 * stated.cutoff)
    kept.reset()
    root = kept.solve(np.inf)
    assert root is not None
    assert root.x is not None
    ways = kept.select_branching(root.x)
    assert ways is not None
    assert {way.value for way in ways} == {0.0, 1.0}
    kept.apply_decisions(all_decided(kept, contact))
    gait = kept.solve(np.inf)  # the motion is in it
    assert gait is not None
    assert root.bound <= gait.bound <= cheap.cost
    assert kept.decided_contacts is not None
    assert np.array_equal(kept.decided_contacts, contact)
    bounds = list[float]()

    def goes_on(bound: float) -> bool:
        bounds.append(bound)
        return len(bounds) < 12

    cut = replace(contacts_searched(kept), should_continue=goes_on).run()
    assert bounds == sorted(bounds)
    assert 0 <= cut <= gait.bound + 1e-9
    none = replace(stated, cutoff=root.bound * 0.99)  # what is cheaper than all of its motions
    assert contacts_searched(NodeLp(none.build(None), 1e-4 * none.cutoff)).run() == none.cutoff


@pytest.mark.slow
def test_a_search_over_contacts_ends_where_highs_ends() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 3)
    answer = known(task, 20)
    assert answer.trajectory is not None
    tube = build_attitude_box(task, answer.trajectory.state, 0.3 * ANGLES, 0.3 * SPIN)
    both = include_mirror_images(tube, 20 * ANGLES, 20 * SPIN)
    assert both is not None
    stated = TaskRelaxation(task, both, answer.objective * 1.02, 1, 1, 1.5)
    program, sag = stated.build(None), 1e-4 * stated.cutoff
    search = contacts_searched(NodeLp(program, sag))
    bound = search.run()
    first = search.num_nodes
    assert search.run() == bound  # whatever was asked before
    assert search.num_nodes == 2 * first
    halved = contacts_searched(NodeLp(stated.build(None), sag, breaks_symmetry=True))
    assert halved.run() == pytest.approx(bound, rel=1e-3)
    assert halved.num_nodes < first
    solver = create_highs(60.0)
    solver.passModel(build_rows_model(program.model))
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
    assert is_mirror_symmetric(task)
    assert is_mirror_symmetric(shorter(stairs_task(), 4))
    turned = replace(task.reference, euler=task.reference.euler + 0.1 * np.eye(3)[2])
    aside = replace(task.start, state=task.start.state + 0.1 * np.eye(12)[4])
    assert not is_mirror_symmetric(replace(task, reference=turned))
    assert not is_mirror_symmetric(replace(task, start=aside))
    answer = known(task)
    found = answer.trajectory
    assert found is not None
    other = image(found)
    assert compute_objective(task, other.state, other.force) == pytest.approx(answer.objective)
    checked = check_trajectory(task, other)
    assert not format_failures(checked)
    width = np.array([0.01, 0.02, 0.01]), np.array([0.2, 0.4, 0.2])
    about = build_attitude_box(task, np.stack([found.state, other.state]), *width)
    tube = include_mirror_images(about, *width)
    assert tube is not None
    assert include_mirror_images(replace(about, angles=about.angles + 0.5), *width) is None
    stated = TaskRelaxation(task, tube, 1.01 * answer.objective, 1, 1, 3.0)
    program = stated.build(None)
    first = []
    for motion in (found, other):
        assert tube.contains(motion.state)
        x = np.zeros(len(program.model.lower))
        for column, value in program.evaluate_binaries(motion).items():
            x[column] = value
        first.append(build_symmetry_breaker(program).evaluate(x))
    assert first[0] == pytest.approx(-first[1])


@pytest.mark.slow
def test_a_search_over_contacts_keeps_what_other_seeds_find() -> None:
    task = shorter(stairs_task(), 7)
    answers = [search(task, SearchLimits(60.0, seed=k, qps=200)) for k in range(4)]
    motions = np.stack([a.trajectory.state for a in answers if a.trajectory is not None])
    tube = build_attitude_box(
        task, motions, np.deg2rad([1.0, 2.0, 1.0]), np.array([0.25, 0.5, 0.25])
    )
    least = min(answer.objective for answer in answers)
    stated = TaskRelaxation(task, tube, 1.001 * least, 1, 1, 3.0)
    kept = NodeLp(stated.build(None), 5e-4 * least)
    drawn = list[float]()

    def settled(contacts: BoolArray) -> float:
        held = kept.program.bounds.fix_contacts(contacts)
        drawn.append(bound_by_tightening(stated, held, 1, lambda: 30.0, time.process_time))
        for answer in answers:
            assert answer.trajectory is not None
            if np.array_equal(answer.trajectory.gait.contact[:-1], contacts):
                assert drawn[-1] <= answer.objective
        return drawn[-1]

    end = time.process_time() + 60.0
    found = replace(
        contacts_searched(kept),
        bound_gait=settled,
        should_continue=lambda bound: time.process_time() < end,
    )
    assert 0.6 * least < found.run() <= least


def test_what_has_no_point_is_asked_again_from_scratch() -> None:
    solver = create_lp_solver()
    solver.addVar(0.0, 1.0)
    solver.addRow(2.0, 3.0, 1, np.array([0], np.int32), np.array([1.0]))
    solver.run()
    assert confirm_infeasible(solver)
    solver.changeRowBounds(0, 0.5, 3.0)
    assert not confirm_infeasible(solver)


@pytest.mark.slow
@pytest.mark.parametrize("disturbed", [False, True])
def test_heads_keep_what_other_seeds_find(disturbed: bool) -> None:
    # Of the whole task, in a tube about all of them, below a cost that most of them are below.
    task = walk_task((-1.0, 0, 0) if disturbed else (0, 0, 0))
    answers = [search(task, SearchLimits(60.0, seed=k, qps=300)) for k in range(4)]
    cost = 1.02 * min(answer.objective for answer in answers)
    found = [a.trajectory for a in answers if a.trajectory is not None and a.objective <= cost]
    width = np.deg2rad([1.0, 2.0, 1.0]), np.array([0.25, 0.5, 0.25])
    tube = build_attitude_box(task, np.stack([one.state for one in found]), *width)
    stated = TaskRelaxation(task, tube, cost, 1, 1, 3.0)
    drawn = tighten_by_prefixes(stated, stated.build(None), 40.0, time.process_time)
    assert drawn is not None
    held = stated.build(drawn.bounds)
    assert lowest(stated, stated.build(None)) + 0.03 * cost < lowest(stated, held)
    kept = NodeLp(held, 5e-4 * cost)  # as the search over contacts has it
    for one in found:
        kept.reset()
        kept.apply_decisions(all_decided(kept, one.gait.contact[:-1]))
        point = kept.solve(np.inf)
        assert point is not None
        assert point.bound <= compute_objective(task, one.state, one.force) * (1 + 1e-6)
        assert (one.gait.contact[:-1] >= drawn.bounds.contact_low).all()
        assert (one.gait.contact[:-1] <= drawn.bounds.contact_high).all()
        assert program_cost(held, one) <= cost * (1 + 1e-6)


@pytest.mark.slow
def test_steps_on_parts_keep_what_other_seeds_find(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts_of_tubes, "_MAX_CHILDREN", 100)  # parted in any case
    task = shorter(walk_task((1.0, 0, 0)), 5)
    answers = [search(task, SearchLimits(60.0, seed=k, qps=100)) for k in range(3)]
    best = min(answers, key=lambda one: one.objective)
    assert best.trajectory is not None
    motions = np.stack([a.trajectory.state for a in answers if a.trajectory is not None])
    # Dearer motions than the best, too; so many seconds for each step.
    limits = MicpLimits(8.0, -0.03, clock=time.process_time)
    run = BranchAndBound(task, task, limits, best.trajectory, best.objective, time.process_time())
    width = np.deg2rad([1.0, 2.0, 1.0]), np.array([0.25, 0.5, 0.25])
    whole = run.create_root(build_attitude_box(task, motions, *width))
    cheaper = [a for a in answers if a.objective <= 1.02 * best.objective]
    steps = list[int]()
    for answer in cheaper:
        found, parts = answer.trajectory, [whole]
        assert found is not None
        for k in range(4):
            held = [one for one in parts if held_by(one, found)]
            assert held
            assert all(one.lower_bound <= answer.objective for one in held)
            begun = replace(run, bounds=[held[0].lower_bound], start_time=time.process_time())
            parts = process_node(begun, held[0])
            assert begun.bounds[0] <= answer.objective
            steps.append(k)
            if not parts:  # searched to its end
                break
    assert max(steps) >= 2


def test_a_program_that_comes_to_no_end_is_solved_from_scratch(
    cheap: Cheap, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, runs = cheap.stated.build(cheap.drawn.bounds), []
    true = lowest(cheap.stated, program)

    def run(solver: Any) -> None:
        runs.append(solver.getOptionValue("presolve")[1])
        if len(runs) == 1:  # as if it went round in circles
            solver.setOptionValue("simplex_iteration_limit", 0)
        run_highs(solver)
        solver.setOptionValue("simplex_iteration_limit", 100_000)

    monkeypatch.setattr(relaxed_programs, "run_highs", run)
    solver = create_lp_solver()
    solver.setOptionValue("presolve", "off")
    solver.passModel(build_rows_model(program.model, relaxed=True))
    assert solve_lp(solver) == highspy.HighsModelStatus.kOptimal
    assert runs == ["off", "on"]
    assert solver.getOptionValue("presolve")[1] == "off"
    assert solver.getInfo().objective_function_value == pytest.approx(true, rel=1e-3)
