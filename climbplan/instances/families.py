"""The families of the set, by name: what an instance is drawn from, and how large in each class.

An instance is its family, class and number: the same name is the same problem at the same seed.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from climbplan.instances.climbing import coupled, forces, postures
from climbplan.instances.free_flyer import free_flyer
from climbplan.instances.moving import books, cart_poles, modules, walks
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
class Named:
    """One instance of the set, not yet drawn."""

    family: Family
    level: Level
    number: int

    @property
    def name(self) -> str:
        """`family-class-number`, of its files and rows."""
        return f"{self.family.name}-{self.level}-{self.number}"

    def drawn(self, seed: int) -> Instance:
        """The numbers of it."""
        size = self.family.sizes[LEVELS.index(self.level)]
        key = zlib.crc32(self.family.name.encode())
        rng = np.random.default_rng([seed, key, LEVELS.index(self.level), self.number])
        return self.family.make(rng, size)


FAMILIES: tuple[Family, ...] = (
    Family("postures", "toes on patches, body, rotation", (2, 4, 8), "rounds", postures),
    Family("forces", "compliant contact forces", (1, 8, 48), "instants", forces),
    Family("coupled", "postures with forces, products", (1, 2, 4), "rounds", coupled),
    Family("books", "a book into a shelf, products", (2, 3, 5), "stored books", books),
    Family("walks", "gait and footholds, relaxed", (3, 5, 9), "knots", walks),
    Family("cart-poles", "a pole between soft walls", (5, 10, 20), "steps", cart_poles),
    Family(
        "free-flyers",
        "a flyer among 8 rectangles",
        (3, 5, 8),
        "steps",
        lambda rng, size: free_flyer(rng, size, 8),
    ),
    Family("modules", "who holds box and wall, and when", (4, 6, 8), "intervals", modules),
)


def the_set(count: int = COUNT) -> list[Named]:
    """All instances: `count` of each family and class, family by family."""
    return [
        Named(family, level, number)
        for family in FAMILIES
        for level in LEVELS
        for number in range(count)
    ]
