"""The families of the benchmark set by name: generators, and sizes of each class.

An instance is its family, class and number. The same name is the same problem at the same seed.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from climbplan.instances.climbing import (
    build_coupled_instance,
    build_force_instance,
    build_posture_instance,
)
from climbplan.instances.free_flyer import build_free_flyer
from climbplan.instances.moving import (
    build_book_instance,
    build_cart_pole_instance,
    build_module_instance,
    build_walk_instance,
)
from climbplan.program.instance import Instance

Level = Literal["easy", "medium", "hard"]
LEVELS: tuple[Level, ...] = get_args(Level)
COUNT = 9  # instances of a family and class: 216 in all


@dataclass(frozen=True)
class Family:
    """One kind of problem."""

    name: str
    what: str
    sizes: tuple[int, int, int]  # of easy, medium and hard instances
    unit: str  # of sizes
    make: Callable[[np.random.Generator, int], Instance]


@dataclass(frozen=True)
class NamedInstance:
    """One instance of the set that has not been generated."""

    family: Family
    level: Level
    number: int

    @property
    def name(self) -> str:
        """Name `family-class-number`, for files and rows."""
        return f"{self.family.name}-{self.level}-{self.number}"

    def generate(self, seed: int) -> Instance:
        """Generate the instance."""
        size = self.family.sizes[LEVELS.index(self.level)]
        key = zlib.crc32(self.family.name.encode())
        rng = np.random.default_rng([seed, key, LEVELS.index(self.level), self.number])
        return self.family.make(rng, size)


FAMILIES: tuple[Family, ...] = (
    Family(
        "postures", "toes on patches, body, rotation", (2, 4, 8), "rounds", build_posture_instance
    ),
    Family("forces", "compliant contact forces", (1, 8, 48), "instants", build_force_instance),
    Family(
        "coupled", "postures with forces, products", (1, 2, 4), "rounds", build_coupled_instance
    ),
    Family(
        "books", "a book into a shelf, products", (2, 3, 5), "stored books", build_book_instance
    ),
    Family("walks", "gait and footholds, relaxed", (3, 5, 9), "knots", build_walk_instance),
    Family(
        "cart-poles", "a pole between soft walls", (5, 10, 20), "steps", build_cart_pole_instance
    ),
    Family(
        "free-flyers",
        "a flyer among 8 rectangles",
        (3, 5, 8),
        "steps",
        lambda rng, size: build_free_flyer(rng, size, 8),
    ),
    Family(
        "modules", "who holds box and wall, and when", (4, 6, 8), "intervals", build_module_instance
    ),
)


def list_instances(count: int = COUNT) -> list[NamedInstance]:
    """List all instances: `count` of each family and class, family by family."""
    return [
        NamedInstance(family, level, number)
        for family in FAMILIES
        for level in LEVELS
        for number in range(count)
    ]
