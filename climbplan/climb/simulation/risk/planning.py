"""`risk:` of a spec: plans are judged in uncertain worlds and planned again where they fell.

A plan is played by the quasi-static engine in LOOKED worlds, the same for all plans of a search.
What fell it is asked for more (`more.py`), and the climb is planned again, at most TIMES times and
as long as that helps; where that does not suffice, limbs move in other orders. The plan that fell
least is then judged in fresh worlds, which nothing was chosen by: in as many as it takes to show
the promise, or in LOOKED where it is out of reach. Where these show that it falls too often, they
become the worlds of another search, and what that finds is judged in fresh ones again, JUDGED times
at most: the interval of each says how sure one judgement is, and a plan passes by chance in any of
JUDGED with JUDGED times that probability at most. All counts are of work: the same spec and seed
give the same plan.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Generic, Protocol, TypeVar

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import Promise, interval_of
from climbplan.climb.schema.margins import MarginsSpec
from climbplan.climb.schema.model import TaskSpec
from climbplan.climb.simulation.risk.judging import Judged, causes, judge_plan
from climbplan.climb.simulation.risk.more import More, as_stated, gaits, more
from climbplan.errors import NoPlanFound
from climbplan.progress import Progress
from climbplan.robots.joint_units import torque_unit
from climbplan.schema.robots.uncertainty import UncertaintySpec
from climbplan.simulation.asked import Engine
from climbplan.simulation.conditions import Conditions

ENGINE: Engine = "statics"
LOOKED = 300  # worlds in which plans are compared
TIMES = 5  # plans are made again
JUDGED = 3  # times that fresh worlds are played at most
PATIENCE = 2  # plans in a row that fall no less
SHOWN = 10.0  # worlds in one over the risk that the last judgement plays
FEWEST, MOST = 300, 30_000
_SURE = 0.5  # times the risk that falls may be for nothing more to be asked for
_HOPE = 2.0  # times the risk that falls may be among those looked at, for the long judgement
_FRESH = 1_000_003  # between seeds of worlds looked at and of those judged by
_CAUSES = 5


class _RiskSpec(Protocol):
    @property
    def risk(self) -> float | None: ...
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
class Ways:
    """How plans are made and asked for anew."""

    workers: int
    report: Progress


def plan_with_risk(
    loaded: L,
    plan: Callable[[L], ClimbPlan],
    again: Callable[[L, list[str]], L],
    ways: Ways,
) -> ClimbPlan:
    """The plan of a spec, with its promise where it asks for one (`risk`).

    again: the same spec with overrides. Raises what planning raises of the spec as it is, and
    UsageError for robots that the engine does not know.
    """
    risk = loaded.spec.risk
    first = plan(loaded)
    if risk is None:
        return first
    seed = loaded.spec.seed
    search = _Search(loaded, plan, again, ways, risk)
    found = _Tried(first, as_stated(loaded.spec.margins), _judged(first, LOOKED, seed, ways))
    search.note(found)
    fresh = found.judged
    for time in range(1, JUDGED + 1):
        enough = int(_SURE * risk * LOOKED) if time == 1 else _allowed(risk, fresh)
        best = search.less(found, enough)
        hopeless = len(best.judged.outcomes) * _HOPE * risk < best.judged.falls
        if time > 1 and (best.plan is found.plan or hopeless):
            break  # nothing falls less; its judgement stands
        worlds = LOOKED
        if not hopeless:
            worlds = min(max(FEWEST, round(SHOWN / risk)), MOST)
        fresh = _judged(best.plan, worlds, (seed + time * _FRESH) % 2**32, ways)
        found = replace(best, judged=fresh)
        search.note(found, judged=True)
        if hopeless or interval_of(fresh.falls, worlds)[1] <= risk:
            break
    promise = _promise(found.plan, risk, fresh, tuple(search.tried))
    return replace(found.plan, promise=promise, summary=(*found.plan.summary, _line(promise)))


@dataclass(frozen=True)
class _Tried:
    """A plan, the margins that it was asked for, and how it did."""

    plan: ClimbPlan
    asked: More
    judged: Judged


class _Search(Generic[L]):
    """Plans made again, with what is said of each."""

    def __init__(
        self,
        loaded: L,
        plan: Callable[[L], ClimbPlan],
        again: Callable[[L, list[str]], L],
        ways: Ways,
        risk: float,
    ) -> None:
        self._loaded, self._plan, self._again = loaded, plan, again
        self._ways, self._risk = ways, risk
        self.tried: list[str] = []

    def note(self, found: _Tried, judged: bool = False) -> None:
        """Say how a plan did."""
        word = "judged in fresh worlds: " if judged else ""
        fell = f"{found.judged.falls} of {len(found.judged.outcomes)} worlds fall"
        self.tried.append(f"{word}margins {found.asked.words}: {fell}")

    def less(self, start: _Tried, enough: int) -> _Tried:
        """The plan that falls least in the worlds of one to start with, at most `enough` times."""
        best, now, idle = start, start, 0
        if not self._loaded.spec.margins.asked:
            return start
        for _ in range(TIMES):
            if best.judged.falls <= enough:
                break
            asked = more(now.asked, now.judged, now.plan)
            try:
                found = self._plan(self._again(self._loaded, asked.overrides))
            except NoPlanFound as error:
                line = error.message.splitlines()[0]
                self.tried.append(f"margins {asked.words}: {line}")
                break
            worlds, seed = len(start.judged.outcomes), start.judged.seed
            now = _Tried(found, asked, _judged(found, worlds, seed, self._ways))
            self.note(now)
            idle = 0 if now.judged.falls < best.judged.falls else idle + 1
            if now.judged.falls < best.judged.falls:
                best = now
            if idle == PATIENCE:
                break
        return self._in_other_orders(best, enough)

    def _in_other_orders(self, best: _Tried, enough: int) -> _Tried:
        """That, or the plan of another gait which falls less, where a climb leaves it open."""
        task = self._loaded.spec.task
        limbs = best.plan.robot.limb_names
        left_open = isinstance(task, TaskSpec) and task.gait is None and not best.asked.gait
        for gait in gaits(tuple(limbs), tuple(limbs)) if left_open else ():
            if best.judged.falls <= enough:
                break
            asked = replace(as_stated(self._loaded.spec.margins), gait=gait)
            try:
                found = self._plan(self._again(self._loaded, asked.overrides))
            except NoPlanFound as error:
                line = error.message.splitlines()[0]
                self.tried.append(f"margins {asked.words}: {line}")
                continue
            worlds, seed = len(best.judged.outcomes), best.judged.seed
            now = _Tried(found, asked, _judged(found, worlds, seed, self._ways))
            self.note(now)
            if now.judged.falls < best.judged.falls:
                best = now
        return best


def _allowed(risk: float, judged: Judged) -> int:
    """The most falls in as many worlds as were judged that a promise can have, less a margin.

    Half of the most, for as many in fresh worlds are less than the most nearly always.
    """
    worlds, most = len(judged.outcomes), 0
    while interval_of(most + 1, worlds)[1] <= risk:
        most += 1
    return most // 2


def _judged(plan: ClimbPlan, worlds: int, seed: int, ways: Ways) -> Judged:
    return judge_plan(
        plan, Conditions(), ENGINE, worlds, seed, ways.workers,
        lambda part: ways.report("risk", part),
    )  # fmt: skip


def _promise(plan: ClimbPlan, risk: float, judged: Judged, tried: tuple[str, ...]) -> Promise:
    low, high = interval_of(judged.falls, len(judged.outcomes))
    names = plan.robot.limb_names
    fells = tuple(
        f"{many}: {cause}{f', {limb}' if limb else ''}, round {number}"
        for (cause, limb, number), many in causes(judged, names, plan)[:_CAUSES]
    )
    spreads = {
        f.name: [s.kind, s.low, s.high]
        for f in fields(judged.layout.uncertainty)
        if not (s := getattr(judged.layout.uncertainty, f.name)).exact
    }
    met = high <= risk
    return Promise(
        risk, ENGINE, judged.seed, len(judged.outcomes), judged.falls, low, high, spreads, fells,
        () if met else _helps(plan, judged), tried,
    )  # fmt: skip


def _helps(plan: ClimbPlan, judged: Judged) -> tuple[str, ...]:
    """What the falls ask for: a quantity known better, stronger motors, terrain for the margins."""
    out = []
    if judged.falls == 0:
        out.append("more worlds: none of these fell")
    for key, off in judged.parameters[:2]:
        out.append(f"knowing uncertainty.{key} better: falls differ by {off:+.1f} standard errors")
    forces = plan.forces
    worst = float(forces.safety_torque.min())
    asked = plan.limits.safety_torque
    if worst < _SPENT * asked:
        limb, joint = divmod(
            int(abs(forces.motor_torques).max(axis=0).argmax()), plan.robot.joint_count
        )
        used = float(abs(forces.motor_torques[:, limb, joint]).max())
        most = float(plan.robot.max_torque[limb, joint])
        name = f"{plan.robot.limb_names[limb]} {plan.robot.joint_name(limb, joint)}"
        unit = torque_unit(plan.robot, limb, joint)
        given = f"{name} gives {used:.1f} of {most:.1f} {unit}"
        out.append(f"stronger motors: {given} (S_tau {worst:.2f})")
    return (*out, *forces.notes)


_SPENT = 1.1  # times the least S_tau, below which motors have nothing left to press with


def _line(promise: Promise) -> str:
    word = "met" if promise.met else "NOT MET"
    upper = f"{promise.lower:.2%} to {promise.upper:.2%} fall, asked {promise.risk:.2%}"
    return f"{'risk':<9} {word:<9} {promise.words} ({promise.engine}): {upper}"
