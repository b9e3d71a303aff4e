"""Motions of a dataset in MuJoCo: how far feet slide and how deep they press into the terrain."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from climbplan.api.kinds import identify_kind
from climbplan.climb.exports.tracked_motion import build_terrain_mesh
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.file import read_climb
from climbplan.climb.simulation.comparison import list_slides
from climbplan.climb.simulation.mujoco_run import RecordedRun
from climbplan.climb.simulation.replay import simulate
from climbplan.motions.terrain_distance import measure_distances
from climbplan.simulation.conditions import NOMINAL

_PERCENTILES = (50, 95, 100)


@dataclass(frozen=True)
class SimulatedMotion:
    """Feet of one motion in MuJoCo."""

    stands: bool
    slip: float  # [m] largest slide of a foot in one stance, without its rolling
    penetration: float  # [m] largest depth of a foot below the terrain


def bench_simulated(plans: list[Path], out: TextIO) -> dict[str, Any]:
    """Simulate plan files, and print and return slip and penetration; walks are left out."""
    climbs = [path for path in plans if identify_kind(path).family == "climb"]
    motions = [_simulate(path) for path in climbs]
    if not motions:
        return {"motions": 0}
    print(f"{len(motions)} of them in MuJoCo, {sum(m.stands for m in motions)} stand", file=out)
    print(f"{'':<26}{'median':>12}{'95 %':>12}{'worst':>12}  unit", file=out)
    results: dict[str, Any] = {
        "motions": len(motions),
        "stand": sum(motion.stands for motion in motions),
    }
    for name in ("slip", "penetration"):
        quantiles = np.percentile([getattr(motion, name) for motion in motions], _PERCENTILES)
        results[name] = quantiles.tolist()
        print(f"{name:<26}" + "".join(f"{value:>12.3g}" for value in quantiles) + "  m", file=out)
    print(file=out)
    return results


def _simulate(path: Path) -> SimulatedMotion:
    plan = read_climb(path)
    run = simulate(plan, NOMINAL)
    slip = max((float(slide.distance.max()) for slide in list_slides(plan, run)), default=0.0)
    return SimulatedMotion(not run.fallen, slip, measure_penetration(plan, run))


def measure_penetration(plan: ClimbPlan, run: RecordedRun) -> float:
    """Return the largest depth of toes, or of corners of soles, below the terrain [m]."""
    points = run.toes[:, :, None]
    if plan.robot.sole is not None:
        # At the first sample soles stand flat: their corners turn with the links from there
        corners = plan.robot.sole.arms(plan.instants.normal[0])
        turned = run.links @ np.swapaxes(run.links[0], -1, -2)
        points = points + corners @ np.swapaxes(turned, -1, -2)
    distance = measure_distances(points.reshape(-1, 3), build_terrain_mesh(plan.terrain))
    return max(plan.robot.standoff - float(distance.min()), 0.0)
