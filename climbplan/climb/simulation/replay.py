"""Simulate a plan in MuJoCo: as it stands with a regulator, or executed in closed loop.

The robot starts at its planned posture with toes on the terrain and settles at its first commands.
It then follows the trajectory's commands, which unload, lift, swing, lower, press and push.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.closed_loop import ClosedLoopRun
from climbplan.climb.simulation.model.mjcf import build_mjcf
from climbplan.climb.simulation.mujoco_run import MujocoRun, RecordedRun
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.mujoco_loading import load_mujoco


def simulate(
    plan: ClimbPlan,
    conditions: Conditions,
    progress: Callable[[float], None] | None = None,
    watch: Callable[[int, Any, Any], None] | None = None,
    rests: bool = False,
) -> RecordedRun:
    """Simulate a plan under conditions.

    Args:
        plan: The plan.
        conditions: Conditions of the simulation.
        progress: Called with the fraction that is done.
        watch: Called with sample, model and data at every sample, for pictures.
        rests: Whether to find where the body comes to rest at each instant, in a copy of the
            simulation with constant commands.

    Raises:
        MissingSolver: MuJoCo is not installed.
        UsageError: The robot cannot be executed in closed loop.
    """
    mujoco = load_mujoco()
    model = mujoco.MjModel.from_xml_string(build_mjcf(plan, conditions))
    data = mujoco.MjData(model)
    run = ClosedLoopRun if conditions.closed_loop else MujocoRun
    return run(mujoco, model, data, plan, conditions).play(progress, watch, rests)
