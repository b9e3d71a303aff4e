"""One scene planned by one method, its figures, and why it failed if it did."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from benchmarks.limms.replay import Replay, replay_of
from climbplan.errors import Infeasible, LimitReached, MissingSolver, Unresolved
from climbplan.limms.check.verification import verify_plan
from climbplan.limms.consensus.admm import TOLERANCES
from climbplan.limms.consensus.planner import RefinementFailed
from climbplan.limms.plan.convergence import Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.planner.planner import plan_limms
from climbplan.limms.schema.loading import LoadedLimms, limms_of
from climbplan.schema.overrides import apply_overrides
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml

Method = Literal["modes", "admm", "admm-published"]
ASSIGNMENTS: dict[Method, tuple[str, ...]] = {  # of each method
    "modes": ("solver.method=mode-search",),
    "admm": ("solver.method=admm",),
    "admm-published": ("solver.method=admm", "solver.admm.formulation=published"),
}
METHODS = tuple(ASSIGNMENTS)


@dataclass(frozen=True)
class Consensus:
    """Of a choice of modes of a consensus: residuals of its best iterate, means and largest."""

    iterations: int
    good_after: int | None  # iterations until all means are as asked for
    box: float  # [m] r_pB, mean
    points: float  # [m] r_pL
    axes: float  # [rad] r_RL
    box_most: float
    points_most: float
    axes_most: float


@dataclass(frozen=True)
class Trial:
    """What came of it."""

    scene: str
    method: str
    outcome: str  # "verified", "not verified", "infeasible", "limit"
    reason: str  # of a failure
    sequence: str
    processor_seconds: float  # of planning
    seconds: float
    timings: dict[str, float]
    sizes: dict[str, Any]
    consensus: Consensus | None
    title: str = ""  # of the scene
    modules: int = 0
    hardware: str = ""  # the module's file
    checks: int = 0  # that judge
    verifying_seconds: float = 0.0  # [s] of processor time, after planning
    replay: Replay | None = None

    @property
    def succeeded(self) -> bool:
        """Whether there is a verified plan."""
        return self.outcome == "verified"


def attempt(
    loaded: LoadedLimms,
    method: Method,
    seconds: float,
    more: tuple[str, ...] = (),
    simulated: bool = False,
) -> Trial:
    """Plan and verify; seconds: the time limit of planning; more: assignments to the spec.

    simulated: also play the plan in the simulation, where MuJoCo is there.
    """
    # Into the text: verification reads the method there.
    assignments = (*ASSIGNMENTS[method], *more, f"solver.time_limit={seconds}")
    text = SourceText(loaded.source, loaded.name, loaded.directory, loaded.text)
    given = limms_of(apply_overrides(parse_yaml(loaded.text, loaded.source), assignments), text)
    clock, wall = time.process_time(), time.perf_counter()
    plan: LimmsPlan | None = None
    outcome, reason = "verified", ""
    record: Convergence | None = None
    try:
        plan = plan_limms(given)
    except Infeasible as error:
        outcome, reason = "infeasible", str(error)
    except Unresolved as error:
        outcome, reason = "not proved", str(error)
    except LimitReached as error:
        outcome, reason = "limit", str(error)
        record = error.convergence if isinstance(error, RefinementFailed) else None
    spent, waited = time.process_time() - clock, time.perf_counter() - wall
    title, modules = loaded.spec.title, len(loaded.spec.modules)
    if plan is None:
        times = (spent, waited)
        agreed = None if record is None else consensus_of(record, planned=False)
        return Trial(
            loaded.name,
            method,
            outcome,
            reason,
            "",
            *times,
            {},
            {},
            agreed,
            title,
            modules,
            given.spec.robot,
        )
    clock = time.process_time()
    verification = verify_plan(plan)
    verifying = time.process_time() - clock
    failed = verification.failed
    if failed:
        outcome = "not verified"
        reason = "; ".join(f"{c.name} {c.residual:.2g} {c.unit} at {c.worst_at}" for c in failed)
    return Trial(
        loaded.name,
        method,
        outcome,
        reason,
        plan.sequence,
        spent,
        waited,
        dict(plan.timings),
        dict(plan.sizes),
        None if plan.convergence is None else consensus_of(plan.convergence),
        title,
        modules,
        given.spec.robot,
        sum(check.judged for check in verification.checks),
        verifying,
        _replayed(plan) if simulated else None,
    )


def _replayed(plan: LimmsPlan) -> Replay | None:
    """None without MuJoCo."""
    try:
        return replay_of(plan)
    except MissingSolver:
        return None


def consensus_of(record: Convergence, planned: bool = True) -> Consensus:
    """Figures of the choice of modes that a plan was made from, the last one.

    planned: False where there is no plan: of the choice on which blocks agreed best.
    """
    total = record.box_mean + record.points_mean + 0.1 * record.axes_mean
    at = record.attempt == record.attempt[-1 if planned else int(np.argmin(total))]
    means = np.array([record.box_mean[at], record.points_mean[at], record.axes_mean[at]])
    most = np.array([record.box_max[at], record.points_max[at], record.axes_max[at]])
    good = np.flatnonzero((means <= np.array(TOLERANCES)[:, None]).all(axis=0))
    best = int(np.argmin(means[0] + means[1] + 0.1 * means[2]))
    return Consensus(
        int(at.sum()),
        int(good[0]) + 1 if len(good) else None,
        *(float(value) for value in (*means[:, best], *most[:, best])),
    )
