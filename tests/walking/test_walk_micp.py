"""The mixed-integer relaxation contains the motions that it is to bound."""

from __future__ import annotations

from dataclasses import replace

import highspy
import numpy as np
import pytest
from walk_relaxations import ANGLES, SPIN, known, lifted_cost, program_cost
from walk_tasks import shorter, stairs_task, walk_task

from benchmarks.walking.given_gait import bound_of_gait
from climbplan.solvers.highs.model import build_rows_model, create_highs
from climbplan.walking.check.checker import LIMITS, check_trajectory, format_failures
from climbplan.walking.micp.attitude_box import build_attitude_box
from climbplan.walking.micp.bound_tightening import tighten_bounds
from climbplan.walking.micp.limits import MicpLimits
from climbplan.walking.micp.linear_model import LinearModel
from climbplan.walking.micp.relaxation import build_relaxation
from climbplan.walking.micp.solver import solve_micp
from climbplan.walking.micp.state_variables import StateVariables
from climbplan.walking.micp.symmetry import is_mirror_symmetric
from climbplan.walking.micp.variable_bounds import VariableBounds, propagate_body_ranges
from climbplan.walking.plan.answer import WalkAnswer
from climbplan.walking.problem.random_tasks import StartRanges, sample_start
from climbplan.walking.problem.regions import build_ground
from climbplan.walking.schema.model import MpcSpec


@pytest.mark.parametrize("seed", range(4))
def test_true_motions_are_in_the_relaxation(seed: int) -> None:
    ranges = StartRanges(1.0, 5.0, 0.3, 0.1, 0.1, 0.5, 0.02)
    task = sample_start(
        shorter(walk_task((1.0, 0, 0)), 5), ranges, np.random.default_rng(seed)
    ).task
    answer = known(task)
    cost = lifted_cost(task, answer)
    assert 0.9 * answer.objective < cost <= answer.objective * (1 + 1e-6)
    assert lifted_cost(task, answer, spoil=0.3) == np.inf


def test_a_motion_that_turns_is_in_the_relaxation() -> None:
    turning = {"velocity": [0.0, 1.0, 0.0], "rpy_deg": [0.0, 0.0, 90.0]}
    task = shorter(walk_task((1.0, 0, 0), reference=turning), 6)
    answer = known(task, 100)
    found = answer.trajectory
    assert found is not None
    assert np.abs(found.state[:, 8]).max() > 0.3
    cost = lifted_cost(task, answer)
    assert 0.8 * answer.objective < cost <= answer.objective * (1 + 1e-6)
    about = build_attitude_box(task, found.state, ANGLES, SPIN)
    for heading in (np.zeros(7), about.heading + 0.1):  # wherever axes of arms and forces head
        tube = replace(about, heading=heading)
        for plain in (False, True):
            program = build_relaxation(
                task, tube, answer.objective * 1.01, 1, 1, 1.5, constant_inertia=plain
            )
            assert program_cost(program, found) <= answer.objective * (1 + 1e-6)


def test_a_motion_on_steps_is_in_the_relaxation() -> None:
    task = shorter(stairs_task(), 6)
    answer = known(task, 150)
    assert lifted_cost(task, answer) <= answer.objective * (1 + 1e-6)


def test_a_motion_on_level_polygons_is_in_the_relaxation() -> None:
    """Two halves of a floor along a diagonal, then a step; each leg may use its regions only."""
    regions = [
        {"name": "left", "vertices": [[-1, -0.6, 0], [0.3, 0.6, 0], [-1, 0.6, 0]]},
        {"name": "right", "vertices": [[-1, -0.6, 0], [0.3, -0.6, 0], [0.3, 0.6, 0]]},
        {"name": "step", "x": [0.3, 2.0], "y": [-0.6, 0.6], "height": 0.03},
    ]
    document = {"kind": "mpc", "terrain": {"regions": regions}}
    ground = build_ground(MpcSpec.model_validate(document).terrain)
    assert ground.corners.shape[1] == 4
    task = replace(shorter(stairs_task(), 6), ground=ground)
    answer = known(task, 150)
    assert answer.trajectory is not None
    assert len(np.unique(answer.trajectory.gait.region)) > 1
    assert lifted_cost(task, answer) <= answer.objective * (1 + 1e-6)
    assert not is_mirror_symmetric(task)


