"""The last line of a run's summary."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from climbplan.plans.verification import Verification


def verify_line(verification: Verification, seconds: float) -> str:
    """How the verification went, in the columns of the lines before it."""
    word = "passed" if verification.passed else "FAILED"
    return f"{'verify':<9} {word:<9} {seconds:.2f} s   {verification.headline()}"
