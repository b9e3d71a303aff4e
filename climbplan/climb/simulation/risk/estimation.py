"""Estimate the probability of a fall by Monte Carlo simulation, and count the causes of falls."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import compute_interval
from climbplan.climb.simulation.comparison import find_losses, find_slips
from climbplan.climb.simulation.implicit_dynamics.engine import (
    PreparedMotion,
    prepare_steps,
    simulate_steps,
)
from climbplan.climb.simulation.implicit_dynamics.outcome import (
    CAUSE,
    CAUSE_LIMB,
    CAUSE_STEP,
    FALL_STEP,
    HAS_FALLEN,
    MAX_DEVIATION,
)
from climbplan.climb.simulation.replay import simulate
from climbplan.climb.simulation.worlds.perturbed_terrain import perturb_terrain
from climbplan.climb.simulation.worlds.uncertainty import (
    ScenarioLayout,
    Uncertainty,
    build_layout,
    draw_numbers,
    sample_conditions,
)
from climbplan.climb.simulation.worlds.uncertainty_spec import KEYS, read_uncertainty
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.request import Engine

_CAUSES = ("", "a toe loses its surface", "a toe slides", "a motor is too weak", "no balance")
_GRIP_LOST = "a grip lets go"
_CHUNK_SIZE = {"mujoco": 1, "statics": 25}  # worlds in a batch of a worker


@dataclass(frozen=True)
class ScenarioOutcome:
    """The outcome of a plan in one world."""

    fallen: bool
    time: float  # [s] of the plan, at the fall or its end
    cause: str  # what failed first, "" if nothing did or the robot did not fall
    limb: int  # -1 of none
    instant: int  # -1 before the first
    farthest: float  # [m] of the body from where it is planned, up to then
    stopped: str = ""  # why a robot in closed loop stopped before its goal, if it did


@dataclass(frozen=True)
class RiskEstimate:
    """Outcomes in worlds 0, 1, ... of a seed."""

    engine: Engine
    seed: int
    layout: ScenarioLayout
    outcomes: tuple[ScenarioOutcome, ...]

    @property
    def falls(self) -> int:
        """Number of worlds with a fall."""
        return sum(o.fallen for o in self.outcomes)

    @property
    def stops(self) -> int:
        """Number of worlds in which a robot in closed loop stopped before its goal, and stands."""
        return sum(bool(o.stopped) and not o.fallen for o in self.outcomes)

    @property
    def stands(self) -> str:
        """Text with the number of worlds without a fall."""
        count = len(self.outcomes)
        stops = f", stops before its goal in {self.stops}" if self.stops else ""
        return f"stands in {count - self.falls} of {count} worlds{stops}"

    @property
    def worst(self) -> int:
        """Index of the world with the earliest fall, or the largest deviation without falls."""
        fallen = [(o.time, i) for i, o in enumerate(self.outcomes) if o.fallen]
        if fallen:
            return min(fallen)[1]
        return max(range(len(self.outcomes)), key=lambda i: self.outcomes[i].farthest)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the probability of a fall (Clopper and Pearson)."""
        return compute_interval(self.falls, len(self.outcomes))

    @property
    def parameters(self) -> list[tuple[str, float]]:
        """Uncertain quantities and how far they differ between worlds with and without a fall.

        The difference of means in standard errors, for the component of a quantity that differs
        most, largest first. Among many joints or surfaces some differ by two or three by chance.
        """
        fallen = np.array([o.fallen for o in self.outcomes], bool)
        if fallen.all() or not fallen.any():
            return []
        numbers = np.array(
            [draw_numbers(self.seed, i, self.layout.size) for i in range(len(fallen))]
        )
        difference = numbers[fallen].mean(axis=0) - numbers[~fallen].mean(axis=0)
        difference /= np.sqrt(1 / fallen.sum() + 1 / (~fallen).sum())
        keys = {quantity: key for key, quantity, _ in KEYS}
        ranked = [
            (keys[name], float(difference[section][np.argmax(np.abs(difference[section]))]))
            for name, section in self.layout.slices
        ]
        return sorted(ranked, key=lambda item: -abs(item[1]))


def estimate_risk(
    plan: ClimbPlan,
    base: Conditions,
    engine: Engine,
    worlds: int,
    seed: int,
    *,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
    uncertainty: Uncertainty | None = None,
) -> RiskEstimate:
    """Simulate a plan in worlds 0 to `worlds` - 1 of a seed.

    Args:
        plan: The plan.
        base: Conditions that all worlds share.
        engine: "statics" or "mujoco".
        worlds: Number of worlds.
        seed: Seed of the worlds.
        workers: Number of processes; results do not depend on it.
        progress: Called with the fraction that is done.
        uncertainty: Distributions; None takes those of the plan's spec and its robot's file.

    Raises:
        UsageError: The engine has no model of the robot, or worlds move the triangles of a scan.
        MissingSolver: MuJoCo is not installed.
    """
    layout = build_layout(plan, read_uncertainty(plan) if uncertainty is None else uncertainty)
    first = sample_conditions(base, layout, draw_numbers(seed, 0, layout.size)).world
    if first is not None:
        perturb_terrain(plan.terrain, first)  # refuses a scan before anything is compiled
    run = partial(_simulate_mujoco, plan, base, layout, seed)
    if engine == "statics":
        run = partial(_simulate_statics, plan, prepare_steps(plan, base), base, layout, seed)
    size = _CHUNK_SIZE[engine]
    chunks = [range(first, min(first + size, worlds)) for first in range(0, worlds, size)]
    outcomes: list[ScenarioOutcome] = []
    batches = Parallel(n_jobs=workers, return_as="generator")(delayed(run)(c) for c in chunks)
    for batch in batches:
        outcomes += batch
        if progress is not None:
            progress(len(outcomes) / worlds)
    return RiskEstimate(engine, seed, layout, tuple(outcomes))


