"""Keep a torque reserve for the motion between instants.

Instants may use the full torque limits. Between two of them forces are interpolated linearly but
joint angles are not, so a torque may exceed its limit there. Forces are then planned again with
S_tau increased by that excess, if there are such forces.
"""

from __future__ import annotations

from dataclasses import replace

from climbplan.arrays import Array
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.motion.trajectory import build_timed_motion
from climbplan.climb.plan.climb_plan import InstantForces, Instants, Rounds, Trajectory
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import NoPlanFound

_MAX_REPLANS = 3  # of forces
_SAFETY_FACTOR = 1.01  # by the largest torque use of the motion


def plan_with_torque_reserve(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: InstantForces,
    swings: tuple[Array, ...] | None = None,
) -> tuple[InstantForces, Trajectory]:
    """Plan the motion of forces, with other forces if torques exceed their limits on the way.

    If there are no better forces the given ones stay, and the plan's check fails. `swings` and
    exceptions are those of `build_timed_motion`, and of `retime_trajectory` where the spec states
    a pace.
    """
    result = build_timed_motion(scene, rounds, instants, forces, swings)
    tighter = scene
    for _ in range(_MAX_REPLANS):
        if result.torque_use <= 1.0:
            break
        tighter = _scale_safety_factor(tighter, _SAFETY_FACTOR * result.torque_use)
        try:
            forces_again = plan_forces(tighter, instants)
            alternative = build_timed_motion(tighter, rounds, instants, forces_again, swings)
        except NoPlanFound:
            break
        if alternative.torque_use < result.torque_use:
            forces, result = forces_again, alternative
    if scene.spec.trajectory.pace is not None:
        from climbplan.climb.motion.retiming import retime_trajectory

        return forces, retime_trajectory(scene, result)
    return forces, result.trajectory


def _scale_safety_factor(scene: MotionScene, factor: float) -> MotionScene:
    """Return the scene with its required S_tau scaled by a factor."""
    force = scene.spec.force
    force = force.model_copy(update={"safety_torque": factor * force.safety_torque})
    return replace(scene, spec=scene.spec.model_copy(update={"force": force}))
