"""Postures in which a proposed robot walks at speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from urdf_humanoid import humanoid
from walking_urdf import walking_robot

from climbplan.robots.urdf.proposal import walking_stance
from climbplan.robots.urdf.proposal.propose_robot import detect_legs, prepare_detected_legs
from climbplan.robots.urdf.proposal.walk_document import format_walk_document
from climbplan.robots.urdf.walking_body import WalkingBody, build_walking_body


def test_the_centre_of_mass_is_beside_the_diagonals() -> None:
    square = np.array([[0.3, 0.2, 0.0], [0.3, -0.2, 0.0], [-0.3, 0.2, 0.0], [-0.3, -0.2, 0.0]])
    assert walking_stance._measure_diagonal_offset(square) == pytest.approx(0.0)
    # Above the middle between the rear toes, 0.2 m from each
    ahead = square + np.array([0.3, 0.0, 0.0])
    assert walking_stance._measure_diagonal_offset(ahead) == pytest.approx(
        0.2 * 0.6 / np.hypot(0.6, 0.4)
    )


@pytest.mark.slow
def test_a_humanoid_walks_in_postures_with_more_room_for_its_toes(tmp_path: Path) -> None:
    own = prepare_detected_legs(
        detect_legs(humanoid(tmp_path / "humanoid.urdf"), None, ("z", "-x"))
    )
    found, lack = walking_stance.search_walking_stances(own, 3)
    assert found, lack
    assert lack == ""
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)
    for posture in found:
        assert not own.has_self_collision(posture)
        assert posture.utilisation * walking_stance._MIN_STRENGTH < 1
        np.testing.assert_allclose(posture.toes[:, 2], posture.toes[0, 2])
        body = build_walking_body(own.build_proposal(posture, walls=False).draft.load_robot())
        toes = body.boxes.center
        assert toes[:2, 0].mean() > 0 > toes[2:, 0].mean()
        half = float((body.boxes.half / walking_stance._EXTENT_WEIGHTS).min())
        expected = half * (
            1 - posture.utilisation
        ) - walking_stance._DIAGONAL_OFFSET_COST * walking_stance._measure_diagonal_offset(toes)
        assert posture.score == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_arms_too_weak_for_a_walk_are_told_by_how_much(tmp_path: Path) -> None:
    own = prepare_detected_legs(
        detect_legs(humanoid(tmp_path / "weak.urdf", effort=4.0), None, ("z", "-x"))
    )
    found, lack = walking_stance.search_walking_stances(own, 3)
    assert found == []
    assert " N upright of the " in lack


def test_haste_weighs_what_is_asked(tmp_path: Path) -> None:
    body: WalkingBody = build_walking_body(walking_robot(tmp_path))
    ahead, round_ = (
        format_walk_document(body, "walker.yaml", lambda *_: 0.0, turns, 10.0)
        for turns in (False, True)
    )
    assert "velocity: [1000, 100, 1000], angles: [100, 100, 10]" in ahead
    assert "velocity: [100, 100, 1000], angles: [100, 100, 100]" in round_


def test_slower_turns_have_longer_intervals(tmp_path: Path) -> None:
    body: WalkingBody = build_walking_body(walking_robot(tmp_path))
    own, slower = (
        yaml.safe_load(format_walk_document(body, "walker.yaml", lambda *_: 0.0, True, 1.0, times))
        for times in (1.0, 2.0)
    )
    assert slower["task"]["dt"] == pytest.approx(2 * own["task"]["dt"], abs=2e-3)
    assert slower["task"]["reference"] == own["task"]["reference"]
