"""The compiled tree over integers: against SCIP and enumeration, bounds, memory, limits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from random_programs import random_program
from scipy import sparse

from climbplan.certificates.checker import check
from climbplan.errors import UsageError
from climbplan.instances.cart_pole import MAX_STATE, PUSHED, build_walled_cart_pole
from climbplan.methods.candidate_solving import candidate_at
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.reformulations.disjunctions import BigM
from climbplan.solvers.mixed_integer import method, tree_run
from climbplan.solvers.mixed_integer.active_set import EMPTY, SOLVED, solve_least_distance
from climbplan.solvers.mixed_integer.indicator_form import build_indicator_form
from climbplan.solvers.mixed_integer.leaf_cover import build_horizon_shift
from climbplan.solvers.mixed_integer.method import WarmStartedTree, solve_mixed_integer
from climbplan.solvers.mixed_integer.presolve import build_mixed_integer_program
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram
from climbplan.solvers.mixed_integer.tree_run import TreeRun
from climbplan.solvers.mixed_integer.working_set import WorkingSetRows, allocate_working_set
from climbplan.solvers.registry import solve

GAP = 1e-5


def _agrees_with_scip(seed: int) -> None:
    instance = random_program(seed).instantiate({})
    ours = solve_mixed_integer(instance, GAP, 60.0, 1e-6)
    scip = solve(instance, "minlp-scip", 1e-6, 60.0)
    assert ours.status in ("optimal", "infeasible")
    assert (ours.status == "infeasible") == (scip.status == "infeasible")
    if ours.objective is None or scip.objective is None:
        return
    scale = 1e-3 + abs(scip.objective)
    assert instance.violation(ours.x, ours.assignment) <= 1e-6
    assert ours.bound <= scip.objective + 1e-5 * (1.0 + abs(scip.objective))
    assert abs(ours.objective - scip.objective) <= 2e-4 * scale


@pytest.mark.parametrize("seed", range(15))
def test_random_programs_agree_with_scip(seed: int) -> None:
    _agrees_with_scip(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15, 300))
def test_many_random_programs_agree_with_scip(seed: int) -> None:
    _agrees_with_scip(seed)


def _agrees_with_highs(seed: int) -> None:
    """HiGHS has big-M rows, and tangents for squares and balls: it is less exact than the tree."""
    instance = random_program(seed).instantiate({})
    ours = solve_mixed_integer(instance, GAP, 60.0, 1e-6)
    form = BigM().apply(instance)
    highs = solve(form.instance, "highs", 1e-6, 60.0)
    assert ours.status in ("optimal", "infeasible")
    if highs.objective is None or ours.objective is None:
        assert (ours.status == "infeasible") == (highs.status == "infeasible")
        return
    scale = 1e-3 + abs(highs.objective)
    assert ours.bound <= highs.objective + 1e-4 * scale
    assert abs(ours.objective - highs.objective) <= 1e-3 * scale


@pytest.mark.parametrize("seed", range(6))
def test_random_programs_agree_with_highs(seed: int) -> None:
    _agrees_with_highs(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6, 100))
def test_many_random_programs_agree_with_highs(seed: int) -> None:
    _agrees_with_highs(seed)


def test_integers_that_are_proposed_are_tried_first() -> None:
    problem = build_walled_cart_pole(8)
    instance = problem.instance({"start": PUSHED})
    best = solve_mixed_integer(instance, 1e-3, tolerance=1e-6)
    assert best.x is not None
    assert best.assignment is not None
    good = candidate_at(best.x, best.assignment)
    bad = candidate_at(np.where(instance.integer, 1.0 - best.x, best.x), best.assignment)
    hasty = WarmStartedTree(1e-3, 1e-6, work=1).solve(instance, proposals=[bad, good])
    assert hasty.nodes == 1
    assert hasty.objective == pytest.approx(best.objective, rel=1e-6)
    made_good = WarmStartedTree(1e-3, 1e-6, work=1).solve(instance, proposals=[bad])
    assert made_good.status == "optimal"
    alone = WarmStartedTree(1e-3, 1e-6, work=1).solve(instance)
    assert alone.nodes == 1


def test_active_set_agrees_with_daqp_and_proves_what_is_empty() -> None:
    import daqp

    rng = np.random.default_rng(0)
    empty = 0
    for trial in range(60):
        k = int(rng.integers(2, 30))
        m = int(rng.integers(k, 6 * k))
        M = rng.normal(size=(m, k))
        M /= np.linalg.norm(M, axis=1)[:, None]
        if trial % 3 == 0:
            M[m // 2 :] = M[: m - m // 2]  # the same rows twice
        at = M @ rng.normal(size=k) * (trial % 2) * 3.0
        shift = rng.uniform(0.0, 0.3, m) if trial % 5 == 0 else 0.0
        lower, upper = at - rng.uniform(0, 0.5, m) + shift, at + rng.uniform(0, 0.5, m)
        lower = np.minimum(lower, upper)
        found, value, flag, _ = daqp.solve(
            np.eye(k), np.zeros(k), M, upper, lower, np.zeros(m, np.int32), primal_tol=1e-10
        )
        rows = WorkingSetRows(
            M, np.ascontiguousarray(M.T), lower, upper, np.ones(m, np.uint8), np.full(m, 1e-10),
            np.array([m]), np.zeros(1, np.uint8),
        )  # fmt: skip
        w = allocate_working_set(m, k)
        status = solve_least_distance(rows, w, np.inf, 5000)
        if flag > 0:
            assert status == SOLVED
            assert w.v @ w.v / 2 == pytest.approx(value, rel=1e-6, abs=1e-9)
            assert np.allclose(w.v, found, atol=1e-5)
            continue
        empty += 1
        assert status == EMPTY
        n = int(w.ray_count[0])
        side, row, ray = w.ray_side[:n], w.ray_row[:n], w.ray[:n]
        edge = np.where(side > 0, upper[row], -lower[row])
        assert (ray >= -1e-9)[lower[row] < upper[row]].all()
        assert edge @ ray < 0
        assert np.abs((side * ray) @ M[row]).max() < 1e-6 * -(edge @ ray)
    assert empty > 3


def test_published_cart_pole_is_solved_to_the_gap_in_few_nodes() -> None:
    instance = build_walled_cart_pole().instance({"start": PUSHED})
    found = solve_mixed_integer(instance, 1e-3, tolerance=1e-6)
    scip = solve(instance, "minlp-scip", 1e-4, 120.0)
    assert found.status == "optimal"
    assert found.nodes <= 30
    assert found.objective == pytest.approx(scip.objective, rel=1e-3)
    assert found.bound <= scip.objective * (1 + 1e-4)


@pytest.mark.parametrize("noise", [0.001, 0.003])
def test_memory_gives_the_same_optimum_with_fewer_steps(noise: float) -> None:
    problem = build_walled_cart_pole()
    blocks, rng = problem.program.blocks, np.random.default_rng(0)
    memory, state = WarmStartedTree(1e-3, 1e-6), PUSHED
    steps = np.zeros(2)
    for t in range(24):
        instance = problem.instance({"start": state})
        cold = solve_mixed_integer(instance, 1e-3, tolerance=1e-6)
        warm = memory.solve(
            instance, move=(lambda f: build_horizon_shift(blocks, f, 1)) if t else None
        )
        assert cold.status == warm.status == "optimal"
        assert warm.objective == pytest.approx(cold.objective, rel=1e-3)
        assert warm.bound <= cold.objective * (1 + 1e-9)
        if t > 12:  # the first problems take one node without any help
            steps += [_dual_steps(cold.log), _dual_steps(warm.log)]
        state = problem.values(warm.x)["state"][1] + noise * rng.normal(size=4) * MAX_STATE
    assert steps[1] < 0.5 * steps[0]


def test_memory_without_a_move_serves_other_parameters() -> None:
    problem = build_walled_cart_pole()
    memory = WarmStartedTree(1e-3, 1e-6)
    for push in (1.0, 0.9, 0.2, 0.95):
        instance = problem.instance({"start": push * PUSHED})
        warm, cold = memory.solve(instance), solve_mixed_integer(instance, 1e-3, tolerance=1e-6)
        assert warm.status == cold.status == "optimal"
        assert warm.objective == pytest.approx(cold.objective, rel=1e-3, abs=1e-8)


def test_a_tree_out_of_work_answers_feasibly_and_goes_on_the_next_time() -> None:
    problem = build_walled_cart_pole()
    instance = problem.instance({"start": PUSHED})
    whole = solve_mixed_integer(instance, 1e-4, tolerance=1e-6)
    assert whole.objective is not None
    answers = []
    for _ in range(2):  # the same answers however fast the machine is
        memory = WarmStartedTree(1e-4, 1e-6, work=150)
        answers.append([memory.solve(instance) for _ in range(12)])
    for one, other in zip(*answers, strict=True):
        assert (one.objective, one.bound, one.nodes) == (other.objective, other.bound, other.nodes)
    bounds = [found.bound for found in answers[0]]
    assert answers[0][0].status != "optimal"
    for found in answers[0]:
        assert found.bound <= whole.objective * (1 + 1e-9)
        if found.x is not None:
            assert instance.violation(found.x) <= 1e-6
            assert found.objective is not None
            assert found.objective >= whole.bound - 1e-9
    assert bounds[-1] > bounds[0]  # what is remembered is gone on with
    assert answers[0][-1].status == "optimal"


@pytest.mark.parametrize("most", [1, 5, 20])
def test_the_upper_part_of_a_tree_covers_as_its_leaves_do(most: int) -> None:
    problem = build_walled_cart_pole()
    memory = WarmStartedTree(1e-3, 1e-6, work=8 * most)
    for push in (1.0, 0.97, 0.94, 0.91):
        memory.solve(problem.instance({"start": push * PUSHED}))
        assert memory.leaves is not None
        assert len(memory.leaves.low) <= most
    memory.work = 10**9  # whatever was stopped early and thinned out has still all integers
    instance = problem.instance({"start": 0.9 * PUSHED})
    warm, cold = memory.solve(instance), solve_mixed_integer(instance, 1e-3, tolerance=1e-6)
    assert warm.status == "optimal"
    assert warm.objective == pytest.approx(cold.objective, rel=1e-3)


def test_a_limit_of_nodes_leaves_a_valid_bound() -> None:
    instance = random_program(13).instantiate({})
    whole = solve_mixed_integer(instance, 1e-6, tolerance=1e-6)
    assert whole.objective is not None
    for nodes in range(1, 6):
        part = solve_mixed_integer(instance, 1e-6, tolerance=1e-6, nodes=nodes)
        assert part.nodes <= nodes
        assert part.bound <= whole.objective + 1e-9 * abs(whole.objective)


def _heavy() -> Instance:
    """Dense enough that its root alone takes many times as long as the limits of tests."""
    rng = np.random.default_rng(3)
    n, m = 700, 2200
    p = Program("heavy")
    x = p.continuous("x", (n,), -1.0, 1.0)
    p.binary("z", (6,))
    p.minimise("cost", np.sum((x - rng.normal(size=n)) ** 2))
    A, most = rng.normal(size=(m, n + 6)), rng.uniform(0.1, 1.0, m)
    return replace(
        p.instantiate({}),
        A=sparse.csr_matrix(A),
        Q=sparse.csr_matrix((m, 0)),
        row_lower=np.full(m, -np.inf),
        row_upper=most,
    )


@pytest.mark.slow
def test_the_clock_stops_a_search_within_a_node() -> None:
    instance = _heavy()
    solve_mixed_integer(random_program(0).instantiate({}))  # compiles
    root = solve_mixed_integer(instance, 1e-3, nodes=1)
    limit = 0.5 * root.time
    part = solve_mixed_integer(instance, 1e-3, limit)
    assert part.nodes <= 1
    assert part.time < 0.8 * root.time
    assert part.bound <= root.bound + 1e-9 * abs(root.bound)


def test_the_clock_stops_while_the_program_is_built() -> None:
    part = WarmStartedTree(1e-3, proves=True)
    result = part.solve(random_program(13).instantiate({}), 0.0)
    assert result.status == "limit"
    assert result.bound == -np.inf
    assert result.nodes == 0
    assert "while the program was built" in result.log[0]


def test_same_answer_every_time() -> None:
    instance = build_walled_cart_pole().instance({"start": 0.8 * PUSHED})
    first, second = (solve_mixed_integer(instance, 1e-4) for _ in range(2))
    assert first.nodes == second.nodes
    assert first.bound == second.bound
    assert np.array_equal(first.x, second.x)


def test_an_open_direction_without_cost_is_refused() -> None:
    p = Program("open")
    x, z = p.continuous("x", (2,)), p.binary("z", (1,))
    p.when("on", z, x[:1], lower=1.0)
    p.minimise("cost", x[0] ** 2 - z[0])
    with pytest.raises(UsageError, match="direction without cost is not bounded"):
        solve_mixed_integer(p.instantiate())


def test_contradictions_are_found_before_any_search() -> None:
    p = Program("contradiction")
    x, z = p.continuous("x", (1,), 0.0, 1.0), p.binary("z", (1,))
    p.when("high", z, x, lower=2.0)
    p.when("low", z, x, lower=3.0, value=False)
    p.minimise("cost", x[0] ** 2)
    found = solve_mixed_integer(p.instantiate())
    assert found.status == "infeasible"
    assert found.bound == np.inf


def _dual_steps(log: tuple[str, ...]) -> int:
    return int(next(line for line in log if "dual steps" in line).split()[-3])


def test_rows_that_rounding_takes_for_independent_do_not_pile_up() -> None:
    """Once more active rows than columns were taken here, beyond the room there is for them."""
    start = np.array(
        [0.29071365596472104, -0.00499017123496892, -0.17394635835447503, -0.0016875500368030909]
    )
    found = solve_mixed_integer(build_walled_cart_pole().instance({"start": start}), 1e-3)
    assert found.status == "optimal"


@pytest.mark.parametrize("seed", [674, 876, 1087, 1400])
def test_rows_that_contradict_each_other_by_little_are_no_incumbent(seed: int) -> None:
    """Both can be active with multipliers of 1e15, and neither be met; SCIP calls these empty."""
    answer = WarmStartedTree(1e-5, 1e-6).solve(random_program(seed).instantiate({}), 60.0)
    assert answer.status == "infeasible"


def test_rays_of_rounding_errors_prove_no_bound() -> None:
    """Beside narrow ranges a ray may consist of rounding errors, which prove no infeasibility."""
    lower, upper = np.full(13, -np.inf), np.full(13, np.inf)
    lower[2:7], upper[2:7] = [-2.120919665801982, 0.0, 0.0, 0.0, 0.0], [3.5, 1.0, 1.0, 1.0, 1.0]
    lower[7:9] = [-1.0000254433134535e-06, -1.0000262312498882e-06]
    upper[7:9] = [0.0007429032414068002, 0.0007429032413002939]
    upper[11:] = 5.0
    rows = np.zeros((12, 13))
    rows[[0, 1], [0, 1]], rows[[0, 1], [9, 10]], rows[2, 2:7] = -1.0, 1.0, 1.0
    for first, (bound, sign) in enumerate(((7, 1.0), (7, -1.0), (11, 1.0), (11, -1.0))):
        for k in range(2):
            rows[3 + 2 * first + k, [bound + k, 9 + k]] = -1.0, sign
    rows[11, [3, 9]] = -4.0, 1.0
    slope = np.zeros(13)
    slope[2:9] = [
        1.1229209699055602, 0.6651080120448106, 0.5034166659467222, 1.1180498251819484,
        -0.68303728113005, 1.0, 1.0,
    ]  # fmt: skip
    program = Program("rays")
    program.minimise("cost", program.continuous("v", (13,), -1.0, 1.0).sum())
    instance = replace(
        program.instantiate(),
        lower=lower,
        upper=upper,
        q=slope,
        P=sparse.csc_matrix(np.diag([0.2, 0.2] + 11 * [0.0])),
        A=sparse.csr_matrix(rows),
        row_lower=np.array(3 * [1.0] + 9 * [-np.inf]),
        row_upper=np.array(3 * [1.0] + 8 * [0.0] + [-1.0]),
        Q=sparse.csr_matrix((12, 0)),
        constant=-3.0,
        integer=np.isin(np.arange(13), range(2, 7)),
    )
    point = np.array([-1, -1, -2, 1, 1, 0, 1, 0, 0, 0, 0, 5, 5], float)
    assert instance.violation(point) < 1e-9
    assert solve_mixed_integer(instance, gap=1e-6, time_limit=60.0).bound <= instance.objective(
        point
    )


def test_arrays_of_rows_grow_together() -> None:
    """Compiled code checks no index, so that one short array corrupts memory."""
    instance = random_program(0).instantiate({})
    program = build_mixed_integer_program(instance, build_indicator_form(instance), np.inf)
    assert isinstance(program, MixedIntegerProgram)
    run = TreeRun.create(program, 1e-4, 1e-6)
    rows = len(run.search.rows.enabled)
    before = _collect_lengths(run.search, rows)
    assert {"shift", "base_lower", "direction", "rows.lower", "main.active"} <= set(before)
    run._double_rows()
    assert set(_collect_lengths(run.search, 2 * rows)) == set(before)


def _collect_lengths(search: Any, length: int, prefix: str = "") -> list[str]:
    """Return the names of arrays of which one side has a length."""
    names = []
    for name, value in search._asdict().items():
        if isinstance(value, np.ndarray) and length in value.shape:
            names.append(prefix + name)
        elif hasattr(value, "_asdict"):
            names += _collect_lengths(value, length, f"{name}.")
    return names


def _state_one_point() -> Program:
    """x = (1, -3) and z = 0 is the only point, and has the largest cost of the box."""
    p = Program("one point")
    x = p.continuous("x", (2,), np.array([-1.0, -3.0]), np.array([1.0, -2.0]))
    z = p.binary("z", (1,))[0]
    p.between("upper", np.array([x[0] + x[1]]), -np.inf, 2.0)
    p.equal("corner", np.array([x[0] - x[1] - 3.0 * z - 4.0]))
    p.minimise("cost", -x[0] - 2.0 * x[1] - 2.0 * z)
    return p


def _state_no_cost() -> Program:
    """|x| + |y| <= 2 with open epigraphs."""
    p = Program("no cost")
    x, y = p.continuous("x", (3,), -4.0, 4.0), p.integer("y", (1,), -4, 4)
    heights, v = p.continuous("heights", (4,)), np.append(x, y)
    p.between("above", v - heights, -np.inf, 0.0)
    p.between("below", -v - heights, -np.inf, 0.0)
    p.between("length", np.array([np.sum(heights)] * 3), -np.inf, np.array([2.0, 3.0, 2.0]))
    p.minimise("cost", 0.0 * x[0])
    return p


@pytest.mark.parametrize(
    ("program", "optimum"), [(_state_one_point(), 5.0), (_state_no_cost(), 0.0)]
)
def test_bounds_that_round_beyond_the_largest_cost_prove_nothing(
    program: Program, optimum: float
) -> None:
    result = WarmStartedTree(proves=True).solve(program.instantiate())
    assert result.status == "optimal"
    assert result.objective == pytest.approx(optimum, abs=1e-6)


def test_costs_of_fixed_variables_leave_others_their_scale() -> None:
    p = Program("fixed")
    x, z = p.continuous("x", (1,), -1.0, -1.0), p.integer("z", (2,), -1, 1)
    p.minimise("cost", 3.0 * x[0] + 1.0)
    assert len(z) == 2
    result = solve_mixed_integer(p.instantiate())
    assert result.status == "optimal"
    assert result.objective == pytest.approx(-2.0, abs=1e-6)


def _state_unit_commitment(demand: tuple[float, ...]) -> Program:
    """Start-ups and commitments, which cost nothing to second order."""
    steps, largest, smallest = len(demand), np.array([100, 80, 50.0]), np.array([30, 20, 10.0])
    program = Program("unit commitment")
    on = program.binary("on", (3, steps))
    start = program.continuous("start", (3, steps), 0.0, 1.0)
    power = program.continuous("power", (3, steps), 0.0, 120.0, unit="MW")
    program.equal("balance", np.sum(power, axis=0) - np.array(demand), unit="MW")
    program.between("largest", power - largest[:, None] * on, upper=0.0)
    program.between("smallest", power - smallest[:, None] * on, lower=0.0)
    program.between("starts", start[:, 1:] - on[:, 1:] + on[:, :-1], lower=0.0)
    program.between("first", start[:, 0] - on[:, 0], lower=0.0)
    linear, quadratic = np.array([10, 12, 18.0]), np.array([0.02, 0.03, 0.05])
    fuel = np.sum(linear[:, None] * power) + np.sum(quadratic[:, None] * power**2)
    fixed, started = np.array([200, 150, 80.0]), np.array([500, 300, 100.0])
    program.minimise("fuel", fuel)
    program.minimise("fixed", np.sum(fixed[:, None] * on) + np.sum(started[:, None] * start))
    return program


_DEMANDS = [
    ((61.2, 112.0, 69.3, 90.5, 81.0, 90.7), 7860.7134),
    ((158.0, 90.0, 79.0, 146.0, 85.0, 113.0), 10990.97),
]  # with the optima of SCIP


@pytest.mark.parametrize(
    ("demand", "optimum", "repeats"),
    [(*_DEMANDS[0], True), (*_DEMANDS[1], True), (*_DEMANDS[0], False)],
)
def test_leaves_on_which_the_active_set_fails_are_solved(
    demand: tuple[float, ...], optimum: float, repeats: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a larger proximal term, or without it by an interior-point method."""
    if not repeats:
        monkeypatch.setattr(method, "build_mixed_integer_program", _build_by_curvature)
    solution = solve_mixed_integer(_state_unit_commitment(demand).instantiate({}))
    assert solution.status == "optimal"
    assert solution.objective == pytest.approx(optimum, rel=1e-4)
    assert optimum * (1 - 1e-4) <= solution.bound <= optimum * (1 + 1e-9)
    is_resolved = any("interior-point" in line for line in solution.log)
    assert is_resolved != repeats


