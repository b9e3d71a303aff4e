"""The protocol of all methods that solve scenes."""

from __future__ import annotations

from typing import Protocol

from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import ShelfScene


class SceneMethod(Protocol):
    """A method that was prepared for one shelf; keeps its space between scenes."""

    def solve(self, scene: ShelfScene) -> SceneAnswer:
        """Return the best placement that the method finds and the exact check passes."""
