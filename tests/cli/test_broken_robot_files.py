"""Broken robot files of a sound URDF: each ends with exit code 2, line and key, and says why."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import RunCommand
from urdf_walkers import Walker

ROBOT = """kind: robot
urdf: walker.urdf
joint_stiffness: 100
base: base_link
forward: x
limb_radii: {L1_knee: 0.02}
locked: {}
joints: {L1_lift: {max_torque: 20}}
body_half_size: [0.2, 0.1, 0.05]
workspace: {reach: 0.56}
legs:
  L1: {toe: L1_toe, posture_deg: {L1_lift: 30, L1_knee: 20}}
  R1: {toe: R1_toe, posture_deg: {R1_lift: 30, R1_knee: 20}}
  L2: {toe: L2_toe, posture_deg: {L2_lift: 30, L2_knee: 20}}
  R2: {toe: R2_toe, posture_deg: {R2_lift: 30, R2_knee: 20}}
"""
RADII = "{L1_knee: 0.02}"

# What is replaced (once), by what, then the line, the key and words of the message
BROKEN = [
    ("kind: robot", "kind: robots", 1, "kind", ""),
    ("urdf: walker.urdf", "urdf: wlaker.urdf", 2, "urdf", "no such file"),
    ("urdf: walker.urdf", "urdf: ''", 2, "urdf", ""),
    ("joint_stiffness: 100", "joint_stiffness: -1", 3, "joint_stiffness", ""),
    ("joint_stiffness: 100", "joint_stiffnes: 100", 3, "joint_stiffnes", "joint_stiffness"),
    ("joint_stiffness: 100", "joint_stiffness: soft", 3, "joint_stiffness", "number"),
    ("base: base_link", "base: base_lnik", 4, "base", "base_link"),
    ("forward: x", "forward: z", 5, "forward", ""),
    (RADII, "{L1_kne: 0.02}", 6, "limb_radii.L1_kne", "did you mean 'L1_knee'"),
    (RADII, "{L1_tip: 0.02}", 6, "limb_radii.L1_tip", "no leg moves it"),
    (RADII, "{L1_knee: -0.02}", 6, "limb_radii.L1_knee", "expected from 0 to 100 m"),
    (RADII, "{L1_knee: 1e9}", 6, "limb_radii.L1_knee", "expected from 0 to 100 m"),
    (RADII, "{L1_knee: thick}", 6, "limb_radii.L1_knee", "number"),
    (RADII, "{L1_knee: .nan}", 6, "limb_radii.L1_knee", ""),
    (RADII, "0.02", 6, "limb_radii", ""),
    ("locked: {}", "locked: {L1_lfit: 0}", 7, "locked.L1_lfit", "L1_lift"),
    ("locked: {}", "locked: {L1_lift: 500}", 7, "locked.L1_lift", "deg"),
    ("max_torque: 20", "max_torque: 0", 8, "joints.L1_lift.max_torque", ""),
    ("max_torque: 20", "torque: 20", 8, "joints.L1_lift.torque", "max_torque"),
    ("{L1_lift: {max", "{L1_lfit: {max", 8, "joints.L1_lfit", "L1_lift"),
    ("[0.2, 0.1, 0.05]", "[0.2, 0.1]", 9, "body_half_size", ""),
    ("[0.2, 0.1, 0.05]", "[0.2, 0.1, -0.05]", 9, "body_half_size", "three numbers > 0"),
    ("{reach: 0.56}", "{reach: 0}", 10, "workspace.reach", ""),
    ("toe: L1_toe", "toe: L1_teo", 12, "legs.L1.toe", "L1_toe"),
    ("toe: L1_toe", "toe: R1_toe", 13, "legs.R1", ""),
    ("L1_lift: 30", "L1_lift: 300", 12, "legs.L1.posture_deg", "deg"),
    ("L1_lift: 30", "R2_lift: 30", 12, "legs.L1.posture_deg", ""),
    ("{toe: L1_toe", "{side: up, toe: L1_toe", 12, "legs.L1.side", ""),
]


def test_there_are_more_than_twenty() -> None:
    assert len({(old, new) for old, new, *_ in BROKEN}) > 20


def test_the_file_is_sound_without(run_command: RunCommand, workplace: Path) -> None:
    (workplace / "walker.urdf").write_text(Walker(joints=3).text())
    (workplace / "robot.yaml").write_text(ROBOT)
    assert run_command("validate", "robot.yaml").code == 0


@pytest.mark.parametrize(("old", "new", "line", "key", "words"), BROKEN)
def test_broken_robot_files_end_with_two(
    run_command: RunCommand, workplace: Path, old: str, new: str, line: int, key: str, words: str
) -> None:
    assert old in ROBOT
    (workplace / "walker.urdf").write_text(Walker(joints=3).text())
    (workplace / "robot.yaml").write_text(ROBOT.replace(old, new, 1))
    outcome = run_command("validate", "robot.yaml")
    assert outcome.code == 2, outcome.err
    assert f"robot.yaml:{line}: {key}" in outcome.err
    assert words in outcome.err
