"""The exact check by the name of its meaning."""

from __future__ import annotations

from climbplan.bookshelf.checker import check_contact
from climbplan.bookshelf.checker_published import check_published
from climbplan.bookshelf.checks import PlacementCheck
from climbplan.bookshelf.scene import Array, Scenes, Shelf, States


def check_placements(
    scenes: Scenes, pose: Array, state: States, shelf: Shelf, meaning: str
) -> PlacementCheck:
    """Check placements of S scenes: pose (S, n + 1, 3) [m, rad], state (S, n + 1)."""
    check = check_contact if meaning == "contact" else check_published
    return check(scenes, pose, state, shelf)
