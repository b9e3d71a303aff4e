"""Plan subject to a bound on the probability of a fall: `risk` of a spec.

1. Simulate the plan in NUM_SEARCH_WORLDS sampled worlds, the same for all plans of a search.
2. Increase the margins where it fell (`margin_increase.py`) and plan again, at most MAX_REPLANS
   times and while the number of falls decreases. If that is not enough, try other gaits.
3. Validate the best plan in fresh worlds, which no plan was chosen by: in as many as the bound
   takes to show, or in NUM_SEARCH_WORLDS if the bound is out of reach.
4. If it falls too often there, these worlds become those of another search.

Falls are counted by quasi-static steps, or in closed-loop execution in MuJoCo (`closed_loop` of a
spec). A world of the latter takes seconds to minutes: NUM_CLOSED_LOOP_WORLDS are searched in, and
a validation takes as many as show the bound with one fall.

There are at most MAX_VALIDATIONS validations. The confidence interval of each holds for one
validation; a plan passes one of them by chance with at most MAX_VALIDATIONS times that probability.
All limits count work, so the same spec and seed give the same plan.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Generic, Protocol, TypeVar

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import Promise, compute_interval
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.climb.schema.model import TaskSpec
from climbplan.climb.simulation.risk.estimation import RiskEstimate, count_causes, estimate_risk
from climbplan.climb.simulation.risk.margin_increase import (
    RequestedMargins,
    increase_margins,
    list_gaits,
    read_margins,
)
from climbplan.errors import NoPlanFound
from climbplan.progress import Progress
from climbplan.robots.joint_units import torque_unit
from climbplan.schema.robots.uncertainty import UncertaintySpec
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.mujoco_loading import load_mujoco
from climbplan.simulation.request import Engine

NUM_SEARCH_WORLDS = 300  # worlds in which the plans of a search are compared
NUM_CLOSED_LOOP_WORLDS = 40  # likewise, in closed loop
MAX_REPLANS = 5  # plans of one search
MAX_VALIDATIONS = 3  # in fresh worlds
PATIENCE = 2  # plans in a row without fewer falls, after which a search ends
VALIDATION_WORLDS_FACTOR = 10.0  # by 1 / risk, worlds of a validation
MIN_WORLDS, MAX_WORLDS = 300, 30_000
MAX_CLOSED_LOOP_WORLDS = 1000  # of a validation
_TARGET_FRACTION = 0.5  # of the bound, falls at which a search ends
_HOPELESS_FACTOR = 2.0  # by the bound, falls above which a long validation is pointless
_SEED_STRIDE = 1_000_003  # between the seeds of searches and validations
_NUM_CAUSES = 5


class _RiskSpec(Protocol):
    @property
    def risk(self) -> float | None: ...
    @property
    def closed_loop(self) -> bool: ...
    @property
    def margins(self) -> MarginsSpec: ...
    @property
    def task(self) -> object: ...
    @property
    def uncertainty(self) -> UncertaintySpec: ...
    @property
    def seed(self) -> int: ...


class _Loaded(Protocol):
    @property
    def spec(self) -> _RiskSpec: ...


L = TypeVar("L", bound=_Loaded)


@dataclass(frozen=True)
class Execution:
    """Number of worker processes, and the callback for progress."""

    workers: int
    report: Progress


@dataclass(frozen=True)
class _FallCounter:
    """Counts falls of plans in sampled worlds, by quasi-static steps or in closed loop."""

    is_closed_loop: bool
    execution: Execution

    @property
    def engine(self) -> Engine:
        """Engine that simulates the worlds."""
        return "mujoco" if self.is_closed_loop else "statics"

    @property
    def num_search_worlds(self) -> int:
        """Number of worlds in which the plans of a search are compared."""
        return NUM_CLOSED_LOOP_WORLDS if self.is_closed_loop else NUM_SEARCH_WORLDS

    def count_validation_worlds(self, max_risk: float) -> int:
        """Return the number of fresh worlds that a bound takes to show."""
        if not self.is_closed_loop:
            return min(max(MIN_WORLDS, round(VALIDATION_WORLDS_FACTOR / max_risk)), MAX_WORLDS)
        for worlds in range(NUM_CLOSED_LOOP_WORLDS, MAX_CLOSED_LOOP_WORLDS):
            if compute_interval(1, worlds)[1] <= max_risk:
                return worlds
        return MAX_CLOSED_LOOP_WORLDS

    def estimate(self, plan: ClimbPlan, worlds: int, seed: int) -> RiskEstimate:
        """Simulate a plan in worlds of a seed."""
        return estimate_risk(
            plan, Conditions(closed_loop=self.is_closed_loop), self.engine, worlds, seed,
            workers=self.execution.workers,
            progress=lambda fraction: self.execution.report("risk", fraction),
        )  # fmt: skip


def plan_with_risk(
    loaded: L,
    plan: Callable[[L], ClimbPlan],
    override: Callable[[L, list[str]], L],
    execution: Execution,
) -> ClimbPlan:
    """Plan a spec, subject to its bound on the probability of a fall if it has one (`risk`).

    Args:
        loaded: The spec.
        plan: Plans a loaded spec.
        override: Returns the loaded spec with overrides of its keys ("key=value").
        execution: Workers and progress.

    Raises:
        NoPlanFound: There is no plan of the spec as it is.
        UsageError: The quasi-static engine has no model of the robot.
        MissingSolver: Falls are to be counted in closed loop, and MuJoCo is not installed.
    """
    max_risk = loaded.spec.risk
    if loaded.spec.closed_loop:
        load_mujoco()  # which may be missing, before anything is planned
    first = plan(loaded)
    if max_risk is None:
        return first
    seed = loaded.spec.seed
    counter = _FallCounter(loaded.spec.closed_loop, execution)
    search = _Search(loaded, plan, override, counter, max_risk)
    candidate = _RatedPlan(
        first,
        read_margins(loaded.spec.margins),
        counter.estimate(first, counter.num_search_worlds, seed),
    )
    search.log_candidate(candidate)
    validation = candidate.risk
    for time in range(1, MAX_VALIDATIONS + 1):
        max_falls = (
            int(_TARGET_FRACTION * max_risk * counter.num_search_worlds)
            if time == 1
            else _compute_allowed_falls(max_risk, validation)
        )
        best = search.find_better(candidate, max_falls)
        hopeless = len(best.risk.outcomes) * _HOPELESS_FACTOR * max_risk < best.risk.falls
        if time > 1 and (best.plan is candidate.plan or hopeless):
            break  # no plan falls less often: the last validation is final
        worlds = counter.num_search_worlds
        if not hopeless:
            worlds = counter.count_validation_worlds(max_risk)
        validation = counter.estimate(best.plan, worlds, (seed + time * _SEED_STRIDE) % 2**32)
        candidate = replace(best, risk=validation)
        search.log_candidate(candidate, is_validation=True)
        if hopeless or compute_interval(validation.falls, worlds)[1] <= max_risk:
            break
    promise = _build_promise(
        candidate.plan, max_risk, validation, tuple(search.log), counter.is_closed_loop
    )
    return replace(
        candidate.plan, promise=promise, summary=(*candidate.plan.summary, _format_promise(promise))
    )


@dataclass(frozen=True)
class _RatedPlan:
    """A plan, the margins that it was planned with, and the estimate of its risk."""

    plan: ClimbPlan
    margins: RequestedMargins
    risk: RiskEstimate


class _Search(Generic[L]):
    """A search for plans that fall less often, with a log of all candidates."""

    def __init__(
        self,
        loaded: L,
        plan: Callable[[L], ClimbPlan],
        override: Callable[[L, list[str]], L],
        counter: _FallCounter,
        max_risk: float,
    ) -> None:
        self._loaded, self._plan, self._override = loaded, plan, override
        self._counter, self._max_risk = counter, max_risk
        self.log: list[str] = []

    def log_candidate(self, candidate: _RatedPlan, is_validation: bool = False) -> None:
        """Append a candidate and its falls to the log."""
        prefix = "judged in fresh worlds: " if is_validation else ""
        falls_text = f"{candidate.risk.falls} of {len(candidate.risk.outcomes)} worlds fall"
        self.log.append(f"{prefix}margins {candidate.margins.text}: {falls_text}")

    def find_better(self, start: _RatedPlan, max_falls: int) -> _RatedPlan:
        """Find a plan with at most `max_falls` falls in the worlds of the first, or the best."""
        best, candidate, num_stalled = start, start, 0
        if not self._loaded.spec.margins.asked:
            return start
        for _ in range(MAX_REPLANS):
            if best.risk.falls <= max_falls:
                break
            margins = increase_margins(candidate.margins, candidate.risk, candidate.plan)
            try:
                plan = self._plan(self._override(self._loaded, margins.overrides))
            except NoPlanFound as error:
                line = error.message.splitlines()[0]
                self.log.append(f"margins {margins.text}: {line}")
                break
            worlds, seed = len(start.risk.outcomes), start.risk.seed
            candidate = _RatedPlan(plan, margins, self._counter.estimate(plan, worlds, seed))
            self.log_candidate(candidate)
            num_stalled = 0 if candidate.risk.falls < best.risk.falls else num_stalled + 1
            if candidate.risk.falls < best.risk.falls:
                best = candidate
            if num_stalled == PATIENCE:
                break
        return self._try_gaits(best, max_falls)

    def _try_gaits(self, best: _RatedPlan, max_falls: int) -> _RatedPlan:
        """Try other gaits if the climb leaves its gait open; return the best candidate."""
        task = self._loaded.spec.task
        limbs = best.plan.robot.limb_names
        is_gait_open = isinstance(task, TaskSpec) and task.gait is None and not best.margins.gait
        for gait in list_gaits(tuple(limbs), tuple(limbs)) if is_gait_open else ():
            if best.risk.falls <= max_falls:
                break
            margins = replace(read_margins(self._loaded.spec.margins), gait=gait)
            try:
                plan = self._plan(self._override(self._loaded, margins.overrides))
            except NoPlanFound as error:
                line = error.message.splitlines()[0]
                self.log.append(f"margins {margins.text}: {line}")
                continue
            worlds, seed = len(best.risk.outcomes), best.risk.seed
            candidate = _RatedPlan(plan, margins, self._counter.estimate(plan, worlds, seed))
            self.log_candidate(candidate)
            if candidate.risk.falls < best.risk.falls:
                best = candidate
        return best


def _compute_allowed_falls(max_risk: float, risk: RiskEstimate) -> int:
    """Compute the falls in the worlds of an estimate at which a search may end.

    Half of the largest number that meets the bound: fresh worlds then nearly always meet it, too.
    """
    worlds, max_falls = len(risk.outcomes), 0
    while compute_interval(max_falls + 1, worlds)[1] <= max_risk:
        max_falls += 1
    return max_falls // 2


def _build_promise(
    plan: ClimbPlan,
    max_risk: float,
    risk: RiskEstimate,
    log: tuple[str, ...],
    is_closed_loop: bool,
) -> Promise:
    low, high = compute_interval(risk.falls, len(risk.outcomes))
    names = plan.robot.limb_names
    causes = tuple(
        f"{frequency}: {cause}{f', {limb}' if limb else ''}, round {number}"
        for (cause, limb, number), frequency in count_causes(risk, names, plan)[:_NUM_CAUSES]
    )
    spreads = {
        f.name: [s.kind, s.low, s.high]
        for f in fields(risk.layout.uncertainty)
        if not (s := getattr(risk.layout.uncertainty, f.name)).exact
    }
    is_met = high <= max_risk
    return Promise(
        max_risk, risk.engine, risk.seed, len(risk.outcomes), risk.falls, low, high, spreads,
        causes, () if is_met else _list_remedies(plan, risk), log, is_closed_loop, risk.stops,
    )  # fmt: skip


def _list_remedies(plan: ClimbPlan, risk: RiskEstimate) -> tuple[str, ...]:
    """List what would reduce the falls: better known quantities, stronger motors, terrain."""
    remedies = []
    if risk.falls == 0:
        remedies.append("more worlds: none of these fell")
    for key, difference in risk.parameters[:2]:
        remedies.append(
            f"knowing uncertainty.{key} better: falls differ by {difference:+.1f} standard errors"
        )
    forces = plan.forces
    worst = float(forces.safety_torque.min())
    required = plan.limits.safety_torque
    if worst < _TORQUE_MARGIN * required:
        limb, joint = divmod(
            int(abs(forces.motor_torques).max(axis=0).argmax()), plan.robot.joint_count
        )
        used_torque = float(abs(forces.motor_torques[:, limb, joint]).max())
        max_torque = float(plan.robot.max_torque[limb, joint])
        name = f"{plan.robot.limb_names[limb]} {plan.robot.joint_name(limb, joint)}"
        unit = torque_unit(plan.robot, limb, joint)
        use_text = f"{name} gives {used_torque:.1f} of {max_torque:.1f} {unit}"
        remedies.append(f"stronger motors: {use_text} (S_tau {worst:.2f})")
    return (*remedies, *forces.notes)


_TORQUE_MARGIN = 1.1  # by the required S_tau, below which motors limit the margins


def _format_promise(promise: Promise) -> str:
    verdict = "met" if promise.met else "NOT MET"
    interval_text = f"{promise.lower:.2%} to {promise.upper:.2%} fall, asked {promise.risk:.2%}"
    return f"{'risk':<9} {verdict:<9} {promise.words} ({promise.engine}): {interval_text}"
