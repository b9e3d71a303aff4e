"""Which envelope a climb is planned with."""

from __future__ import annotations

import numpy as np

from climbplan.climb.scene import ClimbScene
from climbplan.coupled.legs import POSITION_SCALE
from climbplan.learning.envelope_box import Envelope

_TOE = 0.35  # [m] a toe's range about its stance along each axis
_PRESSURE = 1.0  # [weights]
_SHEAR = 0.3
_LEAST_LOAD = 0.04  # [weights] upward force that each limb carries at least
_MOST_LOAD = 0.5


def braced_envelope(scene: ClimbScene) -> Envelope:
    """The expert's bounds for a robot between walls, each limb carrying some of the weight.

    What a limb carries keeps toes off places that hold nothing.
    """
    robot = scene.robot
    stance = robot.stance_body / POSITION_SCALE
    reach = _TOE / POSITION_SCALE
    force = np.array([_PRESSURE, _SHEAR, 0.0])
    low, high = np.tile(-force, (len(stance), 1)), np.tile(force, (len(stance), 1))
    low[:, 2], high[:, 2] = _LEAST_LOAD, _MOST_LOAD
    return Envelope(np.hstack([stance - reach, low]), np.hstack([stance + reach, high]))
