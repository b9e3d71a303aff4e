"""What modules do with the box: actions, subtasks from place to place, and task plans."""

from __future__ import annotations

from dataclasses import dataclass

from climbplan.arrays import Array
from climbplan.limms.scene.bounds import Connection
from climbplan.limms.scene.limms_scene import SIDES, ModuleScene

SUBTASK_COST = 0.4  # cost of each subtask after the first: less than that of a module
_KIND_COST = {
    "throw": 0.5,
    "relatch": 0.25,
    "quadruped": 0.5,
}  # cost of actions that are harder than carrying

Placement = tuple[float, ...]  # (D,) placement of the box, hashable [m, rad]


@dataclass(frozen=True)
class Action:
    """A symbolic action: how modules move the box, held by arms, thrown, or as a quadruped.

    A module that relatches holds the box first, and comes to its anchor from there.
    """

    kind: str  # "arms", "throw", "relatch", "quadruped"
    connections: tuple[Connection, ...] = ()
    wrist_distance: float = 0.0  # [m] sum of the distances between wrists that chains bridge
    extra_flight: float = 0.0  # [m] by which a throw exceeds easy throws
    releases_ground_anchor: bool = False  # a module on a ground anchor drives before it relatches

    @property
    def num_modules(self) -> int:
        """The number of modules that the action takes."""
        return 4 if self.kind == "quadruped" else sum(c.links for c in self.connections)

    @property
    def has_chains(self) -> bool:
        """True if arms hang on arms."""
        return any(connection.links > 1 for connection in self.connections)

    def extra_cost(self) -> float:
        """Return the cost in addition to modules: latch changes, steps, flight and distance."""
        distance_cost = 2 * self.extra_flight + 0.01 * self.wrist_distance
        return (
            _KIND_COST.get(self.kind, 0.0)
            + (0.1 if self.releases_ground_anchor else 0.0)
            + distance_cost
        )

    def cost(self) -> float:
        """Return the cost that orders actions: few modules first, then what is easy."""
        return self.num_modules + self.extra_cost()

    def describe(self, scene: ModuleScene) -> str:
        """Return the action in words."""
        if self.kind == "quadruped":
            return "quadruped"
        anchor_names = scene.anchor_names[scene.wall_offset :]
        arms = ", ".join(
            f"{anchor_names[c.root]} to {SIDES[c.side]}"
            + (f" by {c.links} modules" if c.links > 1 else "")
            for c in self.connections
        )
        return f"{self.kind}: {arms}"


@dataclass(frozen=True)
class Subtask:
    """The motion of one box from one place to the next by one action."""

    action: Action
    start: Placement
    end: Placement
    box: int = 0  # number of the box in the plan
    is_set_aside: bool = False  # the box is not brought to its goal


@dataclass(frozen=True)
class TaskPlan:
    """A sequence of subtasks; all boxes stand between them."""

    subtasks: tuple[Subtask, ...]
    secondary_cost: float = 0.0  # orders plans with equal subtasks and modules

    def cost(self) -> float:
        """Return the cost that orders plans: modules at once, then subtasks, then effort."""
        max_modules = max(subtask.action.num_modules for subtask in self.subtasks)
        extra = sum(subtask.action.extra_cost() for subtask in self.subtasks)
        return max_modules + SUBTASK_COST * (len(self.subtasks) - 1) + extra + self.secondary_cost

    def describe(self, scene: ModuleScene) -> str:
        """Return the task plan in words."""
        if scene.num_deliveries > 1:
            return "; ".join(
                f"box {subtask.box}{' aside' if subtask.is_set_aside else ''} "
                f"by {subtask.action.describe(scene)}"
                for subtask in self.subtasks
            )
        actions = ", then ".join(subtask.action.describe(scene) for subtask in self.subtasks)
        return f"relay: {actions}" if len(self.subtasks) > 1 else actions


def freeze_placement(point: Array) -> Placement:
    """Return a placement (D,) as a hashable tuple."""
    return tuple(float(value) for value in point)
