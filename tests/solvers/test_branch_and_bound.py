"""Branch and bound against all assignments one by one, and its promises on bounds and limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from brute_force import brute_force
from random_scenes import stepping_scene, tiny_instance

from climbplan.instances.free_flyer import build_free_flyer_problem
from climbplan.methods.candidate_solving import candidate_at
from climbplan.program import Instance, Polytope, Program
from climbplan.solvers.result import KnownResult, relative_gap
from climbplan.solvers.tree import search as tree_search
from climbplan.solvers.tree.branch_and_bound import solve_branch_and_bound
from climbplan.solvers.tree.incumbent import IncumbentStore
from climbplan.solvers.tree.normal_form import build_normal_form
from climbplan.solvers.tree.relaxation import RelaxationSolver

GAP = 1e-4


def agrees(instance: Instance, optimum: float) -> None:
    """The result is what the optimum of all assignments says."""
    result = solve_branch_and_bound(instance, gap=GAP)
    if np.isinf(optimum):
        assert result.status == "infeasible", result.log
        assert result.x is None
        assert result.objective is None
        assert result.gap is None
        return
    assert result.status == "optimal", result.log
    assert result.x is not None
    assert result.objective is not None
    assert result.gap is not None
    assert result.gap <= GAP
    assert instance.violation(result.x, result.assignment) <= 1e-7
    assert result.objective == pytest.approx(instance.objective(result.x), abs=1e-12)
    close = 2 * GAP * max(abs(optimum), 1e-3)
    assert result.objective == pytest.approx(optimum, abs=close)
    assert result.bound <= optimum + 1e-6 * max(1.0, abs(optimum))


@pytest.mark.parametrize("seed", range(60))
def test_optimum_is_that_of_all_assignments(seed: int) -> None:
    instance = tiny_instance(seed)
    agrees(instance, brute_force(instance))


def test_tiny_instances_are_of_every_kind() -> None:
    results = [solve_branch_and_bound(tiny_instance(seed)) for seed in range(60)]
    assert 15 <= sum(r.status == "infeasible" for r in results) <= 45
    assert max(r.nodes for r in results) >= 3


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]
)
@pytest.mark.parametrize("blocked", [False, True])
def test_steps_over_polygons(seed: int, blocked: bool) -> None:
    scene = stepping_scene(seed, rounds=2, limbs=1, patches=2, blocked=blocked)
    agrees(scene.instantiate(), brute_force(scene.instantiate()))


def test_bound_stays_below_the_optimum_however_early_the_search_stops() -> None:
    instance = hard_instance()
    optimum = solve_branch_and_bound(instance, gap=1e-6).objective
    assert optimum is not None
    for limit in (0.0, 0.002, 0.01, 0.03, 0.1):
        result = solve_branch_and_bound(instance, gap=1e-6, time_limit=limit)
        assert result.bound <= optimum * (1 + 1e-9)
        if result.status in ("optimal", "feasible"):
            assert result.objective is not None
            assert result.x is not None
            assert result.objective >= optimum * (1 - 1e-5)
            assert instance.violation(result.x) <= 1e-7
        else:
            assert result.status == "limit"
            assert result.x is None


def hard_instance() -> Instance:
    return stepping_scene(
        25, rounds=4, limbs=3, patches=3, step=0.42, reach=0.8, blocked=True
    ).instantiate()


def test_no_time_says_limit_not_infeasible() -> None:
    result = solve_branch_and_bound(hard_instance(), time_limit=0.0)
    assert result.status == "limit"
    assert result.x is None
    assert result.assignment is None
    assert result.objective is None
    assert result.gap is None


def test_same_answer_every_time() -> None:
    first, second = (solve_branch_and_bound(hard_instance()) for _ in range(2))
    assert first.nodes == second.nodes
    assert first.objective == second.objective
    assert first.bound == second.bound
    np.testing.assert_array_equal(first.x, second.x)
    np.testing.assert_array_equal(first.assignment, second.assignment)


def test_wide_gaps_stop_early_and_claim_no_more_than_was_proved() -> None:
    worse = 0
    for seed in range(25):
        instance = stepping_scene(
            seed, rounds=4, limbs=3, patches=3, step=0.42, reach=0.8, blocked=seed % 2 == 1
        ).instantiate()
        exact, rough = (solve_branch_and_bound(instance, gap=g) for g in (1e-6, 0.6))
        assert exact.objective is not None
        assert rough.objective is not None
        assert rough.status == "optimal"
        assert rough.nodes <= exact.nodes
        assert rough.bound <= exact.objective * (1 + 1e-6)
        assert rough.objective <= exact.objective * 2.6
        worse += rough.objective > exact.objective * (1 + 1e-4)
    assert worse >= 2  # or the bounds were not put to the test


@pytest.mark.parametrize("seed", range(20))
def test_bounds_of_parts_and_exclusions_lose_nothing(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plain tree, with neither, finds the same optimum."""
    instance = stepping_scene(
        seed, rounds=3, limbs=2, patches=3, step=0.42, reach=0.75, blocked=seed % 2 == 0
    ).instantiate()
    full = solve_branch_and_bound(instance, gap=1e-6)
    monkeypatch.setattr(tree_search, "build_component_problems", lambda form, pool: [])
    monkeypatch.setattr(
        tree_search.TreeSearch,
        "_exclude_alternatives",
        lambda self, node, allowed, *others: allowed,
    )
    plain = solve_branch_and_bound(instance, gap=1e-6)
    assert full.status == plain.status
    assert full.objective == pytest.approx(plain.objective, rel=3e-6)
    assert full.nodes <= plain.nodes + 2


