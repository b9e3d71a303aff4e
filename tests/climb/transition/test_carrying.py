"""What is planned again, and how, where the motion of a sequence does not hold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from climbplan.climb.motion.motion import StageClock
from climbplan.climb.transition import sequence_planning
from climbplan.climb.transition.motion import TransitionMotion
from climbplan.errors import NoPlanFound, ReachFailure

_LEAST = 1.0  # S_tau of the spec


class _Planner:
    """Motions with an S_tau, of which those with too little room to joint bounds do not hold."""

    def __init__(self, has: float, needed: float, error: NoPlanFound) -> None:
        self.has, self.needed, self.error = has, needed, error
        self.asked: list[tuple[float, float, float]] = []  # S_tau, share, room

    def plan_motion(
        self,
        tables: Any,
        sequence: Any,
        asked: float,
        *,
        margin_fraction: float,
        joint_margin: float,
        **_: Any,
    ) -> TransitionMotion:
        room = joint_margin
        self.asked.append((asked, margin_fraction, room))
        rounds: Any = SimpleNamespace(room=room)
        return TransitionMotion(rounds, np.zeros(3), 0.0, "", 1, 0.0, "", self.has)

    def verified(self, run: Any, rounds: Any, moved: Any, first: Any) -> tuple[Any, Any]:
        if rounds.room < self.needed:
            raise self.error
        return rounds, SimpleNamespace(passed=True)


def _carried(
    monkeypatch: pytest.MonkeyPatch, planner: _Planner
) -> sequence_planning.SequenceResult:
    monkeypatch.setattr(sequence_planning, "plan_motion", planner.plan_motion)
    monkeypatch.setattr(sequence_planning, "verify_motion", planner.verified)
    spec = SimpleNamespace(
        force=SimpleNamespace(safety_torque=_LEAST), margins=SimpleNamespace(asked=True)
    )
    clock = StageClock(lambda stage, fraction: None)
    scene = SimpleNamespace(spec=spec)
    run: Any = SimpleNamespace(
        scene=scene, clock=clock, margin_fractions=sequence_planning.MARGIN_FRACTIONS
    )
    sequence: Any = SimpleNamespace(safety_torque=2.0, moves=None)
    tables: Any = None  # only the planner, which is not asked, would look at it
    return sequence_planning.plan_and_verify_sequence(run, tables, sequence)


def test_a_joint_past_its_bound_is_given_more_room(monkeypatch: pytest.MonkeyPatch) -> None:
    planner = _Planner(
        1.0, sequence_planning._JOINT_MARGINS[1], ReachFailure("LF", "past its bound")
    )
    assert _carried(monkeypatch, planner).motion is not None
    assert [room for _, _, room in planner.asked] == list(sequence_planning._JOINT_MARGINS[:2])
    assert {share for _, share, _ in planner.asked} == {
        sequence_planning.MARGIN_FRACTIONS[0]
    }  # no margin given up


def test_other_failures_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    planner = _Planner(1.0, np.inf, NoPlanFound("no forces", stage="force"))
    attempt = _carried(monkeypatch, planner)
    assert (attempt.motion, attempt.reason) == (None, "no forces")
    assert {room for _, _, room in planner.asked} == {sequence_planning._JOINT_MARGINS[0]}
    every = [
        (f * _LEAST, share)
        for share in sequence_planning.MARGIN_FRACTIONS
        for f in sequence_planning._TORQUE_FACTORS
    ]
    assert [(asked, share) for asked, share, _ in planner.asked] == every


def test_what_a_motion_has_already_is_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    planner = _Planner(1.4, np.inf, NoPlanFound("no forces", stage="force"))
    assert _carried(monkeypatch, planner).motion is None
    asked = {asked for asked, _, _ in planner.asked}
    assert asked == {
        f * _LEAST for f in sequence_planning._TORQUE_FACTORS if f == 1.0 or f > planner.has
    }
