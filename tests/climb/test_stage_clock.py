"""The clock of stages: seconds add up, and a failure says in which stage it happened."""

from __future__ import annotations

import pytest

from climbplan.climb.motion.motion import StageClock
from climbplan.errors import LimitReached, Unresolved


def test_failures_name_the_innermost_stage_that_did_not() -> None:
    clock = StageClock(lambda stage, share: None)
    with pytest.raises(LimitReached) as outer, clock.stage("posture"), clock.stage("kinematics"):
        raise LimitReached("too late")
    assert outer.value.stage == "kinematics"
    with pytest.raises(Unresolved) as own, clock.stage("posture"):
        raise Unresolved("no forces", because="chosen", stage="force")
    assert own.value.stage == "force"
    assert clock.seconds.keys() == {"posture", "kinematics"}
