"""A quadruped's answer as stretches of a plan, its forces made exact between the knots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.motion import leg_motion
from climbplan.limms.legs.statement import LegTrace
from climbplan.limms.motion.timeline import NOWHERE, QUADRUPED, PartialPlan
from climbplan.limms.scene.limms_scene import GRAVITY, Pose, Scene
from climbplan.limms.scene.phases import Limb

PROJECTIONS = 60  # onto cones and balance in turn
CONE = 0.985  # of friction; what the program uses is less
LIMIT = 0.995  # of the largest force
LEAST = 0.005  # of the weight on a foot that stands


def add_leg_traces(world: PartialPlan, limbs: Sequence[Limb], traces: Sequence[LegTrace]) -> None:
    """Add the phases of a quadruped's answer to a plan."""
    modules = [limb.module for limb in limbs]
    for trace in traces:
        motion = leg_motion(world.scene, limbs, trace, world.angles[modules])
        world.box_mode = QUADRUPED
        stretch = world.rest(trace.phase.name, motion.time)
        for own, values in zip(
            (stretch.box, stretch.velocity, stretch.acceleration), motion.box, strict=True
        ):
            own[:] = values
        force = foot_forces(
            world.scene, trace, motion.time, motion.box.position, motion.box.acceleration
        )
        for i, limb in enumerate(limbs):
            base = Pose(motion.feet[:, i], motion.points[i].rotation[:, 0])
            stretch.place(limb.module, base, motion.angles[:, i], motion.rates[:, i])
            stretch.grounded[limb.module] = NOWHERE if i in trace.phase.swing else 0
            stretch.force[:, limb.side] = force[:, i]
        world.add(stretch)


def foot_forces(
    scene: Scene, trace: LegTrace, time: Array, box: Array, acceleration: Array
) -> Array:
    """Forces (n, L, 3) between the knots: straight lines, brought into exact balance of
    forces and moments, and into their cones."""
    n = trace.force.shape[1]
    knots = np.linspace(0, trace.duration, len(trace.force))
    force = np.stack(
        [np.interp(time, knots, trace.force[:, i, axis]) for i in range(n) for axis in range(3)],
        axis=-1,
    )
    standing = [i for i in range(n) if i not in trace.phase.swing]
    if not standing:
        return np.zeros((len(time), n, 3))
    balance = np.zeros((len(time), 6, 3 * n))
    for i in standing:
        x, y, z = np.moveaxis(trace.before[i] - box, -1, 0)
        zero = np.zeros_like(x)
        balance[:, :3, 3 * i : 3 * i + 3] = np.eye(3)
        cross = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
        balance[:, 3:, 3 * i : 3 * i + 3] = np.stack([np.stack(r, -1) for r in cross], -2)
    needed = np.zeros((len(time), 6))
    needed[:, :3] = scene.box_mass[0] * (acceleration + np.array([0, 0, GRAVITY]))
    inverse = np.linalg.pinv(balance)
    for _ in range(PROJECTIONS):
        force = _within(scene, force.reshape(-1, n, 3), standing).reshape(-1, 3 * n)
        left = needed - (balance @ force[..., None])[..., 0]
        force = force + (inverse @ left[..., None])[..., 0]
    return force.reshape(-1, n, 3)


def _within(scene: Scene, force: Array, standing: Sequence[int]) -> Array:
    """Forces (n, L, 3) brought into cones and limits a little tighter than the checked ones."""
    force = force.copy()
    for i in standing:
        f = force[:, i]
        f[:, 2] = np.maximum(f[:, 2], LEAST * scene.weight)
        flat = np.hypot(f[:, 0], f[:, 1])
        most = CONE * scene.friction * f[:, 2]
        f[:, :2] *= np.minimum(1.0, most / np.maximum(flat, 1e-12))[:, None]
        size = np.linalg.norm(f, axis=1)
        f *= np.minimum(1.0, LIMIT * scene.module.max_force / size)[:, None]
    return force
