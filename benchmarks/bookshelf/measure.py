"""Runs of methods on scenes, each answer checked, and the figures of a run."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.bookshelf.contenders import Contender
from climbplan.arrays import Array
from climbplan.bookshelf.check.meanings import check_placements
from climbplan.bookshelf.methods.setting import MethodSetting
from climbplan.bookshelf.methods.table import prepare_method
from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.plan.summary import TRIVIAL
from climbplan.bookshelf.planner.runs import check_answers, compile_solver
from climbplan.bookshelf.scene.shelf_scene import Scenes
from climbplan.bookshelf.schema.model import Meaning

NEAR = 0.01  # what counts as at the optimum
_CONFIDENCE = 1.959964  # of a normal distribution, 95 %


@dataclass(frozen=True)
class Run:
    """One method in one meaning on some of the scenes."""

    contender: Contender
    meaning: Meaning
    scene: list[int]  # (K,) which scenes
    answers: list[SceneAnswer]  # (K,) as the exact check lets them pass
    claims: Array  # (K,) [mm^2] bounds as the solver gave them, infinite for `infeasible`
    prepared: float  # [s] before the first scene
    limit: float | None  # [s] of one scene, of slow methods

    @property
    def cost(self) -> Array:
        """Movement cost (K,) [mm^2], infinite for a failure."""
        return np.array([answer.objective for answer in self.answers], float)


@dataclass(frozen=True)
class Share:
    """A share with its 95 % confidence interval."""

    value: float
    low: float
    high: float


def wilson(hits: int, total: int) -> Share:
    """Wilson's score interval of `hits` out of `total`; no trials say nothing."""
    if total == 0:
        return Share(math.nan, 0.0, 1.0)
    z2, share = _CONFIDENCE**2, hits / total
    middle = (share + z2 / (2 * total)) / (1 + z2 / total)
    half = _CONFIDENCE * math.sqrt(share * (1 - share) / total + z2 / (4 * total**2))
    half /= 1 + z2 / total
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return Share(share, min(low, share), max(high, share))


@dataclass(frozen=True)
class Figures:
    """What the table says of a run. NaN where there is nothing to say."""

    method: str
    label: str
    meaning: str
    scenes: int
    limit_s: float | None
    success: float
    success_low: float
    success_high: float
    cost_ratio: float  # of the sums over all scenes that it solved
    nontrivial: int  # scenes whose optimum is above TRIVIAL
    nontrivial_solved: int
    within_1_percent: float  # share of the non-trivial scenes, failures count as not
    mean_ratio: float  # over the non-trivial scenes that it solved
    median_ratio: float
    below_reference: int  # scenes that cost less than the reference by more than the gap
    median_ms: float
    mean_ms: float
    most99_ms: float
    max_ms: float
    prepare_s: float
    candidates: float  # mean
    proved: int  # scenes with a proved gap
    bounds: int  # finite bounds, and claims that there is no placement
    bounds_above: int  # of these, those above the best known cost


def run_contender(
    contender: Contender,
    setting: MethodSetting,
    scenes: Scenes,
    rows: Sequence[int],
) -> Run:
    """Solve the scenes `rows` in order, one thread.

    A fast method solves the first one once before, so that what is loaded or compiled then is not
    on its clock. Raises as `prepare_method`.
    """
    begin = time.perf_counter()
    compile_solver(setting)
    method = prepare_method(setting, scenes.count)
    prepared = time.perf_counter() - begin
    if contender.effort != "few":
        method.solve(scenes[rows[0]])
    raw = [method.solve(scenes[k]) for k in rows]
    index = np.array(rows)
    chosen = Scenes(scenes.pose[index], scenes.size[index], scenes.inserted[index])
    claims = [math.inf if a.status == "infeasible" else a.bound for a in raw]
    limit = setting.solver.time_limit if contender.effort == "few" else None
    answers = check_answers(chosen, raw, setting)
    return Run(
        contender, setting.meaning, list(rows), answers, np.array(claims, float), prepared, limit
    )


def reference(
    runs: Sequence[Run], scenes: Scenes, setting: MethodSetting, meaning: Meaning
) -> Array:
    """Costs (S,) that ratios refer to: those of `exact` in the meaning `contact`, in `published`
    the best of all methods and of `exact` where its placement passes that check too."""
    best = np.full(len(scenes), math.inf)
    for run in runs:
        exact = run.contender.key == "exact"
        if meaning == "contact" and exact:
            best[run.scene] = run.cost
        elif meaning == "published" and exact:
            np.minimum.at(best, run.scene, _passing(run, scenes, setting))
        elif meaning == "published" and run.meaning == meaning:
            np.minimum.at(best, run.scene, run.cost)
    return best


def _passing(run: Run, scenes: Scenes, setting: MethodSetting) -> Array:
    """Costs of `exact`, infinite where its placement does not pass the published check."""
    cost = run.cost
    for k, answer in enumerate(run.answers):
        if answer.placement is not None:
            pose, state = answer.placement.pose[None], answer.placement.state[None]
            one = Scenes.of([scenes[run.scene[k]]])
            check = check_placements(one, pose, state, setting.shelf, "published")
            cost[k] = cost[k] if check.passed[0] else math.inf
    return cost


def figures_of(run: Run, best: Array, gap_mm2: float, gap: float) -> Figures:
    """Figures of a run against the reference costs (S,); what is within the gap is equal."""
    cost, known = run.cost, best[run.scene]
    solved = np.isfinite(cost)
    both = solved & np.isfinite(known)
    moving = np.isfinite(known) & (known > TRIVIAL)
    ratio = cost[both & moving] / known[both & moving]
    allowed = np.where(np.isfinite(known), np.maximum(gap_mm2, gap * known), 0.0)
    near = int((ratio <= 1 + NEAR).sum())
    ms = 1e3 * np.array([answer.seconds for answer in run.answers])
    share = wilson(int(solved.sum()), len(cost))
    claimed = run.claims > -math.inf
    least = np.minimum(known, cost)
    total = known[both].sum()
    return Figures(
        method=run.contender.key,
        label=run.contender.label,
        meaning=run.meaning,
        scenes=len(cost),
        limit_s=run.limit,
        success=share.value,
        success_low=share.low,
        success_high=share.high,
        cost_ratio=float(cost[both].sum() / total) if total > 0 else math.nan,
        nontrivial=int(moving.sum()),
        nontrivial_solved=len(ratio),
        within_1_percent=near / moving.sum() if moving.any() else math.nan,
        mean_ratio=float(ratio.mean()) if len(ratio) else math.nan,
        median_ratio=float(np.median(ratio)) if len(ratio) else math.nan,
        below_reference=int((cost < known - allowed)[both].sum()),
        median_ms=float(np.median(ms)),
        mean_ms=float(ms.mean()),
        most99_ms=float(np.percentile(ms, 99)),
        max_ms=float(ms.max()),
        prepare_s=run.prepared,
        candidates=float(np.mean([answer.candidates for answer in run.answers])),
        proved=sum(answer.status == "optimal" for answer in run.answers),
        bounds=int(claimed.sum()),
        bounds_above=int((claimed & np.isfinite(least) & (run.claims > least + allowed)).sum()),
    )
