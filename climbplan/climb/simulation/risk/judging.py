"""A plan in many worlds: who falls, with what confidence, and what began it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import interval_of
from climbplan.climb.simulation.comparison import find_losses, find_slips
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.simulation.statics.outcome import (
    CAUSE,
    CAUSE_LIMB,
    CAUSE_STEP,
    FARTHEST,
    FELL,
    FELL_STEP,
)
from climbplan.climb.simulation.statics.playback import Steps, played, prepare
from climbplan.climb.simulation.worlds.stated import KEYS, uncertainty_of
from climbplan.climb.simulation.worlds.uncertainty import (
    Layout,
    Uncertainty,
    conditions_of,
    layout_of,
    numbers_of,
)
from climbplan.simulation.asked import Engine
from climbplan.simulation.conditions import Conditions

_CAUSES = ("", "a toe loses its surface", "a toe slides", "a motor is too weak", "no balance")
_LETS_GO = "a grip lets go"
_CHUNK = {"mujoco": 1, "statics": 25}  # worlds that a worker takes at once


@dataclass(frozen=True)
class Outcome:
    """One world's end."""

    fallen: bool
    time: float  # [s] of the plan, at the fall or its end
    cause: str  # what went wrong first, "" if nothing did or it stands
    limb: int  # -1 of none
    instant: int  # -1 before the first
    farthest: float  # [m] of the body from where it is planned, up to then


