"""What a search for a limit has to know of each kind of spec, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pkgutil import resolve_name
from typing import Any

from climbplan.api.limit_search import Direction


@dataclass(frozen=True)
class LimitKind:
    """One kind of spec in searches for limits.

    Attributes:
        largest: patterns of dotted keys whose larger values are harder.
        smallest: patterns of dotted keys whose smaller values are harder.
        check_tables: tables of checks with their meanings, MODULE:NAME.
        without: keys that no plan of the search needs, with the values that leave them out.
        judged_by_status: whether a plan file with a status "infeasible" or "limit" is no success.
    """

    largest: tuple[str, ...]
    smallest: tuple[str, ...]
    check_tables: tuple[str, ...]
    without: Mapping[str, Any] = field(default_factory=dict)
    judged_by_status: bool = False

    def default_direction(self, key: str) -> Direction | None:
        """Return which value of a key is sought where nobody says; None if the table is silent."""
        if any(fnmatchcase(key, pattern) for pattern in self.smallest):
            return "smallest"
        return "largest" if any(fnmatchcase(key, pattern) for pattern in self.largest) else None

    def describe_check(self, name: str) -> str:
        """Return the meaning of a check; "" for a name that no table has."""
        for table in self.check_tables:
            meaning = resolve_name(table).get(name)
            if meaning is not None:
                return str(getattr(meaning, "meaning", meaning))
        return ""


_FRICTION = ("terrain.friction", "terrain.*.friction", "terrain.scan.friction.*")
_BRACED = LimitKind(
    largest=(
        "task.payload.mass",
        "terrain.walls.gap",
        "terrain.walls.angle_deg",
        "terrain.tube.radius",
        "terrain.panel.angle_deg",
        "force.safety_friction",
        "force.safety_torque",
        "force.min_normal_force",
        "trajectory.speed",
        "uncertainty.*",
    ),
    smallest=(
        *_FRICTION,
        "task.goal.tolerance",
        "task.goal.rotation_tolerance_deg",
        "risk",
    ),
    check_tables=("climbplan.verification.check:CLIMB_LIMITS",),
    without={"study": None},
)
LIMIT_KINDS = {
    "climb": _BRACED,
    "transition": _BRACED,
    "mpc": LimitKind(
        largest=(
            "task.reference.velocity.*",
            "terrain.regions.*.slope.*",
            "terrain.stones.rise",
            "terrain.stones.turn_deg",
            "terrain.stones.missing",
            "loop.delay",
            "loop.noise.*",
            "loop.sensors.*",
            "loop.dropout_probability",
        ),
        smallest=("terrain.friction", "terrain.stones.size", "task.goal.within"),
        check_tables=(
            "climbplan.walking.check.plan_checks:LIMITS",
            "climbplan.walking.check.checker:LIMITS",
            "climbplan.walking.check.checker:LEG_LIMITS",
            "climbplan.walking.check.checker:LOOP_LIMITS",
        ),
    ),
    "limms": LimitKind(
        largest=("box.mass", "boxes.*.mass", "box.size.*", "boxes.*.size.*"),
        smallest=("terrain.friction",),
        check_tables=(
            "climbplan.limms.check.limits:LIMITS",
            "climbplan.limms.check.limits:MASS_LIMITS",
        ),
    ),
    "bookshelf": LimitKind(
        largest=(
            "scene.insert.width_mm",
            "scene.insert.height_mm",
            "scene.books.*.width_mm",
            "shelf.left_mm",
        ),
        smallest=("shelf.right_mm", "shelf.height_mm"),
        check_tables=(
            "climbplan.bookshelf.check.plan_checks:LIMITS",
            "climbplan.bookshelf.check.plan_checks:MEANINGS",
        ),
        judged_by_status=True,
    ),
}
"""By kind of spec: the kinds that plans are made of."""
