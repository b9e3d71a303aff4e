"""A robot is set up with its toes on surfaces as they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.initial_posture import place_robot
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.simulation.worlds.nominal_world import build_nominal_world
from climbplan.climb.simulation.worlds.perturbed_terrain import perturb_terrain
from climbplan.robots.kinematics import toe_world
from climbplan.simulation.conditions import Conditions

Planned = Callable[..., ClimbPlan]


def test_toes_are_put_on_displaced_surfaces(planned: Planned) -> None:
    plan = planned()
    world = replace(build_nominal_world(plan), surface=np.array([0.004, -0.003]))
    terrain = perturb_terrain(plan.terrain, world)
    start = place_robot(plan, terrain)
    on = [
        terrain.surfaces[r].distance(t)
        for r, t in zip(plan.rounds.region[0], start.toes, strict=True)
    ]
    assert max(on) < 1e-9
    com, rpy = plan.rounds.com[:1], plan.rounds.rpy[:1]
    assert toe_world(plan.robot, com, rpy, start.angles[None])[0] == pytest.approx(start.toes)
    assert place_robot(plan, plan.terrain).toes == pytest.approx(plan.rounds.toes[0], abs=1e-9)


def test_surfaces_that_lie_before_their_place_do_not_throw_toes_out(planned: Planned) -> None:
    plan = planned()
    world = replace(build_nominal_world(plan), surface=np.full(2, 0.004))
    run = simulate(plan, Conditions(speed=4.0, world=world))
    assert (
        np.abs(run.toes[0] - place_robot(plan, perturb_terrain(plan.terrain, world)).toes).max()
        < 2e-3
    )
