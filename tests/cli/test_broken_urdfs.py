"""Sixty broken URDFs: each ends with exit code 2, the line, and what was expected."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_line import RunCommand
from urdf_walkers import Walker

ROBOT = """kind: robot
urdf: walker.urdf
joint_stiffness: 100
legs:
  L1: {toe: L1_toe, posture_deg: {L1_lift: 30, L1_knee: 20}}
  R1: {toe: R1_toe, posture_deg: {R1_lift: 30, R1_knee: 20}}
  L2: {toe: L2_toe, posture_deg: {L2_lift: 30, L2_knee: 20}}
  R2: {toe: R2_toe, posture_deg: {R2_lift: 30, R2_knee: 20}}
"""
LIMIT = 'lower="-1.5" upper="1.5" effort="60.0" velocity="5"'  # of L1_lift, the first such
BODY = '<mass value="4.0"/>'
BOX = '<box size="0.4 0.2 0.08"/>'
CYLINDER = '<cylinder radius="0.02" length="0.057"/>'
KNEE = '<parent link="L1_lift_link"/><child link="L1_knee_link"/>'
LIFT = '<joint name="L1_lift" type="revolute">'
SLIDE = '<joint name="L1_lift" type="prismatic">'
INERTIA = 'ixx="0.004"'

# What is replaced in the URDF (once), by what, and words of the message
BROKEN = [
    # no XML
    ("</robot>", "", "not XML"),
    ("<robot", "<robot <", "not XML"),
    ("</link>", "</lnk>", "not XML"),
    ('name="L1_lift"', "name=L1_lift", "not XML"),
    ('name="L1_lift"', 'name="L1_lift" name="x"', "not XML"),
    ('<?xml version="1.0"?>', '<?xml version="1.0"?><!DOCTYPE r [<!ENTITY a "b">]>', "entities"),
    # no URDF
    ("<robot name", "<model name", "not XML"),
    ('<link name="base_link">', "<link>", "<link> without `name`"),
    ('<joint name="L1_lift"', "<joint", "<joint> without `name`"),
    (' type="revolute"', "", "<joint> without `type`"),
    (' type="revolute"', ' type="hinge"', "expected revolute, continuous"),
    ('<link name="L1_knee_link">', '<link name="L1_lift_link">', "two links are named"),
    (LIFT, '<joint name="L1_yaw" type="revolute">', "two joints are named"),
    (KNEE, '<child link="L1_knee_link"/>', "has no <parent>"),
    (KNEE, '<parent link="L1_lift_link"/>', "has no <child>"),
    (KNEE, '<parent link="nowhere"/><child link="L1_knee_link"/>', "parent of joint 'L1_knee'"),
    (KNEE, '<parent link="L1_lift_link"/><child link="nowhere"/>', "child of joint 'L1_knee'"),
    (KNEE, '<parent link="L1_toe"/><child link="L1_knee_link"/>', "closed chain"),
    (KNEE, '<parent link="L1_lift_link"/><child link="R1_knee_link"/>', "closed chain"),
    # left for xacro
    ('value="4.0"', 'value="${mass}"', "left for xacro"),
    ('name="base_link"', 'name="$(arg base)"', "left for xacro"),
    ("</robot>", "<xacro:leg/></robot>", "left for xacro"),
    # masses
    (BODY, "", "<inertial> without <mass"),
    (BODY, '<mass value=""/>', "expected a number, got ''"),
    (BODY, '<mass value="four"/>', "expected a number, got 'four'"),
    (BODY, '<mass value="nan"/>', "expected a number, got 'nan'"),
    (BODY, '<mass value="4_0"/>', "expected a number, got '4_0'"),
    (BODY, '<mass value="1e9"/>', "kg at most"),
    (BODY, '<mass value="-4"/>', "has the mass -4 kg"),
    (INERTIA, "", "<inertia> without `ixx`"),
    (INERTIA, 'ixx="inf"', "expected a number, got 'inf'"),
    # shapes
    (BOX, "", "<collision> with one shape"),
    (BOX, BOX + CYLINDER, "<collision> with one shape"),
    (BOX, '<cone radius="1" length="1"/>', "<collision> with one shape"),
    (BOX, '<box size="0.4 0.2"/>', "expected three numbers"),
    (BOX, '<box size="0.4 0.2 0"/>', "expected `size` > 0"),
    (BOX, "<box/>", "expected `size` > 0"),
    (BOX, '<box size="400 0.2 0.1"/>', "up to 100 m"),
    (CYLINDER, '<cylinder radius="-0.02" length="0.057"/>', "expected `radius` > 0"),
    (CYLINDER, '<cylinder radius="0.02"/>', "expected `length` > 0"),
    (BOX, "<mesh/>", "<mesh> without `filename`"),
    (BOX, '<mesh filename="missing.stl"/>', "not found"),
    (BOX, '<mesh filename="package://nowhere/a.stl"/>', "package 'nowhere' not found"),
    (BOX, '<mesh filename="http://x/a.stl"/>', "expected package://, file:// or a path"),
    (BOX, '<mesh filename="a.stl" scale="0 1 1"/>', "none of them zero"),
    # places
    ('<origin xyz="0.2 0.12 0"', '<origin xyz="0.2 0.12"', "expected three numbers"),
    ('<origin xyz="0.2 0.12 0"', '<origin xyz="2000 0.12 0"', "expected from -100 to 100 m"),
    ('<origin xyz="0.2 0.12 0"', '<origin xyz="0.2 a 0"', "expected three numbers"),
    ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "expected an axis of some length"),
    ('<axis xyz="0 0 1"/>', '<axis xyz="1"/>', "expected three numbers"),
    # limits
    (LIMIT, LIMIT.replace('upper="1.5"', 'upper="-2"'), "lower < upper"),
    (LIMIT, LIMIT.replace('upper="1.5"', 'upper="1e9"'), "expected bounds"),
    (LIMIT, LIMIT.replace('effort="60.0"', 'effort="0"'), "no torque limit"),
    (LIMIT, LIMIT.replace(' effort="60.0"', ""), "no torque limit"),
    (LIMIT, LIMIT.replace('velocity="5"', 'velocity="-5"'), "no speed limit"),
    (LIMIT, LIMIT.replace('velocity="5"', 'velocity="fast"'), "expected a number"),
    # joints that no leg can have
    (LIFT, '<joint name="L1_lift" type="planar">', "a planar joint"),
    (LIFT, '<joint name="L1_lift" type="floating">', "a floating joint"),
    # joints that slide
    (LIFT, SLIDE + '<limit effort="9" velocity="1"/>', "lower < upper, got 0 and 0 m"),
    (LIFT, SLIDE + '<limit lower="0" upper="1e6" effort="9" velocity="1"/>', "from -100 to 100 m"),
    (LIFT, SLIDE + '<limit lower="0" upper="1" velocity="1"/>', "no force limit"),
    (LIFT, SLIDE + '<limit lower="0" upper="1" effort="9"/>', "max_speed: NUMBER}}` [m/s]"),
    (LIFT, SLIDE + '<axis xyz="0 0 0"/>', "expected an axis of some length"),
    (LIFT, SLIDE + '<limit lower="0.9" upper="1" effort="9" velocity="1"/>', "`posture_m`"),
    # joints that mimic others
    (LIFT, LIFT + '<mimic joint="L1_lift"/>', "mimics 'L1_lift', itself"),
    (LIFT, LIFT + '<mimic joint="L1_knee"/>', "expected 3 to 7 joints"),
    (LIFT, LIFT + '<mimic joint="L1_kne"/>', "mimics 'L1_kne', which is no joint"),
    (LIFT, LIFT + '<mimic joint="R1_yaw"/>', "mimics 'R1_yaw', a joint of R1"),
    (LIFT, LIFT + '<mimic joint="L1_tip"/>', "mimics 'L1_tip', a fixed joint"),
    (LIFT, LIFT + "<mimic/>", "<mimic> without `joint`"),
    (LIFT, LIFT + '<mimic joint="L1_yaw" multiplier="-"/>', "expected a number, got '-'"),
    (LIFT, LIFT + '<mimic joint="L1_yaw" offset="inf"/>', "expected a number, got 'inf'"),
    (LIFT, LIFT + '<mimic joint="L1_yaw" multiplier="1e9"/>', "up to 1000"),
    (LIFT, LIFT + '<mimic joint="L1_yaw" offset="9"/>', "keeps the joints that mimic it within"),
    (LIFT, '<joint name="L1_lift" type="fixed">', "leg L1 has no joint 'L1_lift'"),
    ('<link name="L1_toe"/>', '<link name="L1_foot"/>', "child of joint 'L1_tip'"),
]


def test_there_are_sixty_of_them() -> None:
    assert len({(old, new) for old, new, _ in BROKEN}) >= 60


@pytest.mark.parametrize(("old", "new", "words"), BROKEN)
def test_broken_urdfs_end_with_two(
    run_command: RunCommand, workplace: Path, old: str, new: str, words: str
) -> None:
    sound = Walker(joints=3).text()
    assert old in sound
    (workplace / "walker.urdf").write_text(sound.replace(old, new, 1))
    (workplace / "robot.yaml").write_text(ROBOT)
    outcome = run_command("validate", "robot.yaml")
    assert outcome.code == 2, outcome.err
    assert words in outcome.err
    assert re.search(r"robot\.yaml:\d+: (urdf|legs|packages|joints)", outcome.err)
    # What `new robot` cannot mend it refuses, too; motors and meshes it can
    meshes = "not found" in words or "package" in words
    if meshes or "no torque" in words or "no speed" in words or "legs.L1" in outcome.err:
        return
    refused = run_command("new", "robot", "--urdf", "walker.urdf")
    assert refused.code == 2, refused.err
    assert "internal error" not in refused.err