def test_points_are_kept_only_if_feasible_and_better() -> None:
    instance = pillar(2.0)
    relaxation = RelaxationSolver(build_normal_form(instance))
    store = IncumbentStore(instance, relaxation, gap=1e-4, tolerance=1e-7)
    cost = relaxation.form.cost

    def accepted(x: tuple[float, float]) -> bool:
        z = np.linalg.solve(cost.X, np.array(x) - cost.center)
        return store.accept(z, np.array([1 if x[0] > 0 else 0]))

    assert not accepted((2.1, 0.0))  # outside the disc
    assert not accepted((0.9, 0.0))  # inside the strip
    assert accepted((1.5, 0.0))
    assert not accepted((1.4, 0.0))  # worse
    assert accepted((2.0, 0.0))
    assert store.objective == pytest.approx(1.0)
    assert store.cutoff == pytest.approx(1.0, rel=1.1e-4)
    assert store.cutoff < 1.0


def pillar(radius: float, lower: float = -np.inf) -> Instance:
    """The point nearest to (3, 0) in a disc about the origin, to the left or right of a strip."""
    p = Program("pillar")
    x = p.continuous("x", (2,), lower, np.inf)
    p.ball("disc", x[None], radius)
    left = Polytope.halfspaces("left", np.array([[1.0, 0.0]]), np.array([-0.5]))
    right = Polytope.halfspaces("right", np.array([[-1.0, 0.0]]), np.array([-1.0]))
    p.one_of("side", x[None], [[left, right]])
    p.minimise("distance", np.sum((x - np.array([3.0, 0.0])) ** 2))
    return p.instantiate()


@pytest.mark.parametrize(
    ("radius", "x"), [(2.0, (2.0, 0.0)), (1.0, (1.0, 0.0)), (0.9, (-0.5, 0.0)), (0.5, (-0.5, 0.0))]
)
def test_balls_hold_exactly_at_their_radius(radius: float, x: tuple[float, float]) -> None:
    result = solve_branch_and_bound(pillar(radius))
    assert result.status == "optimal"
    assert result.x is not None
    np.testing.assert_allclose(result.x, x, atol=1e-4)


@pytest.mark.parametrize("radius", [0.4999, 0.0, -1.0])
def test_balls_too_small_are_infeasible(radius: float) -> None:
    assert solve_branch_and_bound(pillar(radius)).status == "infeasible"


def test_start_on_the_edge_of_a_ball_is_no_contradiction() -> None:
    p = Program("edge")
    x = p.continuous("x", (2,))
    p.ball("constant", 0.0 * x[None] + np.array([0.6, 0.8]), 1.0)
    p.ball("touching", x[None] - np.array([2.0, 0.0]), 1.0)
    p.between("wall", x[:1], -np.inf, 1.0)  # touches the ball in one point
    p.minimise("size", np.sum(x**2))
    result = solve_branch_and_bound(p.instantiate())
    assert result.status == "optimal"
    np.testing.assert_allclose(result.x, [1.0, 0.0], atol=1e-3)


def test_flat_directions_need_no_cost_if_bounded() -> None:
    p = Program("flat")
    x, free = p.continuous("x", (1,), -5.0, 5.0), p.continuous("free", (2,))
    p.ball("tether", np.array([[free[0] - x[0], free[1]]]), 1.0)
    far = Polytope.halfspaces("far", np.array([[-1.0]]), np.array([-3.0]))
    near = Polytope.halfspaces("near", np.array([[1.0]]), np.array([-4.0]))
    p.one_of("place", free[:1][None], [[far, near]])
    p.minimise("x", (x[0] - 0.5) ** 2)
    result = solve_branch_and_bound(p.instantiate())
    assert result.status == "optimal"
    assert result.objective == pytest.approx(1.5**2, rel=1e-4)  # x = 2, free = 3


