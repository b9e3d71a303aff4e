"""From a spec to a plan. Method `modes`: mode sequences best first, then programs, then the way.

Fully automatic: which modules latch where follows from the search, keyframes and motions from the
programs.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from climbplan.errors import Infeasible, LimitReached, NoPlanFound
from climbplan.limms.arms.carrying import carry
from climbplan.limms.arms.chain_carrying import carry_on_chains
from climbplan.limms.arms.relaying import Relaying
from climbplan.limms.attempts import Attempts
from climbplan.limms.check.verification import verification_of
from climbplan.limms.consensus.planner import plan_by_consensus
from climbplan.limms.deliveries import Deliveries
from climbplan.limms.legs.walking import walk
from climbplan.limms.modules.relatching import relatch
from climbplan.limms.modules.weights import PACES, too_heavy
from climbplan.limms.plan import LimmsPlan
from climbplan.limms.plan_making import Making, cut_short_warning, make_plan
from climbplan.limms.refusal import ruled_out
from climbplan.limms.relays import CHEAPEST, Relay, relays
from climbplan.limms.scene import Scene, scene_of
from climbplan.limms.sequences import Sequence as Modes
from climbplan.limms.sequences import search
from climbplan.limms.summary import summary_lines
from climbplan.limms.timeline import PlanSoFar
from climbplan.progress import Progress
from climbplan.spec.limms.loading import LoadedLimms

METHOD = "modes"
SOLVERS = {"programs": "IPOPT (CasADi)"}


def plan_limms(loaded: LoadedLimms, report: Progress = lambda stage, share: None) -> LimmsPlan:
    """The plan of a LIMMS spec.

    Raises:
        Infeasible: bounds that no plan escapes rule every mode sequence out.
        LimitReached: none of the sequences led to a plan, or not in time.
    """
    scene = scene_of(loaded)
    if heavy := too_heavy(scene):
        raise Infeasible("no plan exists: modules are too heavy", heavy, stage="modes")
    if loaded.spec.solver.method == "admm":
        return plan_by_consensus(loaded, report)
    solver = loaded.spec.solver
    attempts = Attempts(solver.time_limit, solver.programs)
    if scene.massless:
        return _plan_at_pace(loaded, scene, report, attempts)
    return _calmest(loaded, scene, report, attempts)


def _calmest(loaded: LoadedLimms, scene: Scene, report: Progress, attempts: Attempts) -> LimmsPlan:
    """With masses: ways without the box slower and slower, until all that they ask for is held.

    Raises as `plan_limms`; a plan that fails at every pace is the last one.
    """
    plan: LimmsPlan | None = None
    for pace in PACES:
        try:
            plan = _plan_at_pace(loaded, replace(scene, pace=pace), report, attempts)
        except NoPlanFound:
            if plan is None:
                raise
            # The plan of before is written, and marked as failing
            return _cut_short(plan, attempts) if attempts.over else plan
        if verification_of(plan).passed:
            break
    assert plan is not None
    return plan


def _cut_short(plan: LimmsPlan, attempts: Attempts) -> LimmsPlan:
    """A plan that time ran out to better."""
    if plan.status == "limit":
        return plan
    warnings = (cut_short_warning(attempts.limit), *plan.warnings)
    return replace(plan, status="limit", warnings=warnings)


def _plan_at_pace(
    loaded: LoadedLimms, scene: Scene, report: Progress, attempts: Attempts
) -> LimmsPlan:
    """One box by the cheapest sequence of modes, or several one after the other."""
    if scene.deliveries > 1:
        return _several(loaded, scene, report, attempts)
    return _planned(loaded, scene, report, attempts)


def _several(loaded: LoadedLimms, scene: Scene, report: Progress, attempts: Attempts) -> LimmsPlan:
    """The plan of a scene with several boxes. Raises as `plan_limms`."""
    began = time.perf_counter()
    report("plan", 0.0)
    deliveries = Deliveries(scene, attempts, np.random.default_rng(loaded.spec.seed))
    found = deliveries.plan()
    total = time.perf_counter() - began
    sizes = {
        "configurations": len(found.words),
        "sequences": deliveries.tried,
        "sequences_tried": deliveries.tried,
    }
    named = "; ".join(found.words)
    making = Making(METHOD, named, {"search": 0.0, "total": total}, sizes, dict(SOLVERS))
    plan = make_plan(loaded, scene, found.world, attempts, making)
    return replace(plan, summary=summary_lines(plan, attempts.notes))


def _planned(loaded: LoadedLimms, scene: Scene, report: Progress, attempts: Attempts) -> LimmsPlan:
    """The plan of a scene within what is left. Raises as `plan_limms`."""
    began = time.perf_counter()
    report("modes", 0.0)
    found = search(scene)
    searched = time.perf_counter() - began
    rng = np.random.default_rng(loaded.spec.seed)
    relaying = Relaying(scene, attempts, rng)
    most_steps = loaded.spec.solver.most_steps
    refused: list[tuple[PlanSoFar, str, int]] = []  # fail their verification

    def made(world: PlanSoFar, named: str, tried: int) -> LimmsPlan:
        seconds = {"search": searched, "total": time.perf_counter() - began}
        sizes = {
            "configurations": found.configurations,
            "sequences": max(len(found.sequences), tried),
            "sequences_tried": tried,
        }
        making = Making(METHOD, named, seconds, sizes, dict(SOLVERS))
        plan = make_plan(loaded, scene, world, attempts, making)
        return replace(plan, summary=summary_lines(plan, attempts.notes))

    def one(sequence: Modes | Relay, named: str, tried: int) -> PlanSoFar | None:
        def fault(world: PlanSoFar) -> str:
            verification = verification_of(made(world, named, tried))
            if verification.passed:
                return ""
            refused.append((world, named, tried))
            return verification.headline()

        if isinstance(sequence, Relay):
            return relaying.plan(sequence)
        if sequence.kind == "quadruped":
            # Between samples feet slip and legs touch the box: only the check knows
            return walk(scene, attempts, most_steps, rng, fault=fault)
        if sequence.kind == "relatch":
            return relatch(scene, sequence, attempts, rng)
        if any(connection.links > 1 for connection in sequence.connections):
            return carry_on_chains(scene, sequence, attempts, rng)
        return carry(scene, sequence, attempts, rng)

    tried = 0
    try:
        for number, sequence in enumerate(_candidates(scene, found.sequences)):
            report("plan", number / max(len(found.sequences), number + 1))
            tried, named, told = number + 1, sequence.named(scene), len(attempts.notes)
            attempts.begin(named)
            world = one(sequence, named, tried)
            if world is not None:
                return made(world, named, tried)
            if len(attempts.notes) == told:
                attempts.notes.append(f"{named}: no module can take its part")
        attempts.left()
    except LimitReached:
        if not refused:
            raise
    if refused:  # better than none: it is written, and marked as failing
        return made(*refused[0])
    if not tried:
        raise ruled_out(scene, found.conflicts)
    raise LimitReached(
        f"none of {tried} sequences of modes led to a plan, and none was proved "
        f"impossible. {attempts.story()}",
        stage="motion",
    )


def _candidates(scene: Scene, sequences: tuple[Modes, ...]) -> Iterator[Modes | Relay]:
    """What is tried, cheapest first; relays are looked for when nothing cheaper is left."""
    first = [each for each in sequences if each.cost() < CHEAPEST]
    yield from first
    if "arms" not in scene.allow:
        yield from sequences[len(first) :]
        return
    rest: list[Modes | Relay] = [*sequences[len(first) :], *relays(scene)]
    yield from sorted(rest, key=lambda each: each.cost())
