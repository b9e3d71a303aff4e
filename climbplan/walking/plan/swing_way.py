"""The way of a swinging toe as plans mean it, by the share of its time: from rest to rest.

Straight from where the toe stood to where it will stand, and up and down above that: what joint
speeds are judged on, what a whole robot is simulated with, and what is exported. Where a foot would
run into a riser on its way it goes up alone at first, or down alone at last, for as long as it
takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from climbplan.arrays import Array
from climbplan.walking.task.ground import Ground

_HELD_BACK = (0.0, 0.1, 0.2, 0.3)  # shares of a swing in which a toe goes up or down alone
_GLANCES = 33  # at a way, for what it has to clear
_BESIDE = 0.003  # [m] that feet may be nearer to what is higher than they are thick
_LEVEL, _UP = np.array([1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])

Share = TypeVar("Share", float, Array)


def along(s: Share) -> tuple[Share, Share, Share]:
    """From 0 to 1, at rest and without acceleration at both ends; with both derivatives by s."""
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2,
        60 * s * (1 - s) * (1 - 2 * s),
    )


def arch(s: Share) -> tuple[Share, Share, Share]:
    """From 0 up to 1 and back to 0, at rest at both ends; with both derivatives by s."""
    return (
        16 * s**2 * (1 - s) ** 2,
        32 * s * (1 - s) * (1 - 2 * s),
        32 * (1 - 6 * s + 6 * s**2),
    )


@dataclass(frozen=True)
class SwingWay:
    """A toe's way from where it stood to where it lands."""

    left: Array  # (3,) [m]
    lands: Array  # (3,) [m]
    top: float  # of its middle above that of the straight line [m]
    first: float = 0.0  # share of the swing in which it goes up alone
    last: float = 0.0  # share in which it goes down alone

    def at(self, share: float) -> tuple[Array, Array, Array]:
        """Place (3,) at a share of the time, with both derivatives by that share."""
        rate = 1.0 / (1.0 - self.first - self.last)
        part, speed, more = along(float(np.clip(rate * (share - self.first), 0.0, 1.0)))
        upward, climbing, faster = along(share)
        up, rising, bent = arch(share)
        level, rise = _LEVEL * (self.lands - self.left), float(self.lands[2] - self.left[2])
        return (
            self.left + part * level + (upward * rise + up * self.top) * _UP,
            rate * speed * level + (climbing * rise + rising * self.top) * _UP,
            rate**2 * more * level + (faster * rise + bent * self.top) * _UP,
        )


def held_back(
    ground: Ground, left: Array, lands: Array, top: float, foot: float
) -> tuple[float, float]:
    """Return shares of a swing, first and last, in which its toe goes up or down alone.

    The least with which it is above all ground that its foot passes; the largest if none is.

    Args:
        ground: The planes that toes stand on.
        left: (3,) where the toe stood [m].
        lands: (3,) where it lands [m].
        top: How far the middle of its way is above that of the straight line [m].
        foot: Radius of the foot [m], 0 of a point.
    """
    if ground.count == 1:
        return 0.0, 0.0
    share = np.linspace(0.0, 1.0, _GLANCES)
    height = left[2] + along(share)[0] * (lands[2] - left[2]) + arch(share)[0] * top
    every = np.arange(ground.count)
    found = [_HELD_BACK[-1], _HELD_BACK[-1]]
    for end, half in enumerate((share <= 0.5, share >= 0.5)):
        for alone in _HELD_BACK:
            first, last = (alone, 0.0) if end == 0 else (0.0, alone)
            part = along(np.clip((share[half] - first) / (1.0 - first - last), 0.0, 1.0))[0]
            spots = left[:2] + part[:, None] * (lands - left)[:2]
            off = ground.outside(every, spots[:, None])  # (K, S)
            level = ground.level_at(every, spots[:, None])
            beneath = np.where(off < foot - _BESIDE, level, -np.inf).max(axis=1)
            if (height[half] >= beneath - _BESIDE).all():
                found[end] = alone
                break
    return found[0], found[1]
