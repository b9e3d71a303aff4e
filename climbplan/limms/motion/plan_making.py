"""Conversion of a finished sequence of stretches into a plan, for every method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from climbplan.arrays import Array, IntArray
from climbplan.limms.budget.search_budget import SearchBudget
from climbplan.limms.modules.chain import forward
from climbplan.limms.motion.timeline import DRIVES, PartialPlan, Stretch
from climbplan.limms.plan.convergence import Convergence
from climbplan.limms.plan.limms_plan import LimmsPlan, ModuleMotion
from climbplan.limms.scene.limms_scene import GRAVITY, SIDE_NORMALS, FramePoses, ModuleScene, Points
from climbplan.limms.scene.placement import rotate_to_world
from climbplan.limms.schema.loading import LoadedLimms


@dataclass(frozen=True)
class PlanRecord:
    """How a plan was found."""

    method: str
    sequence: str  # modes in words
    seconds: dict[str, float]
    sizes: dict[str, Any]
    solvers: dict[str, str]
    convergence: Convergence | None = None


def make_plan(
    loaded: LoadedLimms,
    scene: ModuleScene,
    partial_plan: PartialPlan,
    budget: SearchBudget,
    record: PlanRecord,
) -> LimmsPlan:
    """Build the plan, without the lines of its summary."""
    motion, stages = build_motion(
        partial_plan.stretches, scene.module, scene.wall_position, scene.box_size
    )
    work = budget.work
    seconds = record.seconds | {"build": work.build_seconds, "solve": work.seconds}
    cut_short = budget.is_expired
    return LimmsPlan(
        name=loaded.name,
        title=loaded.spec.title,
        method=record.method,
        status="limit" if cut_short else "feasible",
        motion=motion,
        anchor_names=scene.anchor_names,
        anchor_normal=np.vstack([*([SIDE_NORMALS] * scene.num_boxes), scene.wall_normal]),
        box_size=scene.box_size,
        box_mass=scene.box_mass,
        goal=scene.goals,
        goal_yaw=scene.goal_yaws,
        arrival_speed=scene.arrival_speed,
        friction=scene.friction,
        solids=scene.solids,
        module=scene.module.model_dump(mode="json"),
        module_text=loaded.module_text,
        module_names=scene.module_names,
        massless=scene.massless,
        stages=stages,
        sequence=record.sequence,
        spec_text=loaded.text,
        spec_sha256=loaded.sha256,
        seed=loaded.spec.seed,
        objective=float(np.linalg.norm(motion.box_position[-1] - scene.goals, axis=1).max()),
        timings={key: round(value, 4) for key, value in seconds.items()},
        solvers=record.solvers,
        sizes={
            "modules": scene.num_modules,
            **record.sizes,
            "programs": work.programs,
            "ipopt_iterations": work.iterations,
            "variables": budget.variables,
            "constraints": budget.constraints,
        },
        warnings=((cut_short_warning(budget.time_limit),) if cut_short else ())
        + _warnings(scene, motion),
        convergence=record.convergence,
    )


def cut_short_warning(limit: float) -> str:
    """Return the warning that the time limit [s] ended the search."""
    return (
        f"`solver.time_limit` ({limit:g} s) ended the search: with more time it may end elsewhere"
    )


def _warnings(scene: ModuleScene, motion: ModuleMotion) -> tuple[str, ...]:
    """Return warnings about effects that the model neglects."""
    weight = scene.module.mass * GRAVITY
    warnings = []
    if scene.massless and weight > scene.module.max_force:
        text = f"the motion leaves out the modules' own dynamics: a module weighs {weight:.1f} N"
        if weight > 2 * scene.module.max_force:
            text += f", twice what a contact is said to hold ({scene.module.max_force:.0f} N)"
        warnings.append(text)
    for m, name in enumerate(scene.module_names):
        ends = np.stack([motion.base_anchor[:, m], motion.tip_anchor[:, m]], axis=-1)
        on_box = ((ends >= 0) & (ends < scene.wall_offset)).any(axis=-1)
        alone = on_box & (motion.mode[:, m] == DRIVES) & (motion.ground_end[:, m] < 0)
        if scene.massless and alone.any():
            warnings.append(
                f"for a while nothing but the standing box holds module {name}: whether a box of "
                f"{scene.weight:.1f} N tips under {weight:.1f} N is not looked at"
            )
    return tuple(warnings)


def build_motion(
    stretches: Sequence[Stretch],
    module: Any,
    wall_position: Array,
    box_size: Array,
) -> tuple[ModuleMotion, tuple[tuple[str, float, float], ...]]:
    """Join stretches into one motion, and return it with the times of each.

    All boxes rest except the one that a stretch moves.
    """
    starts = np.concatenate([[0.0], np.cumsum([s.time[-1] for s in stretches])])
    joined: dict[str, list[Any]] = {key: [] for key in ModuleMotion.__annotations__}
    for stretch, start in zip(stretches, starts[:-1], strict=True):
        arrays = _build_arrays(stretch, module, wall_position, box_size)
        arrays["time"] = start + stretch.time
        for key, value in arrays.items():
            joined[key].append(value)
    motion = ModuleMotion(**{key: np.concatenate(values) for key, values in joined.items()})
    return motion, _list_stages(stretches, starts)


def _build_arrays(
    stretch: Stretch, module: Any, wall_position: Array, box_size: Array
) -> dict[str, Any]:
    """Return the arrays of a motion but its times, by name, for one stretch."""
    n, boxes = len(stretch.time), len(box_size)
    base = FramePoses(stretch.base_position, stretch.base_rotation)
    points: Points = forward(module, base, stretch.angles)
    order = list(stretch.box_number)
    moved_box = order[0]
    box = np.empty((n, boxes, 3))
    box[:, order] = np.concatenate(
        [stretch.box[:, None], np.tile(stretch.other_positions, (n, 1, 1))], axis=1
    )
    turning = np.zeros((n, boxes, 3))
    turning[:, order, 0] = np.concatenate(
        [stretch.turning[:, :1], np.tile(stretch.other_yaws, (n, 1))], axis=1
    )
    turning[:, moved_box] = stretch.turning
    velocity, acceleration = np.zeros((n, boxes, 3)), np.zeros((n, boxes, 3))
    velocity[:, moved_box], acceleration[:, moved_box] = stretch.velocity, stretch.acceleration
    box_mode = np.ones((n, boxes), int)
    box_mode[:, moved_box] = stretch.box_mode
    force = np.zeros((n, boxes, 4, 3))
    force[:, moved_box] = stretch.force
    offsets = SIDE_NORMALS[None] * box_size[:, None] / 2  # (B, 4, 3)
    offsets = rotate_to_world(turning[:, :, :1], offsets[None])  # (n, B, 4, 3)
    on_boxes = (box[:, :, None] + offsets).reshape(n, -1, 3)
    return {
        "box_position": box,
        "box_velocity": velocity,
        "box_acceleration": acceleration,
        "box_yaw": turning[..., 0],
        "box_yaw_rate": turning[..., 1],
        "box_yaw_acceleration": turning[..., 2],
        "box_mode": box_mode,
        "joint_position": points.position,
        "joint_rotation": points.rotation,
        "joint_angles": stretch.angles,
        "joint_velocity": stretch.rates,
        "mode": np.tile(stretch.mode, (n, 1)),
        "base_anchor": np.tile(_renumber_anchors(stretch.base_anchor, order), (n, 1)),
        "tip_anchor": np.tile(_renumber_anchors(stretch.tip_anchor, order), (n, 1)),
        "ground_end": np.tile(stretch.grounded, (n, 1)),
        "anchor_position": np.concatenate([on_boxes, np.tile(wall_position, (n, 1, 1))], axis=1),
        "force": force,
    }


def _list_stages(
    stretches: Sequence[Stretch], starts: Array
) -> tuple[tuple[str, float, float], ...]:
    """Return names and times of stages; equal names in sequence are one stage."""
    stages: list[tuple[str, float, float]] = []
    for stretch, start, end in zip(stretches, starts[:-1], starts[1:], strict=True):
        if stages and stages[-1][0] == stretch.name:
            stages[-1] = (stretch.name, stages[-1][1], float(end))
        else:
            stages.append((stretch.name, float(start), float(end)))
    return tuple(stages)


def _renumber_anchors(anchors: IntArray, order: Sequence[int]) -> IntArray:
    """Return the anchors of a stretch by the numbers of boxes in the plan."""
    on_box = (anchors >= 0) & (anchors < 4 * len(order))
    numbers = np.array(order)[np.where(on_box, anchors // 4, 0)]
    renumbered: IntArray = np.where(on_box, 4 * numbers + anchors % 4, anchors)
    return renumbered
