"""What modules do with the box: actions, legs from place to place, and courses of several legs."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.arrays import Array
from climbplan.limms.scene.bounds import Connection
from climbplan.limms.scene.limms_scene import SIDES, Scene

SECOND_LEG = 0.4  # cost of each leg after the first: less than that of a module
_EXTRA = {"throw": 0.5, "relatch": 0.25, "quadruped": 0.5}  # cost of what is harder than carrying

Place = tuple[float, ...]  # (D,) of the box [m, rad]


@dataclass(frozen=True)
class Action:
    """How modules move the box: held by arms, thrown by them, or as a quadruped.

    A module that relatches holds the box first, and comes to its anchor from there.
    """

    kind: str  # "arms", "throw", "relatch", "quadruped"
    connections: tuple[Connection, ...] = ()
    away: float = 0.0  # [m] how far wrists are apart that the chains have to bring together
    flight: float = 0.0  # [m] that a throw is longer than throws that are tried early
    lets_go: bool = False  # a module on an anchor of the ground drives, before it relatches

    @property
    def modules(self) -> int:
        """How many modules it takes."""
        return 4 if self.kind == "quadruped" else sum(c.links for c in self.connections)

    @property
    def is_chained(self) -> bool:
        """Whether arms hang on arms."""
        return any(connection.links > 1 for connection in self.connections)

    def extra(self) -> float:
        """Cost beside its modules: changes of latches, steps or flight; near ones first."""
        near = 2 * self.flight + 0.01 * self.away
        return _EXTRA.get(self.kind, 0.0) + (0.1 if self.lets_go else 0.0) + near

    def cost(self) -> float:
        """What is tried first: few modules, and what is easy."""
        return self.modules + self.extra()

    def named(self, scene: Scene) -> str:
        """In words."""
        if self.kind == "quadruped":
            return "quadruped"
        names = scene.anchor_names[scene.wall_offset :]
        arms = ", ".join(
            f"{names[c.root]} to {SIDES[c.side]}"
            + (f" by {c.links} modules" if c.links > 1 else "")
            for c in self.connections
        )
        return f"{self.kind}: {arms}"


@dataclass(frozen=True)
class Leg:
    """A box from one place to the next, by one action."""

    action: Action
    begin: Place
    end: Place
    box: int = 0  # its number in the plan
    aside: bool = False  # one of several boxes that is not brought to its goal


@dataclass(frozen=True)
class Course:
    """Legs one after the other; all boxes stand between them."""

    legs: tuple[Leg, ...]
    apart: float = 0.0  # cost by which courses of as many legs and modules differ

    def cost(self) -> float:
        """What is tried first: modules that hold the box at once, then legs, then what is easy."""
        most = max(leg.action.modules for leg in self.legs)
        extra = sum(leg.action.extra() for leg in self.legs)
        return most + SECOND_LEG * (len(self.legs) - 1) + extra + self.apart

    def named(self, scene: Scene) -> str:
        """In words."""
        if scene.deliveries > 1:
            return "; ".join(
                f"box {leg.box}{' aside' if leg.aside else ''} by {leg.action.named(scene)}"
                for leg in self.legs
            )
        words = ", then ".join(leg.action.named(scene) for leg in self.legs)
        return f"relay: {words}" if len(self.legs) > 1 else words


def place_of(point: Array) -> Place:
    """A placement (D,) that can be looked up."""
    return tuple(float(value) for value in point)
