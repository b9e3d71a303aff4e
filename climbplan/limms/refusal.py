"""What to raise where bounds rule every behaviour out, and whether that is a proof.

The search knows arms in short chains, throws, relatching and quadrupeds, and a box that does not
turn. That none of these can do it proves nothing about what else modules might do. Force does: each
module holds the box with one end, and carries no more than its latch holds.
"""

from __future__ import annotations

from collections.abc import Sequence

from climbplan.errors import Conflict, Infeasible, NoPlanFound, NotProved
from climbplan.limms.scene import Scene

BEHAVIOURS = (
    "looked at are arms in chains of up to two, throws, relatching and quadrupeds, with a box that "
    "does not turn"
)


def ruled_out(scene: Scene, conflicts: Sequence[Conflict]) -> NoPlanFound:
    """The error for a scene in which each behaviour is ruled out."""
    if too_weak(scene):
        return Infeasible("no plan exists: the modules are too weak", conflicts, stage="modes")
    return NotProved(
        "each behaviour that the search knows is ruled out",
        conflicts,
        because=BEHAVIOURS,
        stage="modes",
    )


def too_weak(scene: Scene) -> bool:
    """Whether all latches that can be on the box together hold less than its weight.

    From rest to rest forces carry the weight on average, with or without a flight. Where the spec
    allows arms only, each needs a wall anchor of its own.
    """
    contacts = scene.count
    if "quadruped" not in scene.allow:
        contacts = min(contacts, scene.walls)
    return contacts * scene.module.max_force < scene.weight
