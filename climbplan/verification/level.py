"""What to do with a plan, by its verification: three levels, each with one sentence of advice."""

from __future__ import annotations

from enum import StrEnum


class Level(StrEnum):
    """How far a plan can be trusted; the value is its name in JSON and in plan files."""

    FINE = "fine"
    LOOK = "look"
    DO_NOT_USE = "do_not_use"

    @property
    def label(self) -> str:
        """The level as people read it: "do not use"."""
        return _TITLES[self]


_TITLES = {Level.FINE: "fine", Level.LOOK: "look at this", Level.DO_NOT_USE: "do not use"}


def level_of(*, num_failed: int, implausible: bool, reservations: bool) -> Level:
    """Return the level of a plan.

    Args:
        num_failed: Checks that failed.
        implausible: Whether data or deflections are beyond what any such robot has.
        reservations: Whether a margin is not kept or the model leaves something out.
    """
    if num_failed or implausible:
        return Level.DO_NOT_USE
    return Level.LOOK if reservations else Level.FINE


def advice_of(
    *,
    num_checks: int,
    num_failed: int,
    implausible: bool,
    fragile: bool,
    model: str,
    is_motion: bool = True,
) -> str:
    """Return one sentence on what to do with a plan.

    Args:
        num_checks: Checks that were made.
        num_failed: Checks that failed.
        implausible: Whether data or deflections are beyond what any such robot has.
        fragile: Whether a margin is not kept.
        model: What the plan is verified in, "" where nothing is left out.
        is_motion: Whether it is a motion that can be simulated and run by a robot.
    """
    if num_failed:
        return (
            f"{num_failed} of {num_checks} checks failed: change the spec as the failed checks "
            "say and plan again"
        )
    if implausible:
        return (
            "data or deflections are beyond what any such robot has: correct those named as "
            "implausible and plan again"
        )
    reasons = ["margins are not all kept"] if fragile else []
    reasons += [f"it is verified in its model only ({model})"] if model else []
    if reasons:
        advice = f"every check passed, but {' and '.join(reasons)}: read what is listed"
        return f"{advice} and simulate the plan before a robot runs it" if is_motion else advice
    advice = "every check passed and nothing is left out"
    return f"{advice}: simulate the plan, then run it" if is_motion else advice
