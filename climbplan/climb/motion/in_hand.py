"""Forces at instants and the motion between them, within torque limits all the way.

Instants may use up what motors have. Between two of them forces go straight but joints turn on
curves, and a torque may pass its limit there. Then forces are planned again with a larger S_tau, by
what the motion lacked, where there are such forces.
"""

from __future__ import annotations

from dataclasses import replace

from climbplan.arrays import Array
from climbplan.climb.forces.planner import plan_forces
from climbplan.climb.motion.trajectory import play
from climbplan.climb.plan.climb_plan import Forces, Instants, Rounds, Trajectory
from climbplan.climb.scene.climb_scene import MotionScene
from climbplan.errors import NoPlanFound

_AGAIN = 3  # times forces are planned, at most
_MORE = 1.01  # times what the motion lacked


def in_hand(
    scene: MotionScene,
    rounds: Rounds,
    instants: Instants,
    forces: Forces,
    swings: tuple[Array, ...] | None = None,
) -> tuple[Forces, Trajectory]:
    """Forces and their motion, those given unless motors lack torque on the way.

    swings: as of `play`, which says what is raised; what cannot be planned with more in hand stays
    as it was, and its check tells.
    """
    played = play(scene, rounds, instants, forces, swings)
    tighter = scene
    for _ in range(_AGAIN):
        if played.use <= 1.0:
            break
        tighter = _with_safety(tighter, _MORE * played.use)
        try:
            again = plan_forces(tighter, instants)
            other = play(tighter, rounds, instants, again, swings)
        except NoPlanFound:
            break
        if other.use < played.use:
            forces, played = again, other
    return forces, played.trajectory


def _with_safety(scene: MotionScene, factor: float) -> MotionScene:
    """The scene that asks for so many times the S_tau."""
    force = scene.spec.force
    force = force.model_copy(update={"safety_torque": factor * force.safety_torque})
    return replace(scene, spec=scene.spec.model_copy(update={"force": force}))
