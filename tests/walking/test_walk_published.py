"""The published form: its planes contain the true motion, and its answers are judged as all are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from walk_tasks import named, shorter, walk_task

from climbplan.program.linear_rows import LinearRows
from climbplan.walking.check.checker import LIMITS
from climbplan.walking.offline.fixed_contact_qp import FixedContactProgram, WalkIterate
from climbplan.walking.offline.sqp import guess_iterate, roll_out
from climbplan.walking.online.candidate_selection import SAFE_STANCE
from climbplan.walking.online.controller import OnlineController, OnlineSettings
from climbplan.walking.online.gait_solver import GaitSolver, IterationBudget
from climbplan.walking.online.library import build_library
from climbplan.walking.online.tick_input import TickInput
from climbplan.walking.published.program import ParametricRows, PublishedProgram
from climbplan.walking.task.task import Integrator, Start

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("integrator", ["euler", "mean"])
@pytest.mark.parametrize("beside", [0.0, 0.7])
def test_planes_contain_a_true_motion(integrator: Integrator, beside: float) -> None:
    """Lines, planes and regions hold at the exact values of any motion; so do feet and friction."""
    task = shorter(walk_task(integrator=integrator, workspace_over_stance=True), 5)
    program = FixedContactProgram(task, named("walking trot", task))
    at = guess_iterate(task, program.gait)
    for _ in range(3):
        found = program.solve_qp(at, elastic=True)
        assert found is not None
        at = found
    force = at.force + np.where(at.force != 0, RNG.normal(0, 0.5, at.force.shape), 0)
    walk = roll_out(program, WalkIterate(at.state, force, at.spots))
    assert 0.01 < np.abs(walk.state[:, 6:9]).max() < 1.0
    published = PublishedProgram(program, beside)
    values = published.layout.evaluate_motion(walk.state, force, walk.toes, at.spots)
    low, high = published.layout.compute_cells(values, beside)
    x, y = published.layout.list_products()[1:]
    assert (low[x] <= values[x]).all()
    assert (values[y] <= high[y]).all()
    published.write_rows(low, high)
    rows = published.rows
    found = rows.matrix @ values
    off = np.maximum(rows.low - found, found - rows.high)
    worst = {block.name: block.residual for block in rows.compute_residuals(values)}
    assert set(worst) - {"envelopes.angles", "envelopes.products", "envelopes.cells"} <= set(LIMITS)
    assert max(worst["envelopes.angles"], worst["envelopes.products"]) < 1e-9
    assert max(worst["workspace.toe"], worst["dynamics.position"]) < 1e-9
    blocks = [*published.lines, *published.planes, *published.arms]
    blocks += [block for parts in published.reaches for _, block in parts]
    assert max(float(off[block.rows].max()) for block in blocks) < 1e-9


def test_rows_add_up_coefficients_of_one_unknown() -> None:
    rows = LinearRows()
    rows.columns((3,), -np.inf, np.inf)
    first = rows.block(
        "sums", ((np.array([0, 1]), 2.0), (np.array([0, 2]), np.array([1.0, 4.0]))), 5.0
    )
    frozen = ParametricRows(rows)
    np.testing.assert_allclose(frozen.matrix.toarray(), [[3, 0, 0], [0, 2, 4]])
    frozen.value[first.values] = [1, 1, 1, -1]  # row by row
    frozen.refresh()
    np.testing.assert_allclose(frozen.matrix.toarray(), [[2, 0, 0], [0, 1, -1]])
    np.testing.assert_allclose(frozen.high, [5, 5])


def test_answers_are_judged_on_the_true_dynamics() -> None:
    task = walk_task(integrator="mean", min_contacts=2, workspace_over_stance=True)
    library = build_library(task, 2, 0, gaits=0)
    settings = OnlineSettings(form="published", neighbour_region_fraction=1.0, max_candidates=3)
    controller = OnlineController(task, library, settings)
    situation = TickInput(
        library.state[0, 0], library.toes[0, 0], library.toes[0, 0], np.ones(4, bool)
    )
    command = controller.tick(situation)
    assert command.source == SAFE_STANCE or command.source >= 0
    assert command.is_feasible != bool(command.warning)
    # The regions allow more than the dynamics do: what the pinned form finds holds.
    own = replace(controller.task, start=Start(situation.state, situation.toes))
    trials, gait = GaitSolver(own, 0.0, 1.0), named("stand", own)
    program, at = trials.prepare_program(own, gait), guess_iterate(own, gait)
    loose = trials.solve_published(own, program, at, IterationBudget(1000))
    begun = trials.initialise_progress(own, program, at)
    sound = trials.solve(own, program, begun, 4, IterationBudget(1000), allow_elastic=True)
    assert not begun.left_workspace
    assert sound is not None
    assert sound.is_feasible
    assert loose is not None
    assert loose.violation > sound.violation
