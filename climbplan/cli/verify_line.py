"""The lines that runs and `verify` print about a verification."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from climbplan.cli.console import warn

if TYPE_CHECKING:
    from climbplan.verification.verification import Verification


def format_verification(verification: Verification, seconds: float) -> str:
    """Format the outcome of a verification in the columns of the other stages."""
    outcome = "passed" if verification.passed else "FAILED"
    in_model = f"{verification.badge}; " if verification.passed and verification.model else ""
    return f"{'verify':<9} {outcome:<9} {seconds:.2f} s   {in_model}{verification.headline()}"


def format_omissions(verification: Verification) -> Iterator[str]:
    """Format what the badge leaves out, one line each."""
    for reason in verification.leaves_out:
        yield f"{'':<9} {'leaves out':<9} {reason}"
    for reason in verification.fragile:
        yield f"{'':<9} {'fragile':<9} {reason}"


def format_level(verification: Verification) -> str:
    """Format the level of a plan and the advice that goes with it."""
    return f"{'level':<9} {verification.level.label}: {verification.advice}"


def format_badge(verification: Verification) -> Iterator[str]:
    """Format badge, level, omissions and spec, which `verify` prints above its table."""
    yield ", ".join(filter(None, (verification.badge, verification.risk_summary)))
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
    """Warn of implausible data and deflections, with --quiet as well."""
    for words in verification.implausible:
        warn(f"implausible: {words}")
