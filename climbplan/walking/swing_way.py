"""The way of a swinging toe as plans mean it, by the share of its time: from rest to rest.

Straight from where the toe stood to where it will stand, and up and down above that: what joint
speeds are judged on, and what a whole robot is simulated with.
"""

from __future__ import annotations

from typing import TypeVar

from climbplan.walking.task import Array

Share = TypeVar("Share", float, Array)


def along(s: Share) -> tuple[Share, Share, Share]:
    """From 0 to 1, at rest and without acceleration at both ends; with both derivatives by s."""
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2,
        60 * s * (1 - s) * (1 - 2 * s),
    )


def arch(s: Share) -> tuple[Share, Share, Share]:
    """From 0 up to 1 and back to 0, at rest at both ends; with both derivatives by s."""
    return (
        16 * s**2 * (1 - s) ** 2,
        32 * s * (1 - s) * (1 - 2 * s),
        32 * (1 - 6 * s + 6 * s**2),
    )
