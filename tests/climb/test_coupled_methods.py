"""The other coupled methods: accurate MICP, SCIP, modes, against each other and the exact check."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.climb.coupled_micp import certify, known_point, prepared_walls
from climbplan.climb.coupled.accurate import build_accurate_program
from climbplan.climb.coupled.envelopes import NamedEnvelope, braced_envelope
from climbplan.climb.coupled.modes import solve_first_stage_with_modes
from climbplan.climb.coupled.planner import plan_coupled
from climbplan.climb.coupled.preparation import CoupledProblem, prepare_problem
from climbplan.climb.coupled.stages import repair_candidate
from climbplan.climb.coupled.tightening import tighten_bounds
from climbplan.climb.postures.statement import PostureMargins
from climbplan.climb.scene.climb_scene import ClimbScene, build_scene
from climbplan.climb.schema.loading import load_climb
from climbplan.learning.envelope_box import Envelope
from climbplan.program.row_propagation import ElementwiseRange
from climbplan.solvers.registry import solve


@pytest.fixture(scope="module")
def walls() -> CoupledProblem:
    """One round between flat walls with a payload; forces cost."""
    return prepared_walls(1, 0)


def test_accurate_program_bounds_the_exact_problem(walls: CoupledProblem) -> None:
    """Its bound is below every point of P, and within a percent of the best one known."""
    done = certify(walls, None, "highs")
    assert done is not None
    assert done.gap is not None
    assert done.gap <= 0.01
    assert done.found.best is not None
    assert walls.instance.violation(done.found.best.x, done.found.best.assignment) <= 1e-6
    assert walls.bound <= done.found.bound <= done.cost
    known = known_point(walls)
    assert known is not None
    assert done.found.bound <= walls.instance.objective(known.x)


def test_with_an_envelope_there_is_no_bound(walls: CoupledProblem) -> None:
    done = certify(walls, braced_envelope(walls.scene), "highs", limit=10.0)
    assert done is not None
    assert done.gap is None
    assert walls.bound <= done.cost


def test_more_pieces_bound_better(walls: CoupledProblem) -> None:
    instance = walls.instance
    known = known_point(walls)
    assert known is not None
    cost = instance.objective(known.x)
    tight = tighten_bounds(
        instance, ElementwiseRange(instance.lower, instance.upper), cost, 60.0, passes=1
    )
    bounds = [
        solve(build_accurate_program(walls, tight.bounds, pieces), "highs", gap=1e-3).bound
        for pieces in (1, 4)
    ]
    assert bounds[0] < bounds[1] <= cost * (1 + 1e-6)


def test_tightening_keeps_points_that_are_as_good(walls: CoupledProblem) -> None:
    """A point with less cost than the one known stays inside all bounds."""
    instance = walls.instance
    known = known_point(walls)
    assert known is not None
    cost = instance.objective(known.x)
    within = ElementwiseRange(instance.lower, instance.upper)
    tight = tighten_bounds(instance, within, 1.05 * cost, 60.0, passes=2)
    assert not tight.infeasible
    assert (tight.bounds.lower <= known.x + 1e-6).all()
    assert (tight.bounds.upper >= known.x - 1e-6).all()
    before = np.minimum(instance.upper, 10.0) - np.maximum(instance.lower, -10.0)
    after = tight.bounds.upper - tight.bounds.lower
    force = walls.program.variables["force"]
    assert after[force.start : force.stop].mean() < 0.7 * before[force.start : force.stop].mean()
    below = tighten_bounds(instance, within, 0.5 * cost, 60.0)
    assert below.infeasible


def _scene(name: str, *overrides: str) -> ClimbScene:
    loaded = load_climb(f"specs/{name}.yaml", overrides)
    return build_scene(loaded.spec, loaded.robot, loaded.source)


@pytest.mark.parametrize("method", ["coupled-mccormick", "coupled-minlp-scip"])
def test_methods_with_bounds_close_small_climbs(method: str) -> None:
    given = ["task.rounds=2", "task.goal.com=[0, 0, 0.15]", "solver.time_limit=60"]
    found = plan_coupled(_scene("climb_patches", f"solver.method={method}", *given))
    assert found.status == "optimal"
    assert found.bound is not None
    assert found.bound <= found.objective
    assert "every limb carrying" in found.sizes["bound_holds_for"]
    patches = [k for k in found.rounds.region.ravel() if k in (1, 4)]
    assert not patches


def test_modes_say_which_envelope_holds() -> None:
    """Of two boxes, one pulls at the walls, which has no solution: the other is the mode."""
    prepared = prepare_problem(_scene("climb_patches", "task.rounds=3"), PostureMargins())
    box, robot = braced_envelope(prepared.scene), prepared.scene.robot
    right = robot.shoulder_body[:, 0] > 0
    low, high = box.lower.copy(), box.upper.copy()
    low[right, 3], high[~right, 3] = 0.01, -0.01
    pushing = NamedEnvelope("pushing", "test", box)
    pulling = NamedEnvelope("pulling", "test", Envelope(low, high))
    found = solve_first_stage_with_modes(prepared, (pulling, pushing), 30.0)
    assert found is not None
    assert found.modes == ("pushing",) * 3
    exact = repair_candidate(prepared, found.candidate, 20.0)
    assert exact is not None
    assert prepared.instance.violation(exact.x, exact.assignment) <= 1e-6
    assert solve_first_stage_with_modes(prepared, (pulling,), 30.0) is None


def test_ground_and_wall_modes_switch_by_themselves() -> None:
    """Rounds with all toes on the ground are of the ground's envelope, the others of the walls'."""
    found = plan_coupled(_scene("climb_ground_to_wall"))
    ground = (found.rounds.region[1:] == 0).all(axis=1)
    wall = (found.rounds.region[1:] > 0).all(axis=1)
    assert ground.any()
    assert wall.any()
    assert (ground | wall).all()
    assert found.sizes["modes"] == ["ground3" if on else "wall5" for on in ground]
