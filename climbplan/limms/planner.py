"""From a spec to a plan. Method `modes`: mode sequences best first, then programs, then the way.

Fully automatic: which modules latch where follows from the search, keyframes and motions from the
programs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.errors import Infeasible, LimitReached
from climbplan.limms.attempts import Attempts
from climbplan.limms.carrying import carry
from climbplan.limms.chain_carrying import carry_on_chains
from climbplan.limms.consensus.planner import plan_by_consensus
from climbplan.limms.plan import LimmsPlan
from climbplan.limms.plan_making import Making, make_plan
from climbplan.limms.relatching import relatch
from climbplan.limms.scene import scene_of
from climbplan.limms.sequences import search
from climbplan.limms.summary import summary_lines
from climbplan.limms.walking import walk
from climbplan.spec.limms_loading import LoadedLimms

Report = Callable[[str, float], None]
METHOD = "modes"
SOLVERS = {"programs": "IPOPT (CasADi)"}


def plan_limms(loaded: LoadedLimms, report: Report = lambda stage, share: None) -> LimmsPlan:
    """The plan of a LIMMS spec.

    Raises:
        Infeasible: bounds that no plan escapes rule every mode sequence out.
        LimitReached: none of the sequences led to a plan, or not in time.
    """
    if loaded.spec.solver.method == "admm":
        return plan_by_consensus(loaded, report)
    began = time.perf_counter()
    scene = scene_of(loaded)
    report("modes", 0.0)
    found = search(scene)
    searched = time.perf_counter() - began
    if not found.sequences:
        raise Infeasible("no plan exists: each behaviour is ruled out", list(found.conflicts))
    attempts = Attempts(loaded.spec.solver.time_limit)
    rng = np.random.default_rng(loaded.spec.seed)
    most_steps = loaded.spec.solver.most_steps
    for number, sequence in enumerate(found.sequences):
        report("plan", number / len(found.sequences))
        left = attempts.left()
        if sequence.kind == "quadruped":
            world = walk(scene, attempts, attempts.end, most_steps, rng)
        elif sequence.kind == "relatch":
            world = relatch(scene, sequence, attempts, left, rng)
        elif any(connection.links > 1 for connection in sequence.connections):
            world = carry_on_chains(scene, sequence, attempts, left, rng)
        else:
            world = carry(scene, sequence, attempts, left, rng)
        if world is not None:
            seconds = {"search": searched, "total": time.perf_counter() - began}
            sizes = {
                "configurations": found.configurations,
                "sequences": len(found.sequences),
                "sequences_tried": number + 1,
            }
            made = Making(METHOD, sequence.named(scene), seconds, sizes, dict(SOLVERS))
            plan = make_plan(loaded, scene, world, attempts, made)
            return replace(plan, summary=summary_lines(plan, attempts.notes))
    attempts.left()
    raise LimitReached(f"none of the sequences tried led to a plan. {attempts.story()}")
