"""Distributions of uncertain robot and terrain parameters, and worlds sampled from them.

A world is a function of a vector of independent standard normal numbers. Plain Monte Carlo,
importance sampling and the Markov chains of subset simulation use the same function.
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
from climbplan.climb.simulation.worlds.nominal_world import build_nominal_world
from climbplan.simulation.conditions import Conditions
from climbplan.simulation.world import World

_MIN_VALUES = {"mass": 0.1, "stiffness": 0.1, "gain": 0.1, "friction": 0.02}  # of factors
_SALT = 0x636C696D62  # keeps worlds apart from other draws of the same seed


@dataclass(frozen=True)
class Distribution:
    """A quantity's distribution about its nominal value, SI units."""

    kind: str  # "normal" or "uniform"
    low: float  # of normal: the mean; of uniform: its lower end
    high: float  # of normal: the standard deviation; of uniform: its upper end

    @property
    def exact(self) -> bool:
        """Whether the quantity is known exactly."""
        return self.low == 0.0 and self.high == 0.0

    def evaluate(self, normal: Array) -> Array:
        """Map standard normal numbers to values of this distribution."""
        if self.kind == "normal":
            return np.asarray(self.low + self.high * normal)
        return np.asarray(self.low + (self.high - self.low) * ndtr(normal))


EXACT = Distribution("normal", 0.0, 0.0)


@dataclass(frozen=True)
class Uncertainty:
    """Distributions of the parameters of a world, as differences from their nominal values."""

    mass: Distribution = EXACT
    com: Distribution = EXACT  # [m], each axis
    stiffness: Distribution = EXACT  # each joint
    gain: Distribution = EXACT
    friction: Distribution = EXACT  # each surface
    surface: Distribution = EXACT  # [m], each surface
    tilt: Distribution = EXACT  # [rad], each surface, two axes
    backlash: Distribution = EXACT  # [rad], each joint
    placement: Distribution = EXACT  # [m], each foothold, three axes

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities that are uncertain."""
        return tuple(f.name for f in fields(self) if not getattr(self, f.name).exact)


@dataclass(frozen=True)
class ScenarioLayout:
    """The assignment of standard normal numbers to uncertain quantities."""

    uncertainty: Uncertainty
    nominal: World

    @property
    def slices(self) -> Iterator[tuple[str, slice]]:
        """Names of uncertain quantities and their slices of the numbers."""
        start = 0
        for name in self.uncertainty.names:
            size = int(np.size(getattr(self.nominal, name)))
            yield name, slice(start, start + size)
            start += size

    @property
    def size(self) -> int:
        """Number D of standard normal numbers of a world."""
        return max((section.stop for _, section in self.slices), default=0)

    def world(self, numbers: Array) -> World:
        """Build the world of D standard normal numbers."""
        values: dict[str, Any] = {}
        for name, section in self.slices:
            nominal = getattr(self.nominal, name)
            value = nominal + getattr(self.uncertainty, name).evaluate(numbers[section]).reshape(
                np.shape(nominal)
            )
            min_value = _MIN_VALUES.get(name, 0.0 if name == "backlash" else -np.inf)
            value = np.maximum(value, min_value)
            values[name] = float(value) if np.ndim(nominal) == 0 else value
        return replace(self.nominal, **values)


def build_layout(plan: ClimbPlan, uncertainty: Uncertainty) -> ScenarioLayout:
    """Build the layout of a plan's worlds."""
    return ScenarioLayout(uncertainty, build_nominal_world(plan))


def sample_conditions(base: Conditions, layout: ScenarioLayout, numbers: Array) -> Conditions:
    """Build the conditions of the world of D standard normal numbers, with its own sensor noise."""
    noise = crc32(np.ascontiguousarray(numbers, "<f8").tobytes(), base.noise_seed % 2**32)
    return replace(base, world=layout.world(numbers), noise_seed=noise)


def draw_numbers(seed: int, index: int, size: int) -> Array:
    """Draw the standard normal numbers (D,) of one world, a function of seed and index alone."""
    return np.random.default_rng([_SALT, seed, index]).standard_normal(size)
