"""Chains at given angles as expressions of a program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca


@dataclass(frozen=True)
class StatedPose:
    """Chains at given angles, body frame; lists have J entries of (3, N)."""

    joints: list[Any]
    axes: list[Any]
    slides: list[Any]  # empty where no joint slides
    toe: Any  # (3, N)

    @property
    def arms(self) -> list[Any]:
        """Toe velocity by each joint's own speed, J entries of (3, N)."""
        arms = [
            ca.cross(axis, self.toe - at) for at, axis in zip(self.joints, self.axes, strict=True)
        ]
        if not self.slides:
            return arms
        return [arm + slide for arm, slide in zip(arms, self.slides, strict=True)]


def turned_about(axis: Any, angle: Any, vector: Any) -> Any:
    """Vectors (3, N) turned about unit axes (3, N) by angles (1, N); the same where axes are 0."""
    once = ca.cross(axis, vector)
    sin, rest = (ca.repmat(x, 3, 1) for x in (ca.sin(angle), 1 - ca.cos(angle)))
    return vector + sin * once + rest * ca.cross(axis, once)
