"""Shipped climbs that are timed by the dynamics of their links, beside quasi-static ones."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from climbplan.climb.check.verification import verify_plan
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.schema.transition_loading import load_transition
from climbplan.climb.simulation.comparison import find_slips
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.transition.planner import plan_transition
from climbplan.errors import UsageError
from climbplan.simulation.conditions import NOMINAL

_SPECS = Path(__file__).parents[2] / "specs"
ALL = "all"
# Shipped climbs, transitions and missions on toes or flat feet that are planned within a minute
SCENES = (
    "climb_biped", "climb_biped_stairs", "climb_ground_to_wall", "climb_nonparallel",
    "climb_obstacle", "climb_patches", "climb_region", "climb_rough_chimney", "climb_stairs",
    "climb_steps", "climb_telescope", "climb_tube", "climb_tube_mesh", "climb_walker",
    "mission_ground_to_top", "transition_bricks", "transition_bricks_4", "transition_flat",
)  # fmt: skip
_QUICK_SCENES = ("transition_flat",)


@dataclass(frozen=True)
class TimedPlan:
    """A plan at a pace, and how it ends in MuJoCo."""

    duration: float  # [s]
    cpu: float  # [s] of planning and verification
    is_verified: bool
    torque_use: float  # largest torque of contacts, weight and inertia by its limit
    imbalance: float  # residual of `trajectory.dynamics`; 0 of quasi-static plans
    stands: bool
    slips: int
    deviation: float  # [m] largest of the body from its path


def bench_paces(names: str, quick: bool, out: TextIO) -> list[dict[str, Any]]:
    """Print a line a scene, planned quasi-static and as fast as its dynamics allow.

    Args:
        names: Scenes by commas, or `all`.
        quick: Whether one scene stands for all.
        out: Stream of the table.

    Raises:
        UsageError: There is no such scene.
    """
    every = _QUICK_SCENES if quick else SCENES
    scenes = every if names == ALL else tuple(names.split(","))
    unknown = [name for name in scenes if name not in SCENES]
    if unknown:
        raise UsageError(f"--scenes: no scene {unknown[0]!r}, known are {', '.join(SCENES)}")
    print("shipped climbs, quasi-static and as fast as their dynamics allow", file=out)
    heads = ("static [s]", "paced [s]", "ratio", "CPU ratio", "verified", "stands", "slips",
             "off path [mm]", "torque use", "imbalance")  # fmt: skip
    print(f"{'scene':<24}" + "".join(f"{head:>15}" for head in heads), file=out)
    rows = []
    for name in scenes:
        static, paced = _plan_scene(name, None), _plan_scene(name, "fastest")
        cells = (
            f"{static.duration:.1f}",
            f"{paced.duration:.1f}",
            f"{static.duration / paced.duration:.1f}",
            f"{paced.cpu / static.cpu:.1f}",
            "yes" if paced.is_verified else "no",
            "yes" if paced.stands else "no",
            paced.slips,
            f"{1e3 * paced.deviation:.1f}",
            f"{paced.torque_use:.2f}",
            f"{paced.imbalance:.1e}",
        )
        print(f"{name:<24}" + "".join(f"{cell!s:>15}" for cell in cells), file=out)
        rows.append({"scene": name, "static": asdict(static), "paced": asdict(paced)})
    print(file=out)
    return rows


def _plan_scene(name: str, pace: str | None) -> TimedPlan:
    """Return a scene planned at a pace, simulated in its nominal world."""
    changes = [] if pace is None else [f"trajectory.pace={pace}"]
    begin = time.process_time()
    if name.startswith("climb"):
        plan = plan_climb(load_climb(_SPECS / f"{name}.yaml", [*changes, "study=null"]))
    else:
        plan = plan_transition(load_transition(_SPECS / f"{name}.yaml", changes))
    checks = verify_plan(plan)
    cpu = time.process_time() - begin
    imbalance = {check.name: check.residual for check in checks.checks}.get("trajectory.dynamics")
    run = simulate(plan, NOMINAL)
    path = plan.trajectory.com[: run.samples]
    return TimedPlan(
        duration=float(plan.trajectory.time[-1]),
        cpu=cpu,
        is_verified=not checks.objection,
        torque_use=_measure_torque_use(plan),
        imbalance=imbalance or 0.0,
        stands=not run.fallen,
        slips=len(find_slips(plan, run)),
        deviation=float(np.linalg.norm(run.com - path, axis=1).max()),
    )


def _measure_torque_use(plan: ClimbPlan) -> float:
    """Return the largest torque by its limit: on the way, or at instants of quasi-static plans."""
    torque = plan.trajectory.torque
    torque = plan.forces.motor_torques if torque is None else torque
    return float((np.abs(torque) / plan.robot.max_torque).max())
