"""`judge`: the quasi-static engine against MuJoCo, in the same worlds of shipped scenes."""

from __future__ import annotations

import time
from collections import Counter
from typing import TextIO

from benchmarks.climb.shipped import planned_scene
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import compute_interval
from climbplan.climb.simulation.risk.estimation import RiskEstimate, estimate_risk
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.request import Engine

SCENES = (
    "climb_nonparallel",
    "climb_patches",
    "climb_steps",
    "climb_stairs",
    "climb_obstacle",
    "climb_tube",
    "climb_ground_to_wall",
    "climb_walker",
    "transition_flat",
    "transition_bricks",
    "transition_bricks_4",
)
WORLDS = 16
_QUICK_SCENES, _QUICK_WORLDS = ("transition_flat",), 3
_STANDS, _FALLS = "stand", "fall"
Pair = tuple[str, str]  # how a world ends by MuJoCo and by the quasi-static engine


def bench_judge(seed: int, quick: bool, out: TextIO, count: int | None = None) -> None:
    """Worlds 0, 1, ... of a seed: 16 a scene, 3 of one scene with `quick`.

    Times are CPU seconds of one core, without compiling. Raises MissingSolver without MuJoCo.
    """
    head = f"{'scene':<22}{'worlds':>7}{'both stand':>12}{'both fall':>11}{'only statics':>14}"
    head += f"{'only MuJoCo':>13}{'worlds/min':>12}{'times MuJoCo':>14}  differ"
    print(head, file=out, flush=True)
    worlds = count or (_QUICK_WORLDS if quick else WORLDS)
    total: Counter[Pair] = Counter()
    spent = {"mujoco": 0.0, "statics": 0.0}
    for name in _QUICK_SCENES if quick else SCENES:
        plan = planned_scene(name, []).plan
        estimate_risk(plan, Conditions(), "statics", 1, seed)  # compiles
        by, took = {}, {}
        for engine in ("mujoco", "statics"):
            by[engine], took[engine] = _timed(plan, engine, worlds, seed)
            spent[engine] += took[engine]
        pairs = [
            (_end(a.fallen), _end(b.fallen))
            for a, b in zip(by["mujoco"].outcomes, by["statics"].outcomes, strict=True)
        ]
        total += Counter(pairs)
        differ = [f"{i} ({b}s)" for i, (a, b) in enumerate(pairs) if a != b]
        told = f"  {', '.join(differ)}" if differ else ""
        print(_line(name, Counter(pairs), took, worlds) + told, file=out, flush=True)
    number = sum(total.values())
    print(_line("all", total, spent, number), file=out)
    same = total[_STANDS, _STANDS] + total[_FALLS, _FALLS]
    low, high = compute_interval(same, number)
    print(
        f"same end in {same} of {number} worlds: {same / number:.1%} ({low:.1%} to {high:.1%})",
        file=out,
    )


def _timed(plan: ClimbPlan, engine: Engine, worlds: int, seed: int) -> tuple[RiskEstimate, float]:
    start = time.process_time()
    found = estimate_risk(plan, Conditions(), engine, worlds, seed)
    return found, time.process_time() - start


def _end(fallen: bool) -> str:
    return _FALLS if fallen else _STANDS


def _line(name: str, pairs: Counter[Pair], took: dict[str, float], worlds: int) -> str:
    line = f"{name:<22}{worlds:>7}{pairs[_STANDS, _STANDS]:>12}{pairs[_FALLS, _FALLS]:>11}"
    line += f"{pairs[_STANDS, _FALLS]:>14}{pairs[_FALLS, _STANDS]:>13}"
    rate = 60 * worlds / took["statics"]
    return line + f"{rate:>12.0f}{took['mujoco'] / took['statics']:>14.0f}"