def _build_by_curvature(*arguments: Any, by_gradient: bool = False) -> Any:
    """Build a program whose proximal term is that of its curvature in any case."""
    return build_mixed_integer_program(*arguments[:4])


@pytest.mark.parametrize(("demand", "optimum"), _DEMANDS)
def test_searches_that_lose_accuracy_are_certified(
    demand: tuple[float, ...], optimum: float
) -> None:
    instance = _state_unit_commitment(demand).instantiate({})
    tree = WarmStartedTree(proves=True)
    for _ in range(2):  # the second search begins with the larger term
        assert tree.solve(instance).status == "optimal"
        assert tree.by_gradient
        assert tree.certificate is not None
        assert optimum * (1 - 2e-4) <= tree.certificate.bound <= optimum
        assert check(instance, tree.certificate).bound == tree.certificate.bound


def test_a_search_goes_on_where_its_repetition_proves_less(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    create, repetitions = TreeRun.create, []

    def create_idle(*arguments: Any) -> Any:
        run = create(*arguments)
        if len(arguments) == 3:  # a repetition, which begins with no leaves
            repetitions.append(run)
            run.run_until = lambda *limits: None
        return run

    demand, optimum = _DEMANDS[0]
    monkeypatch.setattr(method, "_MAX_GIVEN_UP", 1)
    monkeypatch.setattr(tree_run, "_WORK_PER_PIECE", 1.0)
    monkeypatch.setattr(TreeRun, "create", create_idle)
    solution = solve_mixed_integer(_state_unit_commitment(demand).instantiate({}))
    assert len(repetitions) == 1
    assert solution.status == "optimal"
    assert solution.objective == pytest.approx(optimum, rel=1e-4)


def test_costs_with_curvature_keep_their_proximal_term() -> None:
    tree = WarmStartedTree()
    for seed in range(5):
        tree.solve(random_program(seed).instantiate({}))
    assert not tree.by_gradient
