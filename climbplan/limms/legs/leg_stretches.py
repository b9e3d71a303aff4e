"""A quadruped's solution as stretches of a plan, with exact forces between the knots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climbplan.arrays import Array
from climbplan.limms.legs.leg_phases import LegTrajectory
from climbplan.limms.legs.motion import compute_leg_motion
from climbplan.limms.motion.timeline import NOWHERE, QUADRUPED, PartialPlan
from climbplan.limms.scene.limms_scene import GRAVITY, FramePoses, ModuleScene
from climbplan.limms.scene.phases import SupportModule

NUM_PROJECTIONS = 60  # alternating projections onto cones and balance
CONE_FRACTION = 0.985  # of friction; the program uses less
FORCE_FRACTION = 0.995  # of the force limit
MIN_LOAD_FRACTION = 0.005  # of the weight on a standing foot


def add_leg_trajectories(
    partial_plan: PartialPlan, limbs: Sequence[SupportModule], trajectories: Sequence[LegTrajectory]
) -> None:
    """Add the phases of a quadruped's solution to a plan."""
    modules = [limb.module for limb in limbs]
    for trajectory in trajectories:
        motion = compute_leg_motion(
            partial_plan.scene, limbs, trajectory, partial_plan.angles[modules]
        )
        partial_plan.box_mode = QUADRUPED
        stretch = partial_plan.build_rest(trajectory.phase.name, motion.time)
        for target, values in zip(
            (stretch.box, stretch.velocity, stretch.acceleration), motion.box, strict=True
        ):
            target[:] = values
        force = compute_foot_forces(
            partial_plan.scene,
            trajectory,
            motion.time,
            motion.box.position,
            motion.box.acceleration,
        )
        for i, limb in enumerate(limbs):
            base = FramePoses(motion.feet[:, i], motion.points[i].rotation[:, 0])
            stretch.place(limb.module, base, motion.angles[:, i], motion.rates[:, i])
            stretch.grounded[limb.module] = NOWHERE if i in trajectory.phase.swing else 0
            stretch.force[:, limb.side] = force[:, i]
        partial_plan.add(stretch)


def compute_foot_forces(
    scene: ModuleScene, trajectory: LegTrajectory, time: Array, box: Array, acceleration: Array
) -> Array:
    """Return forces (n, L, 3) between the knots [N].

    Linear interpolations are projected alternately onto friction cones and onto the balance of
    forces and moments.
    """
    num_limbs = trajectory.force.shape[1]
    knots = np.linspace(0, trajectory.duration, len(trajectory.force))
    force = np.stack(
        [
            np.interp(time, knots, trajectory.force[:, i, axis])
            for i in range(num_limbs)
            for axis in range(3)
        ],
        axis=-1,
    )
    standing = [i for i in range(num_limbs) if i not in trajectory.phase.swing]
    if not standing:
        return np.zeros((len(time), num_limbs, 3))
    balance = np.zeros((len(time), 6, 3 * num_limbs))
    for i in standing:
        x, y, z = np.moveaxis(trajectory.before[i] - box, -1, 0)
        zero = np.zeros_like(x)
        balance[:, :3, 3 * i : 3 * i + 3] = np.eye(3)
        cross = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
        balance[:, 3:, 3 * i : 3 * i + 3] = np.stack([np.stack(r, -1) for r in cross], -2)
    needed = np.zeros((len(time), 6))
    needed[:, :3] = scene.box_mass[0] * (acceleration + np.array([0, 0, GRAVITY]))
    inverse = np.linalg.pinv(balance)
    for _ in range(NUM_PROJECTIONS):
        force = _project_to_cones(scene, force.reshape(-1, num_limbs, 3), standing).reshape(
            -1, 3 * num_limbs
        )
        residual = needed - (balance @ force[..., None])[..., 0]
        force = force + (inverse @ residual[..., None])[..., 0]
    return force.reshape(-1, num_limbs, 3)


def _project_to_cones(scene: ModuleScene, force: Array, standing: Sequence[int]) -> Array:
    """Return forces (n, L, 3) within cones and limits slightly tighter than the checked ones."""
    force = force.copy()
    for i in standing:
        foot_force = force[:, i]
        foot_force[:, 2] = np.maximum(foot_force[:, 2], MIN_LOAD_FRACTION * scene.weight)
        tangential = np.hypot(foot_force[:, 0], foot_force[:, 1])
        max_tangential = CONE_FRACTION * scene.friction * foot_force[:, 2]
        foot_force[:, :2] *= np.minimum(1.0, max_tangential / np.maximum(tangential, 1e-12))[
            :, None
        ]
        magnitude = np.linalg.norm(foot_force, axis=1)
        foot_force *= np.minimum(1.0, FORCE_FRACTION * scene.module.max_force / magnitude)[:, None]
    return force
