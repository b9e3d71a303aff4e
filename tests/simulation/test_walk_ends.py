"""How runs of walks end: joint speeds that no motor reaches are no standing."""

from __future__ import annotations

from dataclasses import replace

from climbplan.simulation.report_files import MAX_SPEED_SHARE, SimulationEnd

STANDS = SimulationEnd(
    fall_time=None, slips=0, lost_contacts=0, allowed=4, joint_speed=MAX_SPEED_SHARE
)


def test_joints_within_their_speed_limits_stand() -> None:
    assert STANDS.good
    assert STANDS.words == "stands"
    assert STANDS.failure(None) == ""


def test_joints_beyond_their_speed_limits_do_not() -> None:
    fast = replace(STANDS, joint_speed=1.11)
    assert not fast.good
    assert fast.words == "stands with joint speeds of 111 % of their limits"
    assert fast.failure(None).startswith(f"the robot {fast.words}")
    assert fast.failure(99) == fast.failure(None)
    slips = replace(fast, slips=1)
    assert slips.words == "stands with 1 slip and joint speeds of 111 % of their limits"
