"""Check that a plan matches its spec: scene and modules are those that the spec defines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from climbplan.errors import SpecError
from climbplan.limms.check.limits import judge
from climbplan.limms.plan.limms_plan import LimmsPlan
from climbplan.limms.scene.limms_scene import SIDE_NORMALS, ModuleScene, build_scene
from climbplan.limms.schema.loading import stored_limms
from climbplan.limms.schema.model import LimmsSpec
from climbplan.limms.schema.module import OF_MASSES
from climbplan.verification.check import Check, mark_not_compared
from climbplan.verification.differences import (
    Difference,
    check_equality,
    compare_recursively,
    select_largest,
)


def check_spec(plan: LimmsPlan) -> Iterator[Check]:
    """Yield checks of the stored scene and modules against those rebuilt from the spec.

    Modules that are neither built in nor carried by the plan are taken from it, with a note.
    """
    try:
        stored = stored_limms(plan.spec_text, plan.module_text, plan.module)
    except SpecError as error:
        yield judge("file.spec_values", np.inf, str(error).splitlines()[0])
        return
    built = stored.loaded.module.model_dump(mode="json")
    if stored.reason:
        note = f"{stored.reason}: the modules are taken from the plan file"
        yield mark_not_compared(judge("robot.spec", 0.0), note, "modules as stored", note)
    else:
        left_out = [name for name in OF_MASSES if plan.massless and name not in plan.module]
        yield _judge_largest(
            "robot.spec", compare_recursively("module", plan.module, built, left_out)
        )
    scene = build_scene(stored.loaded)
    yield _judge_largest("file.spec_values", _compare_values(plan, scene, stored.loaded.spec))


def _compare_values(plan: LimmsPlan, scene: ModuleScene, spec: LimmsSpec) -> Iterator[Difference]:
    """Yield the differences of stored and rebuilt values."""
    motion, offset = plan.motion, scene.wall_offset
    yield check_equality("massless", plan.massless == spec.massless)
    yield check_equality("seed", plan.seed == spec.seed)
    yield check_equality("title", plan.title == spec.title)
    yield check_equality("solver.method", plan.method == spec.solver.method)
    distance = float(np.linalg.norm(motion.box_position[-1] - plan.goal, axis=-1).max())
    yield from compare_recursively("objective", plan.objective, distance)
    same_names = plan.module_names == scene.module_names
    yield check_equality("modules: names", same_names)
    yield check_equality("terrain.anchors: names", plan.anchor_names == scene.anchor_names)
    pairs = {
        "box.size": (plan.box_size, scene.box_size),
        "box.mass": (plan.box_mass, scene.box_mass),
        "box.goal": (plan.goal, scene.goals),
        "box.goal_yaw_deg": (plan.goal_yaw, scene.goal_yaws),
        "box.start": (motion.box_position[0], scene.box_start),
        "box.start_yaw_deg": (motion.box_yaw[0], scene.start_yaws),
        "box.arrival_speed": (plan.arrival_speed, scene.arrival_speed),
        "terrain.friction": (plan.friction, scene.friction),
        "terrain.regions": (plan.solids, scene.solids),
        "terrain.anchors": (motion.anchor_position[0, offset:], scene.wall_position),
        "terrain.anchors: normals": (
            plan.anchor_normal,
            np.vstack([*([SIDE_NORMALS] * scene.num_boxes), scene.wall_normal]),
        ),
    }
    for key, (stored, built) in pairs.items():
        yield from compare_recursively(key, stored, built)
    if same_names:
        first_ends = np.where(
            (scene.start_anchor >= 0)[:, None], _list_anchor_positions(scene), scene.start_position
        )
        yield from compare_recursively("modules", motion.joint_position[0, :, 0], first_ends)


def _list_anchor_positions(scene: ModuleScene) -> np.ndarray:
    """Return where first ends of modules are latched (L, 3); unused values for standing ones."""
    if not scene.num_wall_anchors:
        return scene.start_position
    return scene.wall_position[np.maximum(scene.start_anchor - scene.wall_offset, 0)]


def _judge_largest(name: str, differences: Iterator[Difference]) -> Check:
    """Return the check of the largest difference."""
    worst = select_largest(differences)
    return judge(name, worst.size, f"{worst.key}: {worst.values}" if worst.size > 0 else "")
