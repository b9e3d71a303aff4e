"""Every method on small problems: answers pass the exact check, and are as good as they should."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from own_problems import enumerated, impossible, islands_problem

from climbplan.arrays import Array
from climbplan.errors import UsageError
from climbplan.learning.clusters import select_solution_columns
from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.model import FitOptions, ModelKind, fit_strategy
from climbplan.learning.neighbours import NearestProblems, Order
from climbplan.learning.strategy import Candidate
from climbplan.methods.candidate_solving import FixedIntegerSolver, candidate_at, solve_candidate
from climbplan.methods.conflicts import find_conflicting_blocks
from climbplan.methods.envelope_rounds import EnvelopeOptions
from climbplan.methods.fixed_integer_methods import NEEDS_MODEL
from climbplan.methods.table import METHODS, solve_instance
from climbplan.methods.task import Method, MethodSettings, SharedCache
from climbplan.program import Problem, Program
from climbplan.reformulations.mccormick import McCormick

SEEDS = range(5)
GLOBAL = ("minlp-scip", "mccormick", "benders")
QUICK: dict[str, MethodSettings] = {"minlp-bonmin": MethodSettings(time_limit=20.0)}


def library(problem: Problem, count: int = 16) -> Library:
    rng = np.random.default_rng(99)
    thetas = [problem.sample_parameters(rng) for _ in range(count)]
    results = [solve_instance(problem, theta, "mpcc").result for theta in thetas]
    kept = [(t, r) for t, r in zip(thetas, results, strict=True) if r.x is not None]
    return Library.of(
        ProgramSignature.of(problem.program),
        np.array([problem.feature_vector(theta) for theta, _ in kept]),
        np.array([r.x for _, r in kept]),
        np.array([r.objective for _, r in kept]),
        np.array([r.assignment for _, r in kept]),
    )


@pytest.mark.parametrize("bilinear", [True, False])
@pytest.mark.parametrize("method", [m for m in METHODS if m != "nlp"])  # which holds no integers
def test_answers_pass_the_check(method: Method, bilinear: bool) -> None:
    problem = islands_problem(bilinear)
    if method == "benders" and bilinear:
        with pytest.raises(UsageError, match="holds no products"):
            solve_instance(problem, problem.sample_parameters(np.random.default_rng(0)), method)
        return
    solved = library(problem)
    settings = replace(QUICK.get(method, MethodSettings()), library=solved)
    if method in NEEDS_MODEL:
        options = FitOptions(
            kind=cast("ModelKind", method), trees=10, cluster_trees=10, hidden=(8,), rounds=5
        )
        columns = select_solution_columns(problem.instance({"goal": np.zeros(2)}))
        settings = replace(settings, model=fit_strategy(solved, options, columns))
    near = 0
    seeds = SEEDS if method != "minlp-bonmin" else range(1)
    for seed in seeds:
        theta = problem.sample_parameters(np.random.default_rng(seed))
        best = enumerated(problem.instance(theta))
        answer = solve_instance(problem, theta, method, settings)
        result = answer.result
        assert answer.method == ("branch-and-bound" if method == "auto" else method)
        assert result.x is not None
        assert answer.winner
        check = problem.program.check(result.x, theta, result.assignment)
        assert check.passed(settings.tolerance)
        assert result.objective == pytest.approx(check.objective)
        assert result.objective >= best - 1e-5
        assert result.bound <= best + 1e-5
        near += result.objective <= best + 1e-3
    assert near == len(seeds) if method in GLOBAL else near >= 1


def test_micp_proves_and_closes_its_gap() -> None:
    problem = islands_problem(partitions={"sail": 4})
    theta = problem.sample_parameters(np.random.default_rng(1))
    result = solve_instance(problem, theta, "mccormick", MethodSettings(gap=0.05)).result
    assert result.status == "optimal"
    assert result.gap is not None
    assert result.gap <= 0.05


@pytest.mark.parametrize("method", ["minlp-scip", "mccormick"])
def test_infeasible_is_proved(method: Method) -> None:
    result = solve_instance(impossible(), {}, method).result
    assert (result.status, result.x) == ("infeasible", None)


def test_local_methods_claim_nothing() -> None:
    result = solve_instance(impossible(), {}, "mpcc").result
    assert result.status == "limit"


def test_conflicts_name_the_blocks_that_matter() -> None:
    (conflict,) = find_conflicting_blocks(impossible(), {})
    assert conflict.constraints == ("far", "near")
    assert find_conflicting_blocks(islands_problem(), {"goal": [0.0, 0.0]}) == []


def test_mpcc_starts() -> None:
    problem = islands_problem(start=lambda theta: {"x": theta["goal"], "is_set": [0.0]})
    theta = {"goal": np.array([1.0, 0.5])}
    manual = solve_instance(problem, theta, "mpcc")
    assert manual.winner.startswith("start manual")
    zero = solve_instance(problem, theta, "mpcc", MethodSettings(start="zero"))
    assert zero.winner.startswith("start zero")
    near = MethodSettings(start="knn", library=library(problem), neighbours=2)
    assert solve_instance(problem, theta, "mpcc", near).winner.startswith("neighbour")
    with pytest.raises(UsageError, match="states no `start`"):
        solve_instance(islands_problem(), theta, "mpcc", MethodSettings(start="manual"))


def two_ways() -> Program:
    """Feasible with the binary at 0 alone."""
    p = Program("two")
    least = p.parameter("least", (1,))
    x, z = p.continuous("x", (1,), 0.0, 2.0), p.binary("z", (1,))
    p.between("enough", x - least, 0.0, 2.0)
    p.when("closed", z, x, upper=-0.5)
    p.minimise("cost", x[0] ** 2)
    return p


def test_pinned_keeps_the_integers_it_is_given() -> None:
    problem = islands_problem()
    theta = {"goal": np.array([1.0, 0.5])}
    west, east = (candidate_at(np.array([0.0, 0.0, 0.0, 0.0]), np.array([k])) for k in range(2))
    only = solve_instance(problem, theta, "pinned", MethodSettings(candidates=[west]))
    assert only.result.x is not None
    assert only.result.x[0] <= -0.5 + 1e-6
    both = solve_instance(problem, theta, "pinned", MethodSettings(candidates=[west, east]))
    assert (both.winner, both.tried) == ("candidate 2", 2)
    again = solve_instance(problem, theta, "pinned", MethodSettings(candidates=[west, west]))
    assert again.tried == 1


def test_a_candidate_that_the_problems_own_checker_refuses_does_not_win() -> None:
    problem = islands_problem()
    theta = {"goal": np.array([1.0, 0.5])}
    west, east = (candidate_at(np.array([0.0, 0.0, 0.0, 0.0]), np.array([k])) for k in range(2))
    settings = MethodSettings(candidates=[east, west])
    assert solve_instance(problem, theta, "pinned", settings).winner == "candidate 1"
    dry = replace(problem, check=lambda theta, values: {"dry": max(values["x"][0], 0.0)})
    answer = solve_instance(dry, theta, "pinned", settings)
    assert (answer.winner, answer.tried) == ("candidate 2", 2)
    assert [tried.passed for tried in answer.fates] == [False, True]
    assert "own check: dry by" in answer.fates[0].word


def test_what_instances_share_is_built_once(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = islands_problem()
    solved, made = library(problem), []
    of = NearestProblems.of

    def counted(library: Library, order: Order = "points") -> NearestProblems:
        made.append(order)
        return of(library, order)

    monkeypatch.setattr(NearestProblems, "of", counted)
    kept, settings = SharedCache(), MethodSettings(library=solved)
    thetas = [problem.sample_parameters(np.random.default_rng(seed)) for seed in range(3)]
    shared = [solve_instance(problem, theta, "knn", settings, kept) for theta in thetas]
    assert made == ["mixed"]  # products are left: further starts after the strategies
    alone = [solve_instance(problem, theta, "knn", settings) for theta in thetas]
    assert [a.result.objective for a in shared] == [a.result.objective for a in alone]


def test_a_strategy_of_ones_own() -> None:
    class East:
        def candidates(self, features: Array, most: int) -> list[Candidate]:
            return [candidate_at(np.zeros(4), np.array([1]))]

    problem, theta = islands_problem(), {"goal": np.array([1.0, 0.5])}
    answer = solve_instance(problem, theta, "knn", MethodSettings(strategy=East()))
    assert answer.result.assignment is not None
    assert answer.result.assignment.tolist() == [1]


def test_micp_on_a_grid_of_ones_own_keeps_its_rows() -> None:
    problem = islands_problem()
    grid = McCormick.on({0: [[-3.0, 0.0], [0.0, 3.0]], 1: [[-3.0, 0.0], [0.0, 3.0]]})
    settings, kept = MethodSettings(envelopes=EnvelopeOptions(grid=grid)), SharedCache()
    for seed in SEEDS:
        theta = problem.sample_parameters(np.random.default_rng(seed))
        answer = solve_instance(problem, theta, "mccormick", settings, kept).result
        best = enumerated(problem.instance(theta))
        assert answer.bound <= best + 1e-5
        assert answer.objective is not None
        assert answer.objective >= best - 1e-5


def test_knn_falls_back_only_where_no_candidate_holds() -> None:
    problem = Problem("two", two_ways())
    frame = ProgramSignature.of(problem.program)
    bad = Library.of(frame, np.zeros((1, 1)), np.array([[1.0, 1.0]]), np.zeros(1))
    theta = {"least": np.array([0.5])}
    settings = MethodSettings(library=bad, solver="clarabel")
    answer = solve_instance(problem, theta, "knn", settings)
    assert answer.winner == "fallback minlp-scip"
    assert answer.result.x is not None
    alone = solve_instance(problem, theta, "knn", replace(settings, fallback=None))
    assert alone.result.status == "limit"


def switched() -> Program:
    """Each of six quantities is 1 at a price or 0; the cost is least between."""
    p = Program("switched")
    goal = p.parameter("goal", (6,))
    x, z = p.continuous("x", (6,), 0.0, 1.0), p.binary("z", (6,))
    p.when("on", z, x, lower=0.8)
    p.when("off", z, x, upper=0.2, value=False)
    p.between("few", x.sum(), 1.5, 3.0)
    p.minimise("cost", np.sum((x - goal) ** 2) + 0.1 * np.sum(z))
    return p


def test_candidates_of_a_convex_problem_are_tried_at_the_root() -> None:
    problem = Problem("switched", switched())
    rng = np.random.default_rng(0)
    theta = {"goal": rng.uniform(0.3, 0.7, 6)}
    best = solve_instance(problem, theta)
    frame = ProgramSignature.of(problem.program)
    right, wrong = best.result.x, np.zeros(12)
    assert right is not None
    both = Library.of(
        frame, np.array([[0.0] * 6, [1.0] * 6]), np.array([wrong, right]), np.zeros(2)
    )
    answer = solve_instance(problem, theta, "knn", MethodSettings(library=both, fallback=None))
    assert answer.winner == "neighbour 2 (row 1)" or answer.winner == "neighbour 1 (row 1)"
    assert answer.tried == 2
    assert answer.result.objective == pytest.approx(best.result.objective)
    assert np.isfinite(answer.result.bound)
    assert answer.result.bound <= answer.result.objective + 1e-9
    refused = replace(problem, check=lambda theta, values: {"never": 1.0})
    alone = solve_instance(refused, theta, "knn", MethodSettings(library=both, fallback=None))
    assert alone.result.x is None


def test_auto_with_a_model_tries_its_integers_first_and_proves() -> None:
    problem = islands_problem(False)
    solved = library(problem)
    columns = select_solution_columns(problem.instance({"goal": np.zeros(2)}))
    model = fit_strategy(solved, FitOptions(kind="knn"), columns)
    theta = {"goal": np.array([1.0, 0.5])}
    answer = solve_instance(problem, theta, "auto", MethodSettings(model=model))
    assert answer.method == "branch-and-bound"
    assert answer.tried > 1
    assert answer.winner == "own tree, learned integers first"
    assert answer.result.status == "optimal"


@pytest.mark.parametrize("solver", ["ipopt", "sqp"])
def test_pinned_solvers_agree(solver: FixedIntegerSolver) -> None:
    problem = islands_problem()
    instance = problem.instance({"goal": np.array([1.5, 0.2])})
    candidate = candidate_at(np.array([1.0, 0.3, 0.6, 1.0]), np.array([1]))
    result = solve_candidate(instance, candidate, solver)
    other = solve_candidate(instance, candidate, "ipopt")
    assert result.objective == pytest.approx(other.objective, abs=1e-5)
    with pytest.raises(UsageError, match="use ipopt or sqp"):
        solve_candidate(instance, candidate, "daqp")


def test_what_cannot_be_asked_for() -> None:
    problem, theta = islands_problem(), {"goal": np.zeros(2)}
    with pytest.raises(UsageError, match="unknown method 'magic'"):
        solve_instance(problem, theta, "magic")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="needs solved problems"):
        solve_instance(problem, theta, "knn")
    with pytest.raises(UsageError, match="needs integers to keep"):
        solve_instance(problem, theta, "pinned")
    with pytest.raises(UsageError, match="expected one of highs, scip, gurobi"):
        solve_instance(problem, theta, "mccormick", MethodSettings(solver="daqp"))
    frame = ProgramSignature.of(two_ways())
    other = Library.of(frame, np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1))
    with pytest.raises(UsageError, match="does not serve"):
        solve_instance(problem, theta, "knn", MethodSettings(library=other))


@pytest.mark.parametrize("whole", [True, False])
def test_auto_leaves_directions_that_nothing_bounds_to_micp(whole: bool) -> None:
    p = Program("open")
    x, y = p.continuous("x", (2,)), p.continuous("y", (1,), 0.0, 3.0)
    p.equal("tied", x[0] - x[1] - y[0])  # x[0] + x[1] is free and costs nothing
    if whole:
        z = p.binary("z", (1,))
        p.when("on", z, y, lower=1.0)
        p.minimise("cost", y[0] ** 2 - 2.0 * z[0])
    else:
        p.minimise("cost", (y[0] - 1.0) ** 2 + (x[0] - x[1]))
    answer = solve_instance(Problem("open", p), {})
    assert answer.method == "mccormick"
    assert answer.result.status == "optimal"
    assert answer.result.objective == pytest.approx(-1.0 if whole else 0.75, abs=1e-4)


def test_a_factor_without_bounds_is_named() -> None:
    p = Program("open")
    x = p.continuous("speed", (2,))
    p.between("power", x[:1] * x[1:], 1.0, 2.0)
    p.minimise("cost", np.sum(x**2))
    with pytest.raises(UsageError, match=r"speed\[0\] is a factor of a product"):
        solve_instance(Problem("open", p), {}, "mccormick")
    knots = Problem("open", p, partitions={"speed": [-2.0, 0.0, 1.0, 2.0]})
    once = MethodSettings(envelopes=EnvelopeOptions(rounds=1))
    answer = solve_instance(knots, {}, "mccormick", once).result
    assert answer.objective == pytest.approx(2.0, abs=1e-4)
    assert answer.bound == -np.inf  # the knots vouch for nothing outside them
    # Within the incumbent's cost nothing lies outside.
    again = solve_instance(knots, {}, "mccormick").result
    assert again.bound == pytest.approx(2.0, abs=1e-3)


def test_an_unbounded_problem_says_along_what_its_cost_falls() -> None:
    p = Program("unbounded")
    speed = p.continuous("speed", (2,))
    force = p.continuous("force", (1,), 0.0, 1.0)
    p.equal("straight", speed[0] - speed[1])
    p.minimise("cost", speed[0] + force[0])
    result = solve_instance(Problem("unbounded", p), {}).result
    assert (result.status, result.x) == ("limit", None)
    assert result.log[-1] == "unbounded: the cost falls without end along speed; give it bounds"


def test_the_last_word_on_an_infeasible_problem_is_the_proof() -> None:
    p = Program("empty")
    x = p.continuous("x", (1,), 0.0, 1.0)
    p.between("low", x, 2.0, 3.0)
    p.minimise("cost", x[0])
    result = solve_instance(Problem("empty", p), {}).result
    assert result.status == "infeasible"
    assert result.log[-1] == "proved: no point satisfies all constraints"