def build_world_conditions(risk: RiskEstimate, base: Conditions, number: int) -> Conditions:
    """Build the conditions of the world with a number."""
    return sample_conditions(base, risk.layout, draw_numbers(risk.seed, number, risk.layout.size))


def build_risk_dict(risk: RiskEstimate, names: Sequence[str], plan: ClimbPlan) -> dict[str, Any]:
    """Build the JSON-ready values of an estimate."""
    low, high = risk.interval
    count = len(risk.outcomes)
    return {
        "engine": risk.engine,
        "seed": risk.seed,
        "worlds": count,
        "falls": risk.falls,
        "stops": risk.stops,
        "probability": risk.falls / count,
        "lower": low,
        "upper": high,
        "interval": "Clopper-Pearson, 95 %",
        "causes": [
            {"cause": cause, "limb": limb, "round": number, "worlds": count_of_cause}
            for (cause, limb, number), count_of_cause in count_causes(risk, names, plan)
        ],
        "parameters": [{"key": key, "off": difference} for key, difference in risk.parameters],
        "fallen": [i for i, o in enumerate(risk.outcomes) if o.fallen],
    }


def count_causes(
    risk: RiskEstimate, names: Sequence[str], plan: ClimbPlan
) -> list[tuple[tuple[str, str, int], int]]:
    """Count the first failures of falls by cause, limb and round, most frequent first."""
    rounds = plan.instants.round
    counted = Counter(
        (
            o.cause,
            names[o.limb] if o.limb >= 0 else "",
            int(rounds[o.instant]) if o.instant >= 0 else 0,
        )
        for o in risk.outcomes
        if o.fallen
    )
    return sorted(counted.items(), key=lambda item: (-item[1], item[0]))


def format_risk(risk: RiskEstimate, names: Sequence[str], plan: ClimbPlan) -> list[str]:
    """Format an estimate as lines of text."""
    low, high = risk.interval
    count = len(risk.outcomes)
    falls_text = f"{risk.falls} of {count} worlds fall ({risk.engine})"
    lines = [f"{falls_text}: {risk.falls / count:.2%}, 95 % interval {low:.2%} to {high:.2%}"]
    if risk.stops:
        lines.append(f"  {risk.stops} of {count} worlds stop before the goal and stand")
    if risk.engine == "statics":
        lines.append("  MuJoCo ends otherwise in some 3 of 100 worlds (--engine mujoco)")
    for (cause, limb, number), frequency in count_causes(risk, names, plan)[:5]:
        lines.append(f"  {frequency}: {cause}{f', {limb}' if limb else ''}, round {number}")
    if risk.parameters:
        parameter_text = ", ".join(
            f"{key} {difference:+.1f}" for key, difference in risk.parameters[:3]
        )
        lines.append(f"  falls against stands, in standard errors: {parameter_text}")
    return lines


def _simulate_statics(
    plan: ClimbPlan,
    steps: PreparedMotion,
    base: Conditions,
    layout: ScenarioLayout,
    seed: int,
    chunk: range,
) -> list[ScenarioOutcome]:
    time = plan.trajectory.time[steps.sample]
    outcomes = []
    for index in chunk:
        world = sample_conditions(base, layout, draw_numbers(seed, index, layout.size))
        row = simulate_steps(plan, steps, world)
        fallen = bool(row[HAS_FALLEN])
        outcomes.append(
            ScenarioOutcome(
                fallen,
                float(time[int(row[FALL_STEP])] if fallen else time[-1]),
                _CAUSES[int(row[CAUSE])] if fallen else "",
                int(row[CAUSE_LIMB]) if fallen else -1,
                int(steps.instant[int(row[CAUSE_STEP])]) if fallen else -1,
                float(row[MAX_DEVIATION]),
            )
        )
    return outcomes


def _simulate_mujoco(
    plan: ClimbPlan, base: Conditions, layout: ScenarioLayout, seed: int, chunk: range
) -> list[ScenarioOutcome]:
    outcomes = []
    for index in chunk:
        run = simulate(
            plan, sample_conditions(base, layout, draw_numbers(seed, index, layout.size))
        )
        end = float(run.time[-1])
        deviation = run.com - plan.trajectory.com[: run.samples]
        farthest = float(np.linalg.norm(deviation, axis=1).max())
        if not run.fallen:
            stopped = "" if run.execution is None else run.execution.stopped
            outcomes.append(ScenarioOutcome(False, end, "", -1, -1, farthest, stopped))
            continue
        events = [(s.time, _CAUSES[2], s.limb, s.instant) for s in find_slips(plan, run)]
        events += [(x.time, _CAUSES[1], x.limb, x.instant) for x in find_losses(plan, run)]
        if run.grips is not None:
            events += [(x.time, _GRIP_LOST, x.limb, x.instant) for x in run.grips.failures]
        first = min(events, default=(end, _CAUSES[4], -1, plan.instants.count - 1))
        outcomes.append(ScenarioOutcome(True, end, *first[1:], farthest))
    return outcomes
