"""What commands inside surfaces buy when a transition is simulated, and what joints' play is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.simulation.comparison import compare
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.transition.planner import plan_transition
from climbplan.simulation.conditions import Conditions

Planned = Callable[..., ClimbPlan]
BRICKS = Path(__file__).parents[2] / "specs" / "transition_bricks.yaml"
AS_PUBLISHED = "task.sequence=LF LR RM | RF RR LM | LF LR RM"


def test_over_the_bricks_toes_hold_that_are_commanded_inside() -> None:
    pytest.importorskip("mujoco")
    plan = plan_transition(load_transition(BRICKS, [AS_PUBLISHED]))
    depth = np.einsum("kni,kni->kn", plan.forces.wall_deflection, plan.instants.normal)
    assert (depth[plan.instants.contact] > 0).all()
    found = compare(plan, simulate(plan, Conditions(speed=2.0, regulator="nothing")))
    assert not found.slips
    assert not found.lost_contacts
    assert np.median(found.torque_error) < 0.02


def test_without_margins_commands_lie_outside() -> None:
    """Friction alone holds such toes: in MuJoCo they stand, but by its contacts' softness."""
    plan = plan_transition(load_transition(BRICKS, [AS_PUBLISHED, "margins=none"]))
    depth = np.einsum("kni,kni->kn", plan.forces.wall_deflection, plan.instants.normal)
    assert (depth[plan.instants.contact] < 0).any()


def test_joints_with_hardly_any_play_are_as_stiff_as_without(planned: Planned) -> None:
    """The stops of the play give way by next to nothing."""
    plan = planned()
    ends = []
    for backlash in (0.0, 1e-6):
        run = simulate(plan, Conditions(speed=2.0, backlash=backlash))
        assert not run.fallen
        ends.append(run.com - plan.trajectory.com)
    assert np.abs(ends[1] - ends[0]).max() < 1e-3  # [m]


def test_play_lets_the_body_sink_in_proportion(planned: Planned) -> None:
    """From one play to the next: with any, contacts give by some tenths of a millimetre more.

    MuJoCo's contacts are as stiff as what meets in them is heavy, and links within play are light.
    """
    plan = planned()
    height = [
        simulate(plan, Conditions(backlash=np.deg2rad(play))).com[0, 2] for play in (0.1, 0.2, 0.3)
    ]
    sunk = -np.diff(height)
    assert sunk[0] > 1e-4
    assert sunk[1] == pytest.approx(sunk[0], rel=0.35)
