"""`stands`: shipped and random climbs in MuJoCo, with margins and without, and their price.

Each spec is planned twice, with `margins=none` and as it is. The first is simulated as it would be
without anything that is robust, commands played blindly, the second as `climbplan simulate` does by
default, with the regulator from joint angles; both in the nominal world.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import yaml

from benchmarks.climb.shipped import SCENES, planned_scene, planned_spec
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.comparison import find_losses, find_slips
from climbplan.climb.simulation.replay import simulate
from climbplan.errors import NoPlanFound
from climbplan.simulation.conditions import Conditions

_QUICK = ("climb_nonparallel", "climb_patches", "transition_flat")
_NONE = "margins=none"
# Random climbs of `stands`
GAP = (1.05, 1.35)  # [m]
ANGLE = (0.0, 25.0)  # [deg] between the walls
FRICTION = (0.6, 1.4)
PAYLOAD = (0.0, 3.0)  # [kg]
_LIMIT = 20.0  # [s] of a random climb


def bench_stands(seed: int, quick: bool, out: TextIO, count: int | None = None) -> None:
    """Shipped scenes, then random climbs seed, seed + 1, ...: 40 of them, 2 with `quick`.

    Raises MissingSolver without MuJoCo.
    """
    _shipped(_QUICK if quick else SCENES, out)
    print(file=out)
    _random(range(seed, seed + (count or (2 if quick else 40))), out)


def _shipped(names: tuple[str, ...], out: TextIO) -> None:
    print(
        f"{'scene':<23}{'none, blind':>18}{'margins':>18}"
        f"{'S_tau none':>11}{'margins':>9}{'CPU s none':>11}{'margins':>9}",
        file=out,
    )
    for name in names:
        bare, kept = (planned_scene(name, own) for own in ([_NONE], []))
        ends = [
            fares(bare.plan, "nothing"),
            fares(kept.plan, "joints") + (", fragile" if kept.fragile else ""),
        ]
        line = f"{name:<23}" + "".join(f"{end:>18}" for end in ends)
        line += f"{bare.safety_torque:>11.2f}{kept.safety_torque:>9.2f}"
        print(f"{line}{bare.cpu:>11.2f}{kept.cpu:>9.2f}", file=out, flush=True)


def _random(numbers: range, out: TextIO) -> None:
    print(f"{'climb':<6}{'walls':>30}{'outcome':>30}{'margins':>10}{'S_tau':>7}", file=out)
    firm = stood = planned = 0
    for number in numbers:
        spec = random_spec(number)
        walls = spec["terrain"]["walls"]
        friction, mass = spec["terrain"]["friction"], spec["task"]["payload"]["mass"]
        words = f"{walls['gap']} m, {walls['angle_deg']} deg, {friction}, {mass} kg"
        try:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder, f"climb_{number}.yaml")
                path.write_text(yaml.safe_dump(spec))
                found = planned_spec(path, [])
        except NoPlanFound:
            print(f"{number:<6}{words:>30}{'no plan':>30}", file=out, flush=True)
            continue
        end = fares(found.plan, "joints")
        planned += 1
        firm += not found.fragile
        stood += not found.fragile and end == "stands"
        mark = "fragile" if found.fragile else "whole"
        line = f"{number:<6}{words:>30}{end:>30}{mark:>10}{found.safety_torque:>7.2f}"
        print(line, file=out, flush=True)
    print(
        f"{len(numbers)} climbs, {planned} planned, {firm} of them not fragile, of which {stood} "
        "stand without a slip",
        file=out,
    )


def random_spec(number: int) -> dict[str, Any]:
    """Climb `number`: straight up between two walls that open towards +y, with a payload."""
    rng = np.random.default_rng([number, 18])
    rounds = int(rng.integers(2, 5))
    rise = round(float(rng.uniform(0.06, 0.1)) * rounds, 3)
    return {
        "kind": "climb",
        "robot": "silvia",
        "terrain": {
            "friction": round(float(rng.uniform(*FRICTION)), 2),
            "walls": {
                "gap": round(float(rng.uniform(*GAP)), 3),
                "angle_deg": round(float(rng.uniform(*ANGLE)), 1),
                "along": [-0.9, 0.9],
                "up": [-0.9, rise + 0.9],
            },
        },
        "task": {
            "rounds": rounds,
            "start": {"com": [0, 0, 0]},
            "goal": {"com": [0, 0, rise]},
            "payload": {"mass": round(float(rng.uniform(*PAYLOAD)), 2)},
        },
        "solver": {"time_limit": _LIMIT},
    }


def fares(plan: ClimbPlan, regulator: Any) -> str:
    """How a plan ends in the nominal world: "stands", "falls at 3.1 s", "2 slips, 1 lost"."""
    run = simulate(plan, Conditions(regulator=regulator))
    if run.fallen:
        return f"falls at {run.time[-1]:.1f} s"
    slips, lost = len(find_slips(plan, run)), len(find_losses(plan, run))
    return f"{slips} slips, {lost} lost" if slips or lost else "stands"
