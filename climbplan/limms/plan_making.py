"""A finished course of events made into a plan, for every method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.limms.attempts import Attempts
from climbplan.limms.convergence import Convergence
from climbplan.limms.plan import LimmsPlan, Motion, motion_of
from climbplan.limms.scene import GRAVITY, SIDE_NORMALS, Scene
from climbplan.limms.timeline import DRIVES, Progress
from climbplan.spec.limms_loading import LoadedLimms


@dataclass(frozen=True)
class Making:
    """How a plan came about."""

    method: str
    sequence: str  # modes in words
    seconds: dict[str, float]
    sizes: dict[str, Any]
    solvers: dict[str, str]
    convergence: Convergence | None = None


def make_plan(
    loaded: LoadedLimms, scene: Scene, world: Progress, attempts: Attempts, making: Making
) -> LimmsPlan:
    """The plan, without the lines of its summary."""
    motion, stages = motion_of(
        world.stretches, scene.module, scene.wall_position, scene.box_size, scene.box_start
    )
    goal = scene.box_start.copy()
    goal[0] = scene.goal
    seconds = making.seconds | {"build": attempts.build_seconds, "solve": attempts.solver_seconds}
    return LimmsPlan(
        name=loaded.name,
        title=loaded.spec.title,
        method=making.method,
        status="feasible",
        motion=motion,
        anchor_names=scene.anchor_names,
        anchor_normal=np.vstack([*([SIDE_NORMALS] * scene.boxes), scene.wall_normal]),
        box_size=scene.box_size,
        box_mass=scene.box_mass,
        goal=goal,
        arrival_speed=scene.arrival_speed,
        friction=scene.friction,
        solids=scene.solids,
        module=scene.module.model_dump(mode="json"),
        module_text=loaded.module_text,
        module_names=scene.module_names,
        stages=stages,
        sequence=making.sequence,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        objective=float(np.linalg.norm(motion.box_position[-1, 0] - scene.goal)),
        timings={key: round(value, 4) for key, value in seconds.items()},
        solvers=making.solvers,
        sizes={
            "modules": scene.count,
            **making.sizes,
            "programs": attempts.programs,
            "variables": attempts.variables,
            "constraints": attempts.constraints,
        },
        warnings=_warnings(scene, motion),
        convergence=making.convergence,
    )


def _warnings(scene: Scene, motion: Motion) -> tuple[str, ...]:
    """What the model leaves out and the real thing would feel."""
    weight = scene.module.mass * GRAVITY
    found = []
    if weight > scene.module.max_force:
        text = f"the motion leaves out the modules' own dynamics: a module weighs {weight:.1f} N"
        if weight > 2 * scene.module.max_force:
            text += f", twice what a contact is said to hold ({scene.module.max_force:.0f} N)"
        found.append(text)
    for m, name in enumerate(scene.module_names):
        ends = np.stack([motion.base_anchor[:, m], motion.tip_anchor[:, m]], axis=-1)
        on_box = ((ends >= 0) & (ends < scene.wall_offset)).any(axis=-1)
        alone = on_box & (motion.mode[:, m] == DRIVES) & (motion.ground_end[:, m] < 0)
        if alone.any():
            found.append(
                f"for a while nothing but the standing box holds module {name}: whether a box of "
                f"{scene.weight:.1f} N tips under {weight:.1f} N is not looked at"
            )
    return tuple(found)