def test_linear_costs_over_a_ball() -> None:
    p = Program("linear")
    x = p.continuous("x", (3,))
    p.ball("ball", x[None], 2.0)
    p.minimise("height", x[2] + 0.0 * x[0])
    result = solve_branch_and_bound(p.instantiate())
    assert result.status == "optimal"
    assert result.objective == pytest.approx(-2.0, abs=1e-4)


def test_equations_may_leave_one_point() -> None:
    p = Program("point")
    x = p.continuous("x", (2,))
    p.equal("both", x - np.array([0.25, 0.5]))
    inside = Polytope.halfspaces("inside", np.eye(2), np.ones(2))
    outside = Polytope.halfspaces("outside", -np.eye(2), -np.ones(2))
    p.one_of("side", x[None], [[outside, inside]])
    p.minimise("size", np.sum(x**2))
    result = solve_branch_and_bound(p.instantiate())
    assert result.status == "optimal"
    assert result.assignment is not None
    assert result.assignment.tolist() == [1]
    np.testing.assert_allclose(result.x, [0.25, 0.5])


def test_contradicting_equations_are_infeasible() -> None:
    p = Program("contradiction")
    x = p.continuous("x", (2,))
    p.equal("one", x[:1] - 1.0)
    p.equal("two", x[:1] - 1.1)
    p.minimise("size", np.sum(x**2))
    result = solve_branch_and_bound(p.instantiate())
    assert result.status == "infeasible"
    assert "equations" in result.log[0]


def test_units_do_not_matter() -> None:
    """Cost in other units: the same plan, proved in the same way."""
    instance = stepping_scene(3, rounds=3, limbs=2).instantiate()
    base = solve_branch_and_bound(instance)
    for factor in (1e6, 1e-6):
        scaled = replace(
            instance,
            P=instance.P * factor,
            q=instance.q * factor,
            constant=instance.constant * factor,
        )
        result = solve_branch_and_bound(scaled)
        assert result.status == "optimal"
        assert result.objective == pytest.approx(base.objective * factor, rel=2 * GAP)


@pytest.mark.parametrize("seed", range(8))
def test_what_a_laxer_instance_has_told_starts_the_tree_and_changes_no_answer(seed: int) -> None:
    lax = stepping_scene(seed, rounds=3, limbs=2, patches=3, step=0.55, reach=0.8).instantiate()
    tight = stepping_scene(seed, rounds=3, limbs=2, patches=3, step=0.5, reach=0.77).instantiate()
    first = solve_branch_and_bound(lax, gap=1e-6)
    alone = solve_branch_and_bound(tight, gap=1e-6)
    known = KnownResult(first.assignment, first.bound)
    helped = solve_branch_and_bound(tight, gap=1e-6, known_result=known)
    assert helped.status == alone.status
    assert helped.bound >= first.bound * (1 - 1e-9)
    if alone.objective is not None:
        assert helped.objective == pytest.approx(alone.objective, rel=3e-6)
        enough = relative_gap(alone.objective, first.bound) + 1e-3
        rough = solve_branch_and_bound(
            tight, gap=enough, known_result=KnownResult(alone.assignment, first.bound)
        )
        assert rough.nodes == 0  # its choices and the bound are all that is needed
        assert rough.status == "optimal"


def test_choices_that_do_not_fit_are_not_tried() -> None:
    instance = pillar(2.0)
    for wrong in (np.array([0, 0, 0]), np.array([7])):
        known = KnownResult(wrong, -np.inf)
        assert solve_branch_and_bound(instance, known_result=known).status == "optimal"


def test_a_budget_of_nodes_ends_the_search_with_what_it_has() -> None:
    instance = max(
        (tiny_instance(seed) for seed in range(60)),
        key=lambda one: solve_branch_and_bound(one, gap=GAP).nodes,
    )
    whole = solve_branch_and_bound(instance, gap=GAP)
    cut = solve_branch_and_bound(instance, gap=GAP, nodes=whole.nodes - 1)
    assert cut.nodes == whole.nodes - 1
    assert cut.bound <= whole.bound + 1e-9
    assert solve_branch_and_bound(instance, gap=GAP, nodes=whole.nodes).status == whole.status


def test_choices_that_are_proposed_are_enough_where_they_hold() -> None:
    rng = np.random.default_rng(3)
    problem = build_free_flyer_problem(rng, 3, 4)
    instance = problem.instance(problem.sample_parameters(rng))
    best = solve_branch_and_bound(instance, 1e-6)
    assert best.x is not None
    assert best.assignment is not None
    first = [candidate_at(best.x, best.assignment)]
    found = solve_branch_and_bound(instance, 1e-3, nodes=0, proposals=first)
    assert found.nodes == 0
    assert found.objective == pytest.approx(best.objective, rel=1e-6)
    assert solve_branch_and_bound(instance, 1e-3, nodes=0).x is None
