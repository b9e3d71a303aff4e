"""From a spec to a plan, method `modes`: mode sequences best first, then programs, then the way.

Fully automatic: which modules latch where follows from the search, keyframes and motions from the
programs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from climbplan.errors import Infeasible, LimitReached
from climbplan.limms.carrying import Attempts, carry
from climbplan.limms.chain_carrying import carry_on_chains
from climbplan.limms.plan import LimmsPlan, motion_of
from climbplan.limms.relatching import relatch
from climbplan.limms.scene import GRAVITY, Scene, scene_of
from climbplan.limms.sequences import Search, Sequence, search
from climbplan.limms.summary import summary_lines
from climbplan.limms.timeline import Progress
from climbplan.limms.walking import walk
from climbplan.spec.limms_loading import LoadedLimms

Report = Callable[[str, float], None]
METHOD = "modes"


def plan_limms(loaded: LoadedLimms, report: Report = lambda stage, share: None) -> LimmsPlan:
    """The plan of a LIMMS spec.

    Raises:
        Infeasible: bounds that no plan escapes rule every mode sequence out.
        LimitReached: none of the sequences tried led to a plan.
    """
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
        left = loaded.spec.solver.time_limit - (time.perf_counter() - began)
        if left <= 0:
            break
        if sequence.kind == "quadruped":
            world = walk(scene, attempts, time.monotonic() + left, most_steps, rng)
        elif sequence.kind == "relatch":
            world = relatch(scene, sequence, attempts, left, rng)
        elif any(connection.links > 1 for connection in sequence.connections):
            world = carry_on_chains(scene, sequence, attempts, left, rng)
        else:
            world = carry(scene, sequence, attempts, left, rng)
        if world is not None:
            seconds = {"search": searched, "total": time.perf_counter() - began}
            return _plan(loaded, scene, found, sequence, number, attempts, world, seconds)
    tried = "; ".join(dict.fromkeys(attempts.notes))
    raise LimitReached(f"no plan found within the limits. Tried: {tried}")


def _plan(
    loaded: LoadedLimms,
    scene: Scene,
    found: Search,
    sequence: Sequence,
    number: int,
    attempts: Attempts,
    world: Progress,
    seconds: dict[str, float],
) -> LimmsPlan:
    motion, stages = motion_of(
        world.stretches, scene.module, scene.wall_position, scene.box_size, scene.box_start
    )
    normals = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    goal = scene.box_start.copy()
    goal[0] = scene.goal
    seconds |= {"build": attempts.build_seconds, "solve": attempts.solver_seconds}
    weight = scene.module.mass * GRAVITY
    warnings = []
    if weight > scene.module.max_force:
        warnings.append(
            f"the motion leaves out the modules' own dynamics: a module weighs {weight:.1f} N, "
            f"twice what a contact is said to hold ({scene.module.max_force:.0f} N)"
            if weight > 2 * scene.module.max_force
            else f"the motion leaves out the modules' own dynamics: a module weighs {weight:.1f} N"
        )
    plan = LimmsPlan(
        name=loaded.name,
        title=loaded.spec.title,
        method=METHOD,
        status="feasible",
        motion=motion,
        anchor_names=scene.anchor_names,
        anchor_normal=np.vstack([*([normals] * scene.boxes), scene.wall_normal]),
        box_size=scene.box_size,
        box_mass=scene.box_mass,
        goal=goal,
        arrival_speed=scene.arrival_speed,
        friction=scene.friction,
        solids=scene.solids,
        module=scene.module.model_dump(mode="json"),
        module_names=scene.module_names,
        stages=stages,
        sequence=sequence.named(scene),
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        objective=float(np.linalg.norm(motion.box_position[-1, 0] - scene.goal)),
        timings={key: round(value, 4) for key, value in seconds.items()},
        solvers={"programs": "IPOPT (CasADi)"},
        sizes={
            "modules": scene.count,
            "configurations": found.configurations,
            "sequences": len(found.sequences),
            "sequences_tried": number + 1,
            "programs": attempts.programs,
            "variables": attempts.variables,
            "constraints": attempts.constraints,
        },
        warnings=tuple(warnings),
    )
    return _with_summary(plan, attempts)


def _with_summary(plan: LimmsPlan, attempts: Attempts) -> LimmsPlan:
    return replace(plan, summary=summary_lines(plan, attempts.notes))
