"""A plan of modules played in the simulation: the figures that tables show beside it."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.simulation.study import describe_end, simulate_module_plan
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.request import SimulationRequest


@dataclass(frozen=True)
class Replay:
    """How a plan ended in the simulation."""

    outcome: str  # "delivered", "delivered with 2 contacts that did not hold", "box lost at 4.2 s"
    holds: bool  # whether the box arrived, and all contacts held
    off: float  # [m] of the worst box from its way, the most
    off_at_end: float  # [m]
    misses: float  # [m] of latches where they close, the most
    force: float  # [N] the most of any latch
    force_planned: float
    torque: float  # [N m] the most of any joint
    torque_planned: float
    processor_seconds: float
    seconds: float


def replay_of(plan: LimmsPlan) -> Replay:
    """Play it once as it is, without pictures.

    Raises:
        MissingSolver: MuJoCo is not installed.
    """
    clock, wall = time.process_time(), time.perf_counter()
    found = simulate_module_plan(plan, SimulationRequest(Conditions(), pictures=False))
    run, compared, end = found.run, found.compared, describe_end(found)
    worst = max(compared.contacts, key=lambda borne: borne.force, default=None)
    return Replay(
        outcome=end.words,
        holds=not end.failure(None),
        off=float(compared.box_error.max()),
        off_at_end=float(compared.box_error[-1]),
        misses=float(run.misses.max(initial=0.0)),
        force=0.0 if worst is None else worst.force,
        force_planned=0.0 if worst is None else worst.force_planned,
        torque=float(np.abs(run.torque).max()),
        torque_planned=float(np.abs(run.planned_torque).max()),
        processor_seconds=time.process_time() - clock,
        seconds=time.perf_counter() - wall,
    )
