"""What is uncertain about robot and terrain, and worlds drawn from it.

A world is a function of a vector of independent standard normal numbers: of plain draws, of those
that importance sampling shifts, and of chains of subset simulation alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any
from zlib import crc32

import numpy as np
from scipy.special import ndtr

from climbplan.arrays import Array
from climbplan.climb.plan.climb_plan import ClimbPlan
from climbplan.climb.simulation.worlds.world import nominal_world
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.world import World

_LEAST = {"mass": 0.1, "stiffness": 0.1, "gain": 0.1, "friction": 0.02}  # of factors
_SALT = 0x636C696D62  # keeps worlds apart from other draws of the same seed


@dataclass(frozen=True)
class Spread:
    """A quantity's distribution about its nominal value, SI units."""

    kind: str  # "normal" or "uniform"
    low: float  # of normal: the mean; of uniform: its lower end
    high: float  # of normal: the standard deviation; of uniform: its upper end

    @property
    def exact(self) -> bool:
        """Whether nothing is uncertain."""
        return self.low == 0.0 and self.high == 0.0

    def of(self, normal: Array) -> Array:
        """Values for standard normal numbers."""
        if self.kind == "normal":
            return np.asarray(self.low + self.high * normal)
        return np.asarray(self.low + (self.high - self.low) * ndtr(normal))


EXACT = Spread("normal", 0.0, 0.0)


@dataclass(frozen=True)
class Uncertainty:
    """Distributions of what makes a world; of factors, about 1."""

    mass: Spread = EXACT
    com: Spread = EXACT  # [m], each axis
    stiffness: Spread = EXACT  # each joint
    gain: Spread = EXACT
    friction: Spread = EXACT  # each surface
    surface: Spread = EXACT  # [m], each surface
    tilt: Spread = EXACT  # [rad], each surface, two axes
    backlash: Spread = EXACT  # [rad], each joint
    placement: Spread = EXACT  # [m], each foothold, three axes

    @property
    def names(self) -> tuple[str, ...]:
        """Quantities that are not exact."""
        return tuple(f.name for f in fields(self) if not getattr(self, f.name).exact)


@dataclass(frozen=True)
class Layout:
    """Which of the numbers make which quantity."""

    uncertainty: Uncertainty
    nominal: World

    @property
    def parts(self) -> Iterator[tuple[str, slice]]:
        """Uncertain quantities and their places."""
        at = 0
        for name in self.uncertainty.names:
            size = int(np.size(getattr(self.nominal, name)))
            yield name, slice(at, at + size)
            at += size

    @property
    def size(self) -> int:
        """D, how many numbers make a world."""
        return max((part.stop for _, part in self.parts), default=0)

    def world(self, numbers: Array) -> World:
        """The world of D standard normal numbers."""
        changed: dict[str, Any] = {}
        for name, part in self.parts:
            nominal = getattr(self.nominal, name)
            value = nominal + getattr(self.uncertainty, name).of(numbers[part]).reshape(
                np.shape(nominal)
            )
            least = _LEAST.get(name, 0.0 if name == "backlash" else -np.inf)
            value = np.maximum(value, least)
            changed[name] = float(value) if np.ndim(nominal) == 0 else value
        return replace(self.nominal, **changed)


def layout_of(plan: ClimbPlan, uncertainty: Uncertainty) -> Layout:
    """How worlds of a plan are made."""
    return Layout(uncertainty, nominal_world(plan))


def conditions_of(base: Conditions, layout: Layout, numbers: Array) -> Conditions:
    """Conditions in the world of D standard normal numbers, whose sensors err as in no other."""
    noise = crc32(np.ascontiguousarray(numbers, "<f8").tobytes(), base.noise_seed % 2**32)
    return replace(base, world=layout.world(numbers), noise_seed=noise)


def numbers_of(seed: int, index: int, size: int) -> Array:
    """(D,) standard normal numbers of one world: a function of seed and index alone."""
    return np.random.default_rng([_SALT, seed, index]).standard_normal(size)
