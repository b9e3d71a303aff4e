"""D gains and update rates with which joints of a climbing robot settle under their P gains.

A limb in the air is the hardest case for a controller of a fixed rate: it is the lightest thing
that its motors move. Its inertia about each joint, with that of the rotor, gives critical damping,
and the natural frequency that the rate has to be well above.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array

EFFORT_RATE = 500.0  # [Hz] at which P and D gains on torques are computed at least
_STEPS = 4.0  # of a controller within 1 / natural frequency
_ROUND = 100.0  # [Hz]
_MOST_RATE = 2000.0  # [Hz]


def critical_damping(inertia: Array, gain: Array) -> Array:
    """Return D gains of critical damping for P gains.

    Args:
        inertia: (J,) inertia that each joint moves [kg m^2].
        gain: (J,) P gains [N m/rad]; negative ones count as zero.

    Returns:
        (J,) D gains [N m s/rad].
    """
    return np.asarray(2.0 * np.sqrt(inertia * np.maximum(gain, 0.0)))


def update_rate(damping: Array, gain: Array) -> float:
    """Return the rate [Hz] of a controller that computes torques of these gains (J,)."""
    frequency = np.divide(2.0 * gain, damping, out=np.zeros_like(gain), where=damping > 0)
    needed = _STEPS * float(frequency.max(initial=0.0))
    return float(np.clip(_ROUND * np.ceil(needed / _ROUND), EFFORT_RATE, _MOST_RATE))
