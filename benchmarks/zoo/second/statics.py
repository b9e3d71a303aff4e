"""Statics of all links in one posture: the least share of its torque limits that a robot needs.

    minimise    s
    such that   sum of J_i' f_i = g(q)          in the six coordinates of the free base
                |g(q) - sum of J_i' f_i| <= s tau      in those of the limbs' joints
                f_i in a pyramid round the friction cone of toe i

with Pinocchio's gravity g(q) of every link and the Jacobians J_i of toes: a linear program. The
pyramids hold the cones, so that a posture for which there are no forces has none in cones. How far
it is from having some is the least force and moment on the base that would have to be added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from benchmarks.zoo.second.stances import Limbs, Stance, Surface
from climbplan.arrays import Array

_FACETS = 16
_COSTLY = 1e3  # of what is added, beside the share
_NONE = 1e-6  # of the weight, and the weight times 1 m
_HELPLESS = 10.0  # `rank` of postures without forces begins there


@dataclass(frozen=True)
class Load:
    """What a posture asks of its motors."""

    share: float  # of the torque limits; infinite where no forces hold the robot
    joint: str = ""  # that needs the largest share
    torque: float = 0.0  # of it [N m]
    limit: float = 0.0
    added: float = 0.0  # force and moment without which nothing holds [weight, weight times 1 m]

    @property
    def rank(self) -> float:
        """The share where forces hold the robot; beyond 10 how far it is from that."""
        return self.share if np.isfinite(self.share) else _HELPLESS + self.added


def least_load(
    limbs: Limbs,
    surfaces: tuple[Surface, ...],
    stance: Stance,
    standing: tuple[int, ...],
    mu: float,
) -> Load:
    """The load of a stance in which some limbs are standing, with friction `mu`."""
    pin, model = limbs.found.library, limbs.model
    q = limbs.placed(stance.turn, stance.angles, stance.at)
    gravity = np.array(pin.computeGeneralizedGravity(model, limbs.data, q))
    limbs.placed(stance.turn, stance.angles, stance.at)
    jacobians = [limbs.toe(limb)[1] for limb in standing]
    weight = float(pin.computeTotalMass(model)) * 9.81
    size = 3 * len(standing) + 1
    gathered = np.hstack([j.T for j in jacobians]) * weight  # (nv, 3 n) by units of weight
    columns = np.concatenate(limbs.columns)
    torque = np.concatenate(limbs.torque)
    push = gathered[columns] / torque[:, None]
    own = gravity[columns] / torque
    rows = [
        np.hstack([-push, -np.ones((len(columns), 1))]),
        np.hstack([push, -np.ones((len(columns), 1))]),
    ]
    ends = [-own, own]
    for number, limb in enumerate(standing):
        cone = np.zeros((_FACETS, size))
        cone[:, 3 * number : 3 * number + 3] = _pyramid(surfaces[limb], mu)
        rows.append(cone)
        ends.append(np.zeros(_FACETS))
    equal = np.hstack([gathered[:6] / weight, np.zeros((6, 1)), np.eye(6), -np.eye(6)])
    cost = np.concatenate([np.zeros(size - 1), [1.0], np.full(12, _COSTLY)])
    bounds = [(None, None)] * (size - 1) + [(0.0, None)] * 13
    limits = np.hstack([np.vstack(rows), np.zeros((sum(map(len, rows)), 12))])
    found = linprog(cost, limits, np.concatenate(ends), equal, gravity[:6] / weight, bounds)
    if found.status != 0:
        return Load(np.inf, added=np.inf)
    if (added := float(found.x[size:].sum())) > _NONE:
        return Load(np.inf, added=added)
    needed = np.abs(own - push @ found.x[: size - 1])
    worst = int(np.argmax(needed))
    names = [joint.name for joints in limbs.joints for joint in joints]
    return Load(
        float(found.x[size - 1]),
        names[worst],
        float(needed[worst] * torque[worst]),
        float(torque[worst]),
    )


def _pyramid(surface: Surface, mu: float) -> Array:
    """Rows (F, 3) that forces in a pyramid round the cone keep below zero."""
    normal = np.zeros(3)
    normal[surface.axis] = 1.0 if surface.axis == 2 else -surface.side
    first, second = (axis for axis in range(3) if axis != surface.axis)
    angle = 2 * np.pi * np.arange(_FACETS) / _FACETS
    around = np.zeros((_FACETS, 3))
    around[:, first], around[:, second] = np.cos(angle), np.sin(angle)
    return around - mu * normal