def test_ways_of_cheaper_motions_are_shorter_than_their_fastest() -> None:
    task = shorter(stairs_task(), 6)
    answer = known(task, 150)
    found = answer.trajectory
    assert found is not None
    tube = build_attitude_box(task, found.state, ANGLES, SPIN)
    frame = StateVariables(task, tube, answer.objective * 1.01, 1, 1, 1.5)
    spared = []
    for n in range(6):
        for last in range(n + 1, 6):
            way = found.state[last, :2] - found.state[n, :2]
            least, most = frame.bound_displacement(n, last)
            assert (way >= least - 1e-9).all()
            assert (way <= most + 1e-9).all()
            fastest = task.dt * frame.v_high[n:last, 0].sum()
            spared.append(most[0] < fastest - 0.02)
    assert sum(spared) >= 3
    cost = answer.objective * 1.01
    off = np.array([1e-4, 1e-4])  # next to nothing is left for other velocities
    box = replace(VariableBounds.create_open(task, cost, frame.max_force), velocity_cost=off)
    narrow = StateVariables(task, tube, cost, 1, 1, 1.5, bounds=box)
    least, most = narrow.bound_displacement(1, 5)
    assert most[0] - least[0] < 0.002
    assert 0.5 * (most + least)[0] == pytest.approx(4 * 0.08 * 0.8, rel=1e-3)


@pytest.mark.slow
def test_shrinking_keeps_cheaper_motions() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    answer = known(task)
    found = answer.trajectory
    assert found is not None
    tube = build_attitude_box(task, found.state, ANGLES, SPIN)
    program = build_relaxation(task, tube, answer.objective * 1.02, 1, 1, 1.5)
    box = tighten_bounds(program, 240.0)
    assert box is not None
    assert (found.state >= box.state_low - 1e-6).all()
    assert (found.state <= box.state_high + 1e-6).all()
    weights = task.weights.velocity[:2] + task.weights.motion * task.dt**2
    cheapest = task.weights.velocity[:2] / weights * task.reference.velocity[:-1, :2]
    paid = (weights * (found.state[1:-1, 3:5] - cheapest) ** 2).sum(axis=0)
    assert (paid <= box.velocity_cost).all()
    assert (box.velocity_cost < answer.objective).all()
    force = found.force[:-1] @ program.heading_axes / (task.weight / 4)
    contact = found.gait.contact[:-1]
    assert (force.sum(axis=1) >= box.total_force_low - 1e-6).all()
    assert (force.sum(axis=1) <= box.total_force_high + 1e-6).all()
    assert (contact >= box.contact_low).all()
    assert (contact <= box.contact_high).all()
    arms = ((found.toes - found.state[:, None, :3])[:-1] @ program.heading_axes)[:, :, :2]
    assert (arms >= box.arm_low - 1e-6)[contact].all()
    assert (arms <= box.arm_high + 1e-6)[contact].all()
    assert (force >= box.force_low - 1e-6)[contact].all()
    assert (force <= box.force_high + 1e-6)[contact].all()
    assert (
        np.ptp([box.total_force_low[1:], box.total_force_high[1:]], axis=0).max()
        < 0.9 * 2 * 4 * 40 / 15.45
    )
    again = build_relaxation(task, tube, answer.objective * 1.02, 1, 1, 1.5, bounds=box)
    assert program_cost(again, found) <= answer.objective * (1 + 1e-6)
    closer = box.intersect_attitude_box(tube)
    assert closer.contains(found.state)
    before = propagate_body_ranges(task, answer.objective * 1.02).velocity
    assert (box.state_high - box.state_low)[2:, 3].sum() < 0.9 * (before[1] - before[0])[
        2:, 0
    ].sum()
    assert (
        tighten_bounds(build_relaxation(task, tube, 0.2 * answer.objective, 1, 1, 1.5), 20.0)
        is None
    )


def test_bound_and_incumbent_enclose_what_is_best() -> None:
    task = shorter(walk_task((0.5, 0, 0), min_contacts=2), 3)
    first, best = known(task, 10), known(task, 400)
    limits = MicpLimits(4.0, 0.01, angles=(0.05, 0.1, 0.05), spin=(0.5, 1.0, 0.5))
    found = solve_micp(task, limits, first)
    assert found.trajectory is not None
    assert found.bound is not None
    assert found.objective <= first.objective + 1e-9
    assert 0 < found.bound <= best.objective + 1e-6
    assert not format_failures(check_trajectory(task, found.trajectory))
    bounds = [entry.bound for entry in found.history]
    assert bounds == sorted(bounds)
    assert "within" in found.word


