"""What swinging a leg takes of its own motors, by its links' masses: inverse dynamics of one leg.

A body without legs' masses knows nothing of it: its plans let legs swing as fast as joints turn.
"""

from __future__ import annotations

import numpy as np

from climbplan.arrays import Array
from climbplan.robots.urdf.pinocchio_model import UrdfModel
from climbplan.robots.walking_legs import WalkingLegs
from climbplan.walking.plan.swing_way import along, arch

_PARTS = 48  # of a swing
_ENDS = 3  # of them that differences of differences spoil


def swing_effort(
    found: UrdfModel, legs: WalkingLegs, speed: float, step: float, lift: float, stance: int
) -> float:
    """Largest share of a torque limit that a swing of `step` [s] takes, the body moving evenly.

    speed: of the body ahead [m/s]; lift [m]; stance: steps that a leg stands between two swings, by
    halves before and behind where it stands at rest. Infinite where legs do not reach along it.
    """
    share = np.linspace(0.0, 1.0, _PARTS + 1)
    chain, part = legs.chain, step / _PARTS
    spots = np.repeat(chain.joint_points(chain.posture)[None, :, -1], len(share), axis=0)
    ahead = (stance + 1) * along(share)[0] - 0.5 * stance - share
    spots[..., 0] += (speed * step * ahead)[:, None]
    spots[..., 2] += (lift * arch(share)[0])[:, None]
    solution = legs.chain.inverse(spots, legs.lower, legs.upper)
    angles = solution.angles[..., 0, :, :]
    if not np.isfinite(angles).all() or not (solution.missing[..., 0, :] < 1e-3).all():
        return np.inf
    turned = (chain.drives @ angles[..., None])[..., 0]  # (K, L, J) joints that follow others, too
    rate = np.gradient(turned, part, axis=0)
    change = np.gradient(rate, part, axis=0)
    worst = 0.0
    for leg in range(len(chain.names)):
        for k in range(_ENDS, len(share) - _ENDS):
            torque = _torques(found, legs, leg, turned[k], rate[k], change[k])
            own = np.where(legs.there[leg], np.abs(chain.drives[leg].T @ torque), 0.0)
            worst = max(worst, float((own / legs.max_torque[leg]).max()))
    return worst


def _torques(
    found: UrdfModel, legs: WalkingLegs, leg: int, turned: Array, rate: Array, change: Array
) -> Array:
    """(J,) of one leg at motions (L, J), all else at rest where it stands, the body upright."""
    pin, model, chain = found.library, found.model, legs.chain
    rest = (chain.drives @ chain.posture[..., None])[..., 0]
    rest[leg] = turned[leg]
    angles = {
        name: float(angle)
        for names, row in zip(chain.names, rest, strict=True)
        for name, angle in zip(names, row, strict=True)
        if name
    }
    speed, faster = np.zeros(model.nv), np.zeros(model.nv)
    gravity = np.array(model.gravity.linear)
    up = found.root_to_base_rotation.T @ [0.0, 0.0, float(np.linalg.norm(gravity))]
    faster[:3] = up + gravity  # the model's own points down along the root's z
    at = np.full(len(chain.names[leg]), -1)
    for j, name in enumerate(chain.names[leg]):
        if name:
            at[j] = int(model.idx_vs[model.getJointId(name)])
            speed[at[j]], faster[at[j]] = rate[leg, j], change[leg, j]
    torque = np.array(pin.rnea(model, model.createData(), found.build_configuration(angles), speed, faster))
    result: Array = np.where(at >= 0, torque[at], 0.0)
    return result
