"""What a run and `verify` say of a verification: one line, its level, and against what."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from climbplan.cli.console import warn

if TYPE_CHECKING:
    from climbplan.verification.verification import Verification


def verify_line(verification: Verification, seconds: float) -> str:
    """How the verification went, in the columns of the lines before it."""
    word = "passed" if verification.passed else "FAILED"
    in_model = f"{verification.badge}; " if verification.passed and verification.model else ""
    return f"{'verify':<9} {word:<9} {seconds:.2f} s   {in_model}{verification.headline()}"


def leaves_out_lines(verification: Verification) -> Iterator[str]:
    """What the badge leaves out, one line each."""
    for words in verification.leaves_out:
        yield f"{'':<9} {'leaves out':<9} {words}"
    for words in verification.fragile:
        yield f"{'':<9} {'fragile':<9} {words}"


def level_line(verification: Verification) -> str:
    """The level of a plan and what to do with it, in the columns of the lines before it."""
    return f"{'level':<9} {verification.level.label}: {verification.advice}"


def badge_lines(verification: Verification) -> Iterator[str]:
    """What `verify` prints above its table: badge, level, what is left out, and the spec."""
    yield ", ".join(filter(None, (verification.badge, verification.stands)))
    yield f"{verification.level.label}: {verification.advice}"
    for words in verification.leaves_out:
        yield f"  leaves out: {words}"
    for words in verification.fragile:
        yield f"  fragile: {words}"
    against = verification.against
    if against is not None:
        yield f"spec {against}"
        for difference in against.differences:
            yield f"  {difference}"


def warn_of_implausible(verification: Verification) -> None:
    """Data and deflections that no such robot has; quiet does not hide them."""
    for words in verification.implausible:
        warn(f"implausible: {words}")
