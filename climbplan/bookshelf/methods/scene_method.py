"""What every method offers."""

from __future__ import annotations

from typing import Protocol

from climbplan.bookshelf.plan.answer import SceneAnswer
from climbplan.bookshelf.scene.shelf_scene import Scene


class SceneMethod(Protocol):
    """A method that was prepared for one shelf; keeps its space between scenes."""

    def solve(self, scene: Scene) -> SceneAnswer:
        """The best placement that the method finds, judged by the exact check of the meaning."""
