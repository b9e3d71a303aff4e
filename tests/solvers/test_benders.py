"""Benders cuts: valid at other integers and other parameters, and the same optima as the tree."""

from __future__ import annotations

import numpy as np
import pytest
from cart_pole import springs
from random_programs import random_program

from climbplan.errors import UsageError
from climbplan.program import Program
from climbplan.program.instance import Instance
from climbplan.solvers.benders.benders_cuts import CutEvaluator, CutPlanes
from climbplan.solvers.benders.method import HOLDS, WarmStartedBenders, solve_benders
from climbplan.solvers.benders.subproblem import Subproblem
from climbplan.solvers.mixed_integer.indicator_form import build_indicator_form
from climbplan.solvers.mixed_integer.leaf_cover import build_horizon_shift
from climbplan.solvers.mixed_integer.method import solve_mixed_integer
from climbplan.solvers.mixed_integer.presolve import build_mixed_integer_program
from climbplan.solvers.mixed_integer.problem_data import MixedIntegerProgram

GAP = 1e-6
_WALLS = np.array([0.35, 0.40])


@pytest.fixture(scope="module", autouse=True)
def compiled() -> None:
    """No limit of time counts what a machine compiles once."""
    instance = springs().instance({"start": np.zeros(4), "walls": _WALLS})
    solve_mixed_integer(instance, GAP)
    solve_benders(instance, GAP)


def _program(instance: Instance) -> tuple[CutEvaluator, MixedIntegerProgram]:
    form = build_indicator_form(instance)
    program = build_mixed_integer_program(instance, form)
    assert isinstance(program, MixedIntegerProgram)
    return CutEvaluator(form, program), program


def _at(planes: CutPlanes, integers: np.ndarray) -> np.ndarray:
    off = np.where((integers > 0) == planes.star, 0.0, planes.slope)
    return np.asarray(planes.bound - off.sum(axis=1))


def _agrees_with_the_tree(seed: int) -> None:
    instance = random_program(seed).instantiate({})
    if instance.features - HOLDS:
        return
    ours, tree = solve_benders(instance, GAP, 30.0), solve_mixed_integer(instance, 10 * GAP, 30.0)
    assert tree.status in ("optimal", "infeasible")
    if tree.objective is None:
        assert ours.status == "infeasible"
        return
    room = 1e-6 * max(1.0, abs(tree.objective))
    assert ours.bound <= tree.objective + room
    assert ours.objective is not None
    assert ours.objective >= tree.bound - room
    assert ours.status == "optimal"


@pytest.mark.parametrize("seed", range(20))
def test_random_programs_have_the_optimum_of_the_tree(seed: int) -> None:
    _agrees_with_the_tree(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 260))
def test_many_random_programs_have_the_optimum_of_the_tree(seed: int) -> None:
    _agrees_with_the_tree(seed)


def test_cuts_hold_at_all_integers_and_at_other_parameters() -> None:
    problem, rng = springs(), np.random.default_rng(0)
    begun = problem.instance({"start": [0.30, 0.05, 0.6, -1.2], "walls": _WALLS})
    read, program = _program(begun)
    sub = Subproblem(program, 1e-6)
    best = solve_mixed_integer(begun, GAP).x
    assert best is not None
    near = np.round(best[program.entities]).astype(np.int64)
    sets = [near]
    for _ in range(16):  # one or two contacts begin or end elsewhere
        flips = rng.choice(len(near), int(rng.integers(1, 3)), replace=False)
        sets.append(np.where(np.isin(np.arange(len(near)), flips), 1 - near, near))
    found = [sub.solve(np.clip(d, program.data.root_low, program.data.root_high)) for d in sets]
    cuts = [cut for _, cut in found if cut is not None]
    assert {cut.feasible for cut in cuts} == {True, False}
    other = problem.instance({"start": [0.28, 0.02, 0.5, -0.9], "walls": _WALLS + 0.01})
    for instance in (begun, other):
        read, program = _program(instance)
        planes, sub = read.evaluate(cuts), Subproblem(program, 1e-6)
        met = 0
        for integers in [*sets, np.zeros(len(program.entities), np.int64)]:
            x, _ = sub.solve(integers)
            below = _at(planes, integers)
            if x is not None and instance.violation(x[: instance.size]) <= 1e-6:
                cost = instance.objective(x[: instance.size])
                assert (below[planes.feasible] <= cost + 1e-6 * abs(cost)).all()
                assert (below[~planes.feasible] <= 1e-6).all()
                met += 1
        assert met
    tight = _program(begun)[0].evaluate(cuts)
    for k, cut in enumerate(cuts):
        if cut.feasible and begun.violation(cut.star[: begun.size]) <= 1e-6:
            # At its own integers a cut says all that there is
            own = cut.star[_program(begun)[1].entities].round().astype(int)
            assert _at(tight, own)[k] == pytest.approx(
                begun.objective(cut.star[: begun.size]), rel=1e-5
            )


def test_memory_tries_fewer_integers_and_finds_the_same() -> None:
    problem, state = springs(), np.array([0.30, 0.05, 0.6, -1.2])
    blocks, memory = problem.program.blocks, WarmStartedBenders(1e-3, 1e-6)
    cold_tried = warm_tried = 0
    for t in range(8):
        instance = problem.instance({"start": state, "walls": _WALLS})
        cold = solve_benders(instance, 1e-3, 30.0, 1e-6)
        warm = memory.solve(
            instance, 30.0, (lambda f: build_horizon_shift(blocks, f, 1)) if t else None
        )
        assert cold.status == warm.status == "optimal"
        assert cold.objective is not None
        assert warm.objective == pytest.approx(cold.objective, rel=2e-3)
        assert warm.bound <= cold.objective * (1 + 1e-9)
        cold_tried, warm_tried = cold_tried + cold.nodes, warm_tried + warm.nodes
        state = problem.values(warm.x)["state"][1]
    assert warm_tried < cold_tried


def test_what_it_does_not_hold_is_refused_and_a_limit_keeps_the_best() -> None:
    p = Program("ball")
    x = p.continuous("x", (2,), -1.0, 1.0)
    p.ball("ball", x, 1.0)
    p.minimise("x", x[0])
    with pytest.raises(UsageError, match="'benders' holds no balls"):
        solve_benders(p.instantiate({}))
    problem = springs()
    instance = problem.instance({"start": [0.30, 0.05, 0.6, -1.4], "walls": _WALLS})
    best = solve_mixed_integer(instance, 1e-6)
    early = WarmStartedBenders(1e-6, 1e-6, work=1).solve(instance)
    assert early.status in ("feasible", "limit")
    assert best.objective is not None
    assert early.bound <= best.objective
