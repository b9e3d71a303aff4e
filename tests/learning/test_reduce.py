"""ReDUCE: clusters, and reduced programs that hold the cluster's integers and no others."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from climbplan.errors import UsageError
from climbplan.learning.clusters import (
    OUTLIER,
    ClusterOptions,
    cluster_solutions,
    select_solution_columns,
)
from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.model import FitOptions, fit_strategy
from climbplan.methods.candidate_solving import candidate_at, solve_candidate
from climbplan.methods.reduced import ClusterReduction
from climbplan.methods.reduced_programs import ClusterSolve, ReducedPrograms
from climbplan.program import Program
from climbplan.reformulations.grids import each, uniform
from climbplan.solvers.registry import solve

PIECES = 8


def crossing() -> Program:
    """Reach an area x y = 1 near a goal, in one of the ways that two binaries allow."""
    p = Program("crossing")
    goal = p.parameter("goal", (2,))
    x = p.continuous("x", (2,), 0.25, 4.0)
    side = p.binary("side", (2,))
    p.equal("area", x[0] * x[1] - 1.0)
    p.when("wide", side[0], x[0], lower=1.0)
    p.when("slim", side[0], x[0], upper=1.5, value=False)
    p.when("tall", side[1], x[1], lower=0.8)
    p.when("flat", side[1], x[1], upper=1.2, value=False)
    p.minimise("distance", np.sum((x - goal) ** 2) + 0.1 * side[0] + 0.05 * side[1])
    return p


PROGRAM = crossing()
PARTITIONS = each(PROGRAM.variables["x"], uniform(0.25, 4.0, PIECES))


def _best(goal: np.ndarray, combinations: list[tuple[float, float]]) -> float:
    instance = PROGRAM.instantiate({"goal": goal})
    found = []
    for side, start in product(combinations, (0.4, 1.0, 2.5)):
        x = np.array([start, 1 / start, *side])
        result = solve_candidate(instance, candidate_at(x, np.zeros(0, np.int64)))
        found.append(np.inf if result.objective is None else result.objective)
    return min(found)


def _library(count: int = 60) -> Library:
    rng = np.random.default_rng(0)
    goals, points, costs = [], [], []
    for _ in range(count):
        wide = rng.uniform() < 0.5
        goal = np.array([3.0, 0.3]) if wide else np.array([0.3, 3.0])
        goal = goal + rng.uniform(-0.2, 0.2, 2)
        result = solve(PROGRAM.instantiate({"goal": goal}), "minlp-scip", gap=1e-4, time_limit=10.0)
        assert result.x is not None
        goals.append(goal)
        points.append(result.x)
        costs.append(result.objective)
    return Library.of(
        ProgramSignature.of(PROGRAM), np.array(goals), np.array(points), np.array(costs)
    )


@pytest.fixture(scope="module")
def library() -> Library:
    return _library(40)


def _reduction(library: Library, rows: np.ndarray) -> ClusterReduction:
    return ClusterReduction.of(
        PARTITIONS, library.points[rows], library.alternatives[rows], library.frame.integer
    )


def test_binaries_are_the_logarithm_of_what_occurs(library: Library) -> None:
    rows = np.flatnonzero(library.features[:, 0] > 1)
    reduction = _reduction(library, rows)
    expected = 0
    for partition in PARTITIONS:
        used = {partition.find_piece(x) for x in library.points[rows]}
        expected += int(np.ceil(np.log2(len(used))))
    ways = len(np.unique(library.points[rows][:, 2:], axis=0))
    expected += int(np.ceil(np.log2(ways)))
    assert reduction.binary_count == expected
    program = reduction.build_form(PROGRAM.instantiate({"goal": np.zeros(2)})).build(
        PROGRAM.instantiate({"goal": np.ones(2)})
    )
    assert int(program.instance.integer.sum()) == expected
    assert expected < 2 + 2 * 3  # the whole program's


@pytest.mark.parametrize("solver", ["highs", "minlp-scip"])
def test_reduced_program_bounds_the_best_of_its_cluster(library: Library, solver: str) -> None:
    rows = np.flatnonzero(library.features[:, 0] > 1)
    reduction = _reduction(library, rows)
    ways = [tuple(v) for v in reduction.values]
    form = None
    for row in rows[:4]:
        instance = PROGRAM.instantiate({"goal": library.features[row]})
        form = form or reduction.build_form(instance)
        program = form.build(instance)
        found = solve(program.instance, solver, gap=1e-4, time_limit=20.0)
        assert found.x is not None
        assert tuple(np.round(found.x[2:4])) in ways
        best = _best(library.features[row], ways)
        assert found.bound <= best + 1e-3  # envelopes hold the cluster's solutions
        assert best == pytest.approx(library.objective[row], rel=1e-3, abs=1e-3)


def test_pieces_shrink_to_the_solutions_in_them(library: Library) -> None:
    rows = np.flatnonzero(library.features[:, 0] > 1)
    points = library.points[rows]
    args = (PARTITIONS, points, library.alternatives[rows], library.frame.integer)
    whole, shrunk = ClusterReduction.of(*args, room=np.inf), ClusterReduction.of(*args, room=0.05)
    assert shrunk.binary_count == whole.binary_count
    for before, after in zip(whole.partitions, shrunk.partitions, strict=True):
        width = before.upper - before.lower
        assert (after.lower >= before.lower).all()
        assert (after.upper <= before.upper).all()
        values = points[:, after.variables]
        inside = (values[:, None] >= after.lower - 1e-9) & (values[:, None] <= after.upper + 1e-9)
        assert inside.all(axis=2).any(axis=1).all()
        for low, high, most in zip(after.lower, after.upper, width, strict=True):
            mine = values[((values >= low - 1e-9) & (values <= high + 1e-9)).all(axis=1)]
            assert (mine.min(axis=0) - low <= 0.05 * most + 1e-9).all()
            assert (high - mine.max(axis=0) <= 0.05 * most + 1e-9).all()
    assert any(
        (after.upper - after.lower < 0.9 * (before.upper - before.lower)).any()
        for before, after in zip(whole.partitions, shrunk.partitions, strict=True)
    )


def test_other_strategies_of_the_cluster_follow_its_program(library: Library) -> None:
    instance = PROGRAM.instantiate({"goal": library.features[0]})
    options = FitOptions(kind="reduce", cluster_trees=20, clusters=ClusterOptions(least=5))
    ranking = fit_strategy(
        library, options, select_solution_columns(instance)
    ).create_cluster_ranking()
    goal = library.features[0]
    cluster = int(ranking.rank(goal, 1)[0])
    nearest = ranking.list_strategies(goal, cluster)
    members = ranking.list_members(cluster)
    assert len(nearest) == len(np.unique(library.strategy[members]))
    distance = np.linalg.norm((library.features[nearest] - goal) / ranking.scale, axis=1)
    assert (np.diff(distance) >= 0).all()
    for row in nearest:
        alike = members[library.strategy[members] == library.strategy[row]]
        apart = np.linalg.norm((library.features[alike] - goal) / ranking.scale, axis=1)
        assert library.strategy[row] in library.strategy[members]
        assert apart.min() == pytest.approx(
            float(np.linalg.norm((library.features[row] - goal) / ranking.scale))
        )
    found = list(ReducedPrograms(ranking, PARTITIONS).candidates(instance, goal, 1))
    scored = [np.isfinite(candidate.score) for candidate in found]
    assert scored == sorted(scored, reverse=True)  # the program's first
    assert {c.number for c in found if c.number >= 0} >= set(library.strategy[nearest])
    none = list(ReducedPrograms(ranking, PARTITIONS, others=0).candidates(instance, goal, 1))
    assert all(np.isfinite(candidate.score) for candidate in none)


def test_a_cluster_whose_program_has_no_point_still_offers_its_strategies(
    library: Library,
) -> None:
    options = FitOptions(kind="reduce", cluster_trees=20, clusters=ClusterOptions(least=5))
    instance = PROGRAM.instantiate({"goal": library.features[0]})
    ranking = fit_strategy(
        library, options, select_solution_columns(instance)
    ).create_cluster_ranking()
    nowhere = replace(instance, lower=np.where(instance.integer, instance.lower, 3.9))
    solves: list[ClusterSolve] = []
    programs = ReducedPrograms(ranking, PARTITIONS, report=solves.append)
    found = list(programs.candidates(nowhere, library.features[0], 1))
    assert solves[0].status == "infeasible"
    cluster = int(ranking.rank(library.features[0], 1)[0])
    assert [c.row for c in found] == list(ranking.list_strategies(library.features[0], cluster))


def test_integers_of_other_clusters_are_out_of_reach(library: Library) -> None:
    rows = np.flatnonzero(library.features[:, 0] > 1)
    other = library.features[np.flatnonzero(library.features[:, 0] < 1)[0]]
    reduction = _reduction(library, rows)
    instance = PROGRAM.instantiate({"goal": other})
    found = solve(reduction.build_form(instance).build(instance).instance, "highs", gap=1e-3)
    assert found.x is not None
    assert found.x[0] >= min(p[0] for p in library.points[rows]) - 1.0
    assert tuple(np.round(found.x[2:4])) in [tuple(v) for v in reduction.values]


def test_online_the_likeliest_cluster_is_solved_and_made_exact(library: Library) -> None:
    instance = PROGRAM.instantiate({"goal": library.features[0]})
    options = FitOptions(kind="reduce", cluster_trees=20, clusters=ClusterOptions(least=5))
    model = fit_strategy(library, options, select_solution_columns(instance))
    ranking = model.create_cluster_ranking()
    assert ranking.count >= 2
    solves: list[ClusterSolve] = []
    programs = ReducedPrograms(ranking, PARTITIONS, gap=1e-4, report=solves.append)
    for row in (0, 1, 2, 3):
        goal = library.features[row]
        here = PROGRAM.instantiate({"goal": goal})
        results = [
            solve_candidate(here, candidate).objective
            for candidate in programs.candidates(here, goal, 1)
        ]
        reached = [value for value in results if value is not None]
        assert min(reached) == pytest.approx(library.objective[row], rel=1e-3, abs=1e-3)
    assert len(solves) == 4
    assert all(solve.status == "optimal" for solve in solves)


def test_further_clusters_only_until_done(library: Library) -> None:
    instance = PROGRAM.instantiate({"goal": library.features[0]})
    options = FitOptions(kind="reduce", cluster_trees=20, clusters=ClusterOptions(least=5))
    ranking = fit_strategy(
        library, options, select_solution_columns(instance)
    ).create_cluster_ranking()
    for done, expected in ((True, 1), (False, 2)):
        solves: list[ClusterSolve] = []
        programs = ReducedPrograms(ranking, PARTITIONS, report=solves.append)
        list(programs.candidates(instance, library.features[0], 1, 60.0, 1, lambda: done))  # noqa: B023
        assert len(solves) == expected
    assert not list(programs.candidates(instance, library.features[0], 3, 0.0))


def test_an_unknown_solver_is_refused(library: Library) -> None:
    columns = select_solution_columns(PROGRAM.instantiate({"goal": np.ones(2)}))
    model = fit_strategy(library, FitOptions(kind="reduce", cluster_trees=5), columns)
    with pytest.raises(UsageError, match="no solver 'daqp'"):
        ReducedPrograms(model.create_cluster_ranking(), PARTITIONS, solver="daqp")


def _blobs() -> np.ndarray:
    rng = np.random.default_rng(2)
    centers = np.array([[0.0, 0.0], [8.0, 0.0], [0.0, 8.0]])
    sizes = (30, 20, 12)
    parts = [c + 0.3 * rng.normal(size=(n, 2)) for c, n in zip(centers, sizes, strict=True)]
    return np.vstack([*parts, [[30.0, 30.0]]])


@pytest.mark.parametrize("method", ["hdbscan", "optics", "dbscan", "kmeans"])
def test_every_method_finds_separate_clusters_largest_first(method: str) -> None:
    vectors = _blobs()[:-1]
    options = ClusterOptions(method=method, least=5, distance=1.0, count=3)  # type: ignore[arg-type]
    label = cluster_solutions(vectors, options, 0)
    assert [len(set(label[a:b])) for a, b in ((0, 30), (30, 50), (50, 62))] == [1, 1, 1]
    assert [int(label[k]) for k in (0, 30, 50)] == [0, 1, 2]


def test_outliers_join_the_nearest_cluster_or_are_dropped() -> None:
    vectors = _blobs()
    for outliers, expected in (("drop", OUTLIER), ("nearest", 1)):
        options = ClusterOptions("dbscan", 5, 1.0, outliers=outliers)  # type: ignore[arg-type]
        label = cluster_solutions(vectors, options, 0)
        assert label[-1] == expected or (outliers == "nearest" and label[-1] in (1, 2))


def test_clusters_are_numbered_by_size_with_the_outliers_that_joined() -> None:
    far = np.array([[30.0, 30.0]])
    lone = np.array([[0.0, 30.0 + 3 * k] for k in range(12)])  # nearest to the third blob
    vectors = np.vstack([_blobs()[:-1], lone, far])
    label = cluster_solutions(vectors, ClusterOptions("dbscan", 5, 1.0), 0)
    assert (np.diff(np.bincount(label)) <= 0).all()
    assert label[50] == 1  # it has become larger than the second


def test_without_clusters() -> None:
    vectors = 10.0 * np.eye(12)
    assert set(cluster_solutions(vectors, ClusterOptions("dbscan", 3, 0.5), 0)) == {0}
    with pytest.raises(UsageError, match="no cluster of 3"):
        cluster_solutions(vectors, ClusterOptions("dbscan", 3, 0.5, outliers="drop"), 0)
