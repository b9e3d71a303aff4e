"""`risk:` of a spec: plans are judged in uncertain worlds and planned again where they fell.

A plan is played by the quasi-static engine in LOOKED worlds, the same for all plans of a run. Each
round in which falls began is asked for STEP times the margins of pressure and friction
(`margins.rounds`), and the climb is planned again, at most TIMES times and as long as that helps.
The plan that fell least is then judged in fresh worlds, which nothing was chosen by: in as many as
it takes to show the promise, or in LOOKED where it is out of reach. All counts are of work: the
same spec and seed give the same plan.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Protocol, TypeVar

from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.plan.promise import Promise, interval_of
from climbplan.errors import NoPlanFound
from climbplan.progress import Progress
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.worlds.judging import Engine, Judged, causes, judge_plan
from climbplan.spec.climb.margins import MarginsSpec
from climbplan.spec.climb.uncertainty import UncertaintySpec

ENGINE: Engine = "statics"
LOOKED = 300  # worlds in which plans are compared
TIMES = 5  # plans are made again
STEP = 1.5  # factor on margins of a round in which falls began
PATIENCE = 2  # plans in a row that fall no less
FEW = 0.02  # part of the falls from which a round counts
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
    factors = dict(loaded.spec.margins.rounds)
    best, fell = first, _judged(first, LOOKED, seed, ways)
    tried = [_told(factors, fell)]
    now, idle = fell, 0
    for _ in range(TIMES):
        if fell.falls <= _SURE * risk * LOOKED or not loaded.spec.margins.asked:
            break
        factors = _more(factors, now, best)
        words = "{" + ", ".join(f"{k}: {v:.4g}" for k, v in sorted(factors.items())) + "}"
        try:
            found = plan(again(loaded, [f"margins.rounds={words}"]))
        except NoPlanFound as error:
            tried.append(f"margins.rounds {words}: {error.message.splitlines()[0]}")
            break
        now = _judged(found, LOOKED, seed, ways)
        tried.append(_told(factors, now))
        idle = 0 if now.falls < fell.falls else idle + 1
        if now.falls < fell.falls:
            best, fell = found, now
        if idle == PATIENCE:
            break
    worlds = LOOKED
    if fell.falls <= _HOPE * risk * LOOKED:
        worlds = min(max(FEWEST, round(SHOWN / risk)), MOST)
    fresh = _judged(best, worlds, (seed + _FRESH) % 2**32, ways)
    promise = _promise(best, risk, fresh, tuple(tried))
    return replace(best, promise=promise, summary=(*best.summary, _line(promise)))


def _judged(plan: ClimbPlan, worlds: int, seed: int, ways: Ways) -> Judged:
    return judge_plan(
        plan, Conditions(), ENGINE, worlds, seed, ways.workers,
        lambda part: ways.report("risk", part),
    )  # fmt: skip


def _more(factors: dict[int, float], judged: Judged, plan: ClimbPlan) -> dict[int, float]:
    """More of the margins in rounds in which falls began, the one before the first instant 1."""
    rounds = Counter(
        int(plan.instants.round[max(o.instant, 0)]) for o in judged.outcomes if o.fallen
    )
    out = dict(factors)
    for number, many in rounds.items():
        if many > FEW * judged.falls:
            out[number] = STEP * out.get(number, 1.0)
    return out


def _told(factors: dict[int, float], judged: Judged) -> str:
    asked = ", ".join(f"round {k} x {v:.3g}" for k, v in sorted(factors.items()))
    return f"margins {asked or 'as stated'}: {judged.falls} of {len(judged.outcomes)} worlds fall"


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
            int(abs(forces.joint_torques).max(axis=0).argmax()), plan.robot.joint_count
        )
        used = float(abs(forces.joint_torques[:, limb, joint]).max())
        most = float(plan.robot.max_torque[limb, joint])
        name = f"{plan.robot.limb_names[limb]} {plan.robot.joint_name(limb, joint)}"
        given = f"{name} gives {used:.1f} of {most:.1f} N m"
        out.append(f"stronger motors: {given} (S_tau {worst:.2f})")
    return (*out, *forces.notes)


_SPENT = 1.1  # times the least S_tau, below which motors have nothing left to press with


def _line(promise: Promise) -> str:
    word = "met" if promise.met else "NOT MET"
    upper = f"{promise.lower:.2%} to {promise.upper:.2%} fall, asked {promise.risk:.2%}"
    return f"{'risk':<9} {word:<9} {promise.words} ({promise.engine}): {upper}"