def test_the_contacts_of_a_motion_are_bounded_beside_all_others() -> None:
    task = shorter(walk_task((0.5, 0, 0), min_contacts=2), 3)
    best = known(task, 200)
    found = best.trajectory
    assert found is not None
    cost, contact = best.objective * 1.001, found.gait.contact[:-1]
    tube, open_box = (
        build_attitude_box(task, found.state, ANGLES, SPIN),
        VariableBounds.create_open(task, cost, 4.0),
    )
    held = build_relaxation(task, tube, cost, 1, 1, 1.5, bounds=open_box.fix_contacts(contact))
    assert program_cost(held, found) <= best.objective * (1 + 1e-6)
    if not contact.all():  # all legs down is none of them
        other = open_box.fix_contacts(np.ones_like(contact))
        assert (
            program_cost(build_relaxation(task, tube, cost, 1, 1, 1.5, bounds=other), found)
            == np.inf
        )
    limits = MicpLimits(1.0, 0.02, angles=(0.05, 0.1, 0.05), spin=(0.5, 1.0, 0.5))
    bound = bound_of_gait(task, limits, [best])
    assert 0.8 * best.objective < bound <= 0.98 * best.objective * (1 + 1e-9)
    assert bound_of_gait(task, limits, [WalkAnswer(None, np.inf, 0.0, "none")]) == 0.0


def test_shares_of_a_square_are_its_perspective() -> None:
    model = LinearModel()
    x, share = model.add_variable(-2.0, 2.0), model.add_variable(0.0, 1.0)
    epigraph = model.add_square("cost", 3.0, x, (-2.0, 2.0), 1.2, indicator=share)
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
    tube = build_attitude_box(task, answer.trajectory.state, 0.3 * ANGLES, 0.3 * SPIN)
    program = build_relaxation(task, tube, answer.objective, 1, 1, 1.5)
    solver = create_highs(30.0)
    solver.passModel(build_rows_model(program.model, relaxed=True))
    solver.run()
    assert solver.getModelStatus() == highspy.HighsModelStatus.kOptimal
    assert solver.getInfo().objective_function_value > 0.15 * answer.objective


def test_nothing_to_start_from() -> None:
    task = shorter(walk_task((0.5, 0, 0)), 3)
    found = solve_micp(task, MicpLimits(1.0), WalkAnswer(None, np.inf, 0.0, "no gait"))
    assert found.trajectory is None
    assert "no gait" in found.word


OWN = {"cost.tracking", "cost.force_difference", "cost.known", "contact.endurance"}


@pytest.mark.parametrize("on_steps", [False, True])
def test_rows_have_the_names_of_the_checks(on_steps: bool) -> None:
    task = shorter(stairs_task() if on_steps else walk_task((1.0, 0, 0)), 5)
    state = np.tile(task.start.state, (6, 1))
    program = build_relaxation(
        task, build_attitude_box(task, state, ANGLES, SPIN), 3000.0, 2, 2, 1.5
    )
    names = set(program.model.names.names)
    assert names - OWN <= set(LIMITS)
    assert {
        "dynamics.angular_velocity",
        "force.friction",
        "workspace.toe",
        "contact.no_slip",
    } <= names


def test_an_answer_that_is_off_is_named() -> None:
    task = shorter(walk_task((1.0, 0, 0)), 4)
    state = np.tile(task.start.state, (5, 1))
    program = build_relaxation(
        task, build_attitude_box(task, state, ANGLES, SPIN), 3000.0, 1, 1, 1.5
    )
    solver = create_highs(30.0)
    solver.passModel(build_rows_model(program.model, relaxed=True))
    solver.run()
    x = np.array(solver.getSolution().col_value)
    worst = {block.name: block.residual for block in program.model.residuals(x)}
    assert max(value for name, value in worst.items() if name != "integrality") < 1e-6
    x[program.states[2][0].column] += 20.0  # no velocity leads there
    assert program.model.worst(x).name == "dynamics.position"


@pytest.mark.parametrize("integrator", ["euler", "mean"])
def test_only_euler_steps_are_bounded(integrator: str) -> None:
    task = shorter(walk_task((1.0, 0, 0), integrator=integrator, workspace_over_stance=True), 4)
    first = known(task, 20)
    answer = solve_micp(task, MicpLimits(seconds=2.5), first)
    assert answer.trajectory is not None
    assert answer.objective <= first.objective * (1 + 1e-9)
    assert not format_failures(check_trajectory(task, answer.trajectory))
    proved = [entry.bound for entry in answer.history if np.isfinite(entry.bound)]
    if integrator == "euler":
        assert answer.bound is not None
        assert "bound of motions within" in answer.word
    else:
        assert answer.bound is None
        assert not proved
        assert "no bound" in answer.word
