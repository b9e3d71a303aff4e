"""What counts as a slip: a toe that slides while it is to press, not one that is let go of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.comparison import MIN_STANCE_PRESSURE, find_slips
from climbplan.climb.simulation.control.planned_pressure import compute_planned_pressure
from climbplan.climb.simulation.instant_samples import find_instant_samples
from climbplan.climb.simulation.replay import RecordedRun, simulate
from climbplan.simulation.conditions import NOMINAL

Planned = Callable[..., ClimbPlan]
LIMB = 1  # the second to move


@pytest.fixture(name="run", scope="module")
def _run(planned: Planned) -> RecordedRun:
    return simulate(planned(), NOMINAL)


def slid_from(run: RecordedRun, first: int, last: int) -> RecordedRun:
    """20 mm up from one sample to another."""
    toes = run.toes.copy()
    toes[first:last, LIMB, 2] += 0.02
    return replace(run, toes=toes)


def test_planned_pressure_is_that_of_the_instants(planned: Planned) -> None:
    plan = planned()
    at = find_instant_samples(plan)
    expected = np.einsum("kni,kni->kn", plan.forces.force, plan.instants.normal)
    np.testing.assert_allclose(compute_planned_pressure(plan)[at], expected, atol=1e-6)


def test_a_toe_may_slide_once_it_is_let_go_of(planned: Planned, run: RecordedRun) -> None:
    plan = planned()
    lift = int(np.flatnonzero(~plan.trajectory.contact[:, LIMB])[0])
    pressed = compute_planned_pressure(plan)[:lift, LIMB]
    released = int(np.flatnonzero(pressed >= MIN_STANCE_PRESSURE)[-1]) + 1
    assert 0 < lift - released < 20  # samples, a second
    assert find_slips(plan, run) == ()
    assert find_slips(plan, slid_from(run, released, lift)) == ()
    (slip,) = find_slips(plan, slid_from(run, released - 2, lift))
    assert (slip.limb, slip.time) == (LIMB, run.time[released - 2])
    assert slip.distance == pytest.approx(0.02, abs=2e-3)


def test_a_toe_that_ends_the_plan_is_never_let_go_of(planned: Planned, run: RecordedRun) -> None:
    plan = planned()
    (slip,) = find_slips(plan, slid_from(run, run.samples - 3, run.samples))
    assert slip.limb == LIMB