@dataclass(frozen=True)
class Judged:
    """Outcomes of worlds 0, 1, ... of a seed."""

    engine: Engine
    seed: int
    layout: Layout
    outcomes: tuple[Outcome, ...]

    @property
    def falls(self) -> int:
        """How many fall."""
        return sum(o.fallen for o in self.outcomes)

    @property
    def stands(self) -> str:
        """In how many worlds the robot stands, in words."""
        count = len(self.outcomes)
        return f"stands in {count - self.falls} of {count} worlds"

    @property
    def worst(self) -> int:
        """Number of the world that falls first, or strays farthest if none falls."""
        fallen = [(o.time, i) for i, o in enumerate(self.outcomes) if o.fallen]
        if fallen:
            return min(fallen)[1]
        return max(range(len(self.outcomes)), key=lambda i: self.outcomes[i].farthest)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the probability of a fall (Clopper and Pearson)."""
        return interval_of(self.falls, len(self.outcomes))

    @property
    def parameters(self) -> list[tuple[str, float]]:
        """Quantities by how far they differ between worlds that fall and that stand.

        In standard errors of the difference of means, of a quantity's worst number (of many joints,
        surfaces, ... some differ by two or three by chance), the largest first.
        """
        fallen = np.array([o.fallen for o in self.outcomes], bool)
        if fallen.all() or not fallen.any():
            return []
        drawn = np.array([numbers_of(self.seed, i, self.layout.size) for i in range(len(fallen))])
        off = drawn[fallen].mean(axis=0) - drawn[~fallen].mean(axis=0)
        off /= np.sqrt(1 / fallen.sum() + 1 / (~fallen).sum())
        keys = {quantity: key for key, quantity, _ in KEYS}
        found = [
            (keys[name], float(off[part][np.argmax(np.abs(off[part]))]))
            for name, part in self.layout.parts
        ]
        return sorted(found, key=lambda item: -abs(item[1]))


def judge_plan(
    plan: ClimbPlan,
    base: Conditions,
    engine: Engine,
    worlds: int,
    seed: int,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
    uncertainty: Uncertainty | None = None,
) -> Judged:
    """Play a plan in worlds 0 to `worlds` - 1 of a seed, whatever the number of workers.

    uncertainty: in place of what the plan's spec and its robot's file state.
    Raises UsageError for robots that the engine does not know, MissingSolver without MuJoCo.
    """
    layout = layout_of(plan, uncertainty_of(plan) if uncertainty is None else uncertainty)
    run = partial(_mujoco, plan, base, layout, seed)
    if engine == "statics":
        run = partial(_statics, plan, prepare(plan, base), base, layout, seed)
    size = _CHUNK[engine]
    chunks = [range(first, min(first + size, worlds)) for first in range(0, worlds, size)]
    found: list[Outcome] = []
    work = Parallel(n_jobs=workers, return_as="generator")(delayed(run)(c) for c in chunks)
    for part in work:
        found += part
        if progress is not None:
            progress(len(found) / worlds)
    return Judged(engine, seed, layout, tuple(found))


def world_conditions(judged: Judged, base: Conditions, number: int) -> Conditions:
    """Conditions of one of the worlds, by its number."""
    return conditions_of(base, judged.layout, numbers_of(judged.seed, number, judged.layout.size))


def judged_dict(judged: Judged, names: Sequence[str], plan: ClimbPlan) -> dict[str, Any]:
    """JSON-ready values."""
    low, high = judged.interval
    count = len(judged.outcomes)
    return {
        "engine": judged.engine,
        "seed": judged.seed,
        "worlds": count,
        "falls": judged.falls,
        "probability": judged.falls / count,
        "lower": low,
        "upper": high,
        "interval": "Clopper-Pearson, 95 %",
        "causes": [
            {"cause": cause, "limb": limb, "round": number, "worlds": many}
            for (cause, limb, number), many in causes(judged, names, plan)
        ],
        "parameters": [{"key": key, "off": off} for key, off in judged.parameters],
        "fallen": [i for i, o in enumerate(judged.outcomes) if o.fallen],
    }


def causes(
    judged: Judged, names: Sequence[str], plan: ClimbPlan
) -> list[tuple[tuple[str, str, int], int]]:
    """What began the falls: cause, limb and round, with how many worlds, most first."""
    rounds = plan.instants.round
    counted = Counter(
        (
            o.cause,
            names[o.limb] if o.limb >= 0 else "",
            int(rounds[o.instant]) if o.instant >= 0 else 0,
        )
        for o in judged.outcomes
        if o.fallen
    )
    return sorted(counted.items(), key=lambda item: (-item[1], item[0]))


def told(judged: Judged, names: Sequence[str], plan: ClimbPlan) -> list[str]:
    """The judgement in lines."""
    low, high = judged.interval
    count = len(judged.outcomes)
    fallen = f"{judged.falls} of {count} worlds fall ({judged.engine})"
    lines = [f"{fallen}: {judged.falls / count:.2%}, 95 % interval {low:.2%} to {high:.2%}"]
    if judged.engine == "statics":
        lines.append("  MuJoCo ends otherwise in some 3 of 100 worlds (--engine mujoco)")
    for (cause, limb, number), many in causes(judged, names, plan)[:5]:
        lines.append(f"  {many}: {cause}{f', {limb}' if limb else ''}, round {number}")
    if judged.parameters:
        shown = ", ".join(f"{key} {off:+.1f}" for key, off in judged.parameters[:3])
        lines.append(f"  falls against stands, in standard errors: {shown}")
    return lines


def _statics(
    plan: ClimbPlan, steps: Steps, base: Conditions, layout: Layout, seed: int, chunk: range
) -> list[Outcome]:
    time = plan.trajectory.time[steps.sample]
    out = []
    for index in chunk:
        world = conditions_of(base, layout, numbers_of(seed, index, layout.size))
        row = played(plan, steps, world)
        fallen = bool(row[FELL])
        out.append(
            Outcome(
                fallen,
                float(time[int(row[FELL_STEP])] if fallen else time[-1]),
                _CAUSES[int(row[CAUSE])] if fallen else "",
                int(row[CAUSE_LIMB]) if fallen else -1,
                int(steps.instant[int(row[CAUSE_STEP])]) if fallen else -1,
                float(row[FARTHEST]),
            )
        )
    return out


def _mujoco(
    plan: ClimbPlan, base: Conditions, layout: Layout, seed: int, chunk: range
) -> list[Outcome]:
    out = []
    for index in chunk:
        run = simulate(plan, conditions_of(base, layout, numbers_of(seed, index, layout.size)))
        end = float(run.time[-1])
        off = run.com - plan.trajectory.com[: run.samples]
        farthest = float(np.linalg.norm(off, axis=1).max())
        if not run.fallen:
            out.append(Outcome(False, end, "", -1, -1, farthest))
            continue
        events = [(s.time, _CAUSES[2], s.limb, s.instant) for s in find_slips(plan, run)]
        events += [(x.time, _CAUSES[1], x.limb, x.instant) for x in find_losses(plan, run)]
        if run.grips is not None:
            events += [(x.time, _LETS_GO, x.limb, x.instant) for x in run.grips.let_go]
        first = min(events, default=(end, _CAUSES[4], -1, plan.instants.count - 1))
        out.append(Outcome(True, end, *first[1:], farthest))
    return out
