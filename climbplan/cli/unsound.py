"""A word on plans that are shown or passed on although they do not hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from climbplan.api.kinds import PlanKind
from climbplan.cli.console import warn
from climbplan.errors import VerificationFailed
from climbplan.store.atomic_file import replace_atomically
from climbplan.verification.verification import Verification

if TYPE_CHECKING:
    from climbplan.exports.motion import RobotMotion

NOT_VERIFIED = "NOT_VERIFIED.txt"  # in directories that are exported from such a plan


def warn_of_failure(kind: PlanKind, path: Path) -> Verification:
    """Warn where a plan that is to be shown or passed on must not be used; return its checks.

    Raises:
        UnsoundPlan: its numbers mean nothing, so that nothing can be shown.
    """
    verification = kind.verify(path)
    if verification.objection:
        verification.require_sound(path)
        warn(f"{path} {verification.objection}")
    return verification


def require_verified(kind: PlanKind, path: Path, allow_unverified: bool) -> str:
    """Return what an export of the plan has to say of it: "" for a plan that holds.

    Raises:
        PlanFails: the plan fails its verification, and `allow_unverified` is not set.
        UnsoundPlan: its numbers mean nothing.
    """
    verification = kind.verify(path)
    if verification.passed:
        return ""
    verification.require_sound(path)
    failure = f"fails its verification: {verification.headline()}"
    if not allow_unverified:
        raise VerificationFailed(
            f"{path} {failure}; export writes plans that are verified, --unverified also this one, "
            "and says so in what it writes"
        )
    warn(f"{path} {failure}")
    return f"NOT VERIFIED: the plan {failure}"


def name_unverified(motion: RobotMotion, remark: str) -> RobotMotion:
    """Return a motion that says in its name and words that its plan is not verified."""
    name = f"{motion.name} (not verified)"
    return replace(motion, name=name, words=(remark, *motion.words)) if remark else motion


def mark_unverified(target: Path, remark: str) -> None:
    """Say in an exported CSV file (first line) or directory that its plan is not verified.

    Raises UsageError if it cannot be written.
    """
    if not remark:
        return
    if target.is_dir():
        (target / NOT_VERIFIED).write_text(f"{remark}\n", encoding="utf-8")
    elif target.suffix == ".csv":
        with replace_atomically(target) as temporary, temporary.open("wb") as stream:
            stream.write(f"# {remark}\n".encode())
            stream.write(target.read_bytes())
