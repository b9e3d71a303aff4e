"""Robots that brace between walls in postures of robot files of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from urdf_humanoid import humanoid

from climbplan.climb.proposed.proposed import ProposalTrials
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal import bracing_random_search
from climbplan.robots.urdf.proposal.candidate_stances import find_candidate_stances
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal
from climbplan.robots.urdf.proposal.propose_robot import detect_legs, prepare_detected_legs


def standing_humanoid(folder: Path) -> RobotProposal:
    """On its feet, with its hands on walls, and without any posture between them."""
    own = find_candidate_stances(
        prepare_detected_legs(detect_legs(humanoid(folder / "humanoid.urdf")))
    )
    return own.build_proposal(walls=False)


@pytest.mark.slow
def test_a_robot_that_braces_bent_otherwise_has_a_file_of_its_own(tmp_path: Path) -> None:
    found = standing_humanoid(tmp_path)
    trials = ProposalTrials(found, tmp_path)
    climbed = trials.plan_chimney(lambda words: None)
    assert climbed.plan is not None, climbed.why
    assert climbed.proposal is not None
    assert f'robot: "{trials.bracing_file}"' in climbed.text
    assert (tmp_path / trials.bracing_file).exists()
    (brace,) = climbed.proposal.braces
    robot = climbed.proposal.robot
    assert isinstance(robot.mechanism, SerialChain)
    # Its posture is the one that it braces in, whatever it stands in
    np.testing.assert_allclose(robot.mechanism.posture, brace.angles, atol=1e-3)
    np.testing.assert_allclose(np.abs(brace.toes[:, 0]), brace.gap / 2)
    np.testing.assert_allclose(robot.stance_body, brace.toes, atol=5e-3)
    assert brace.utilisation < 1
    assert not found.prepared.has_self_collision(brace)


@pytest.mark.slow
def test_a_robot_for_which_nothing_is_found_says_that_both_were_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bracing_random_search, "_sample_bracing_postures", lambda own: [])
    trials = ProposalTrials(standing_humanoid(tmp_path), tmp_path)
    refused = trials.plan_chimney(lambda words: None)
    assert refused.plan is None
    assert refused.proposal is None
    assert "no posture between walls was found" in refused.why
    assert "limbs bent otherwise" in refused.why
