"""Robots proposed from URDFs alone: legs, toes, names, motors, postures, locked joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_walkers import QUADRUPED, Walker

from climbplan.errors import SpecError, UsageError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.kinematics import toe_body
from climbplan.robots.serial_chain import SerialChain
from climbplan.robots.urdf.proposal.brace_refinement import refine_braces
from climbplan.robots.urdf.proposal.leg_naming import name_legs
from climbplan.robots.urdf.proposal.lift_torque import (
    BracedStance,
    compute_shifted_utilisation,
    compute_torque_utilisation,
    find_overloaded_joint,
)
from climbplan.robots.urdf.proposal.limbs import find_body_link, find_limbs
from climbplan.robots.urdf.proposal.motors import propose_motors
from climbplan.robots.urdf.proposal.postures import LegModel
from climbplan.robots.urdf.proposal.prepared_robot import RobotProposal
from climbplan.robots.urdf.proposal.propose_robot import propose_robot
from climbplan.schema.robots.source import load_any_robot
from climbplan.schema.robots.urdf.mimics import check_mimics
from climbplan.schema.robots.urdf.tree import parse_urdf


def chain(name: str, start: str, kinds: list[str]) -> str:
    """Links and joints NAME_1, NAME_2, ... from the link `start` on."""
    out, parent = [], start
    for number, kind in enumerate(kinds, 1):
        here = f"{name}_{number}"
        limit = '<limit lower="-1" upper="1" effort="10" velocity="5"/>'
        out.append(
            f'<link name="{here}"/><joint name="{here}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{here}"/><axis xyz="0 1 0"/>{limit if kind != "fixed" else ""}</joint>'
        )
        parent = here
    return "".join(out)


def found_in(body: str) -> tuple[list[list[str]], list[str]]:
    """Joints of the limbs, and shared joints, of a URDF with these parts."""
    tree = parse_urdf(f'<robot name="r"><link name="base"/>{body}</robot>', Path("r.urdf"))
    found = find_limbs(tree, find_body_link(tree))
    return [[j.name for j in limb.joints] for limb in found.limbs], [j.name for j in found.shared]


def test_limbs_end_at_fingers_and_begin_after_a_waist() -> None:
    turn = "revolute"
    waist = chain("waist", "base", [turn])
    arms = chain("left", "waist_1", [turn] * 4) + chain("right", "waist_1", [turn] * 4)
    fingers = chain("thumb", "left_4", [turn] * 2) + chain("index", "left_4", [turn] * 2)
    leg = chain("leg", "base", [turn, "fixed", turn, turn])
    head = chain("head", "base", [turn] * 2)
    pushed = chain("lift", "base", ["prismatic", turn, turn, turn])
    limbs, shared = found_in(waist + arms + fingers + leg + head + pushed)
    assert limbs == [
        ["left_1", "left_2", "left_3", "left_4"],
        ["right_1", "right_2", "right_3", "right_4"],
        ["leg_1", "leg_3", "leg_4"],
    ]
    assert shared == ["waist_1"]


def test_limbs_end_at_joints_that_cannot_move() -> None:
    held = '<limit lower="0" upper="0" effort="10" velocity="5"/>'
    leg = chain("leg", "base", ["revolute"] * 4)
    place = leg.index('<joint name="leg_4"')
    limit = leg.index("<limit", place)
    body = leg[:limit] + held + leg[leg.index("/>", limit) + 2 :]
    assert found_in(body)[0] == [["leg_1", "leg_2", "leg_3"]]


def test_a_fixed_joint_mimics_nothing() -> None:
    leg = chain("leg", "base", ["revolute"] * 3 + ["fixed"]).replace(
        '<child link="leg_4"/>', '<child link="leg_4"/><mimic joint="leg_1"/>'
    )
    assert "<mimic" in leg
    tree = parse_urdf(f'<robot name="r"><link name="base"/>{leg}</robot>', Path("r.urdf"))
    assert tree.joints["leg_4"].mimic is None
    assert check_mimics(tree) == []


def test_more_than_seven_joints_are_locked_from_the_far_end() -> None:
    tree = parse_urdf(
        f'<robot name="r"><link name="base"/>{chain("a", "base", ["revolute"] * 9)}</robot>',
        Path("r.urdf"),
    )
    limb = find_limbs(tree, "base").limbs[0]
    assert [j.name for j in limb.joints] == [f"a_{n}" for n in range(1, 8)]
    assert [j.name for j in limb.locked] == ["a_8", "a_9"]


def test_legs_are_named_round_the_body() -> None:
    hips = np.array([[x, y, 0.0] for y in (0.3, -0.3) for x in (-0.2, 0.2)])
    found = name_legs(hips, list("abcd"), [0] * 4)
    assert [found.names[found.order.index(i)] for i in range(4)] == ["LF", "RF", "LR", "RR"]
    assert found.names == ("RF", "RR", "LR", "LF")
    assert found.gait == ("LR", "LF", "RR", "RF")
    odd = name_legs(hips[:3], list("abc"), [0] * 3)
    assert odd.names == ("a", "b", "c")
    assert not odd.is_by_place


@pytest.fixture(scope="module", name="quadruped")
def _quadruped(tmp_path_factory: pytest.TempPathFactory) -> RobotProposal:
    path = tmp_path_factory.mktemp("quadruped") / "walker.urdf"
    path.write_text(QUADRUPED.text())
    return propose_robot(path)


def test_a_quadruped_stands_as_proposed(quadruped: RobotProposal) -> None:
    robot = quadruped.robot
    assert robot.limb_names == ("RF", "RR", "LR", "LF")
    assert [toe.link for toe in quadruped.toes] == ["R1_toe", "R2_toe", "L2_toe", "L1_toe"]
    # On one level, the centre of mass between the toes, knees above them
    toes = robot.stance_body
    assert np.ptp(toes[:, 2]) < 2e-3
    assert (toes[:2, 0] > 0.05).all()
    assert (toes[2:, 0] < -0.05).all()
    angles = np.array(
        [[np.deg2rad(quadruped.standing[j]) for j in own] for own in robot.limbs.joint_names]
    )
    assert np.allclose(toe_body(robot, angles), toes, atol=1e-6)
    points = robot.limbs.joint_points(angles)
    assert (points[:, :-1, 2] > toes[:, None, 2]).all()
    assert np.allclose(points[:2] * [-1, 1, 1], points[[3, 2]], atol=0.12)  # bent alike
    # Within bounds and torques, with room about every toe
    assert (angles > robot.joint_lower).all()
    assert (angles < robot.joint_upper).all()
    assert robot.stance_radius >= 0.1
    assert quadruped.posture.utilisation < 0.5


def test_braces_hold_with_any_leg_lifted(quadruped: RobotProposal) -> None:
    brace, robot = quadruped.braces[0], quadruped.robot
    assert np.allclose(np.abs(brace.toes[:, 0]), brace.gap / 2)
    assert brace.utilisation < 1
    normal = np.sign(brace.toes) * [-1.0, 0.0, 0.0]
    jacobian = robot.limbs.jacobian(brace.angles)
    contacts = BracedStance(
        brace.toes, normal, jacobian, robot.max_torque, robot.weight, friction=0.8, max_shift=0.2
    )
    assert np.isfinite(compute_torque_utilisation(contacts)[0])
    assert compute_torque_utilisation(replace(contacts, friction=0.05))[0] > 1  # ice
    weak = replace(contacts, torque=0.01 * robot.max_torque)
    share = compute_torque_utilisation(weak)[0]
    assert share > 1
    lack = find_overloaded_joint(share, weak)
    limit = 0.01 * robot.max_torque[lack.limb, lack.joint]
    assert lack.torque == pytest.approx(share * limit, rel=1e-6)


def test_shares_of_a_shifted_body_are_those_of_its_own_angles(quadruped: RobotProposal) -> None:
    brace, robot = quadruped.braces[0], quadruped.robot
    chain = robot.mechanism
    assert isinstance(chain, SerialChain)
    normal = np.sign(brace.toes) * [-1.0, 0.0, 0.0]
    bounds = robot.joint_lower, robot.joint_upper
    jacobian = chain.jacobian(brace.angles)
    contacts = BracedStance(
        brace.toes, normal, jacobian, robot.max_torque, robot.weight, friction=0.8, max_shift=0.0
    )
    still = compute_shifted_utilisation(chain, bounds, brace.angles, contacts)
    assert still[0] == pytest.approx(compute_torque_utilisation(contacts)[0], rel=1e-6)
    free = replace(contacts, max_shift=0.1)
    share, shift, _ = compute_shifted_utilisation(chain, bounds, brace.angles, free)
    assert share <= still[0] + 1e-9
    assert shift <= 0.1 + 1e-9


@pytest.mark.slow
def test_drawn_braces_hold_better_than_those_they_begin_from(quadruped: RobotProposal) -> None:
    robot = quadruped.robot
    chain = robot.mechanism
    assert isinstance(chain, SerialChain)
    low, high = robot.joint_lower, robot.joint_upper
    box = robot.body_hull.min(axis=0), robot.body_hull.max(axis=0)
    reach = np.full(robot.limb_count, robot.reach)
    mirror = quadruped.prepared.legs.mirrored_legs
    begun = [one for one in quadruped.braces if one.friction == 1.0]
    # Motors with which the best that is known just holds
    torque = max(one.utilisation for one in begun) * robot.max_torque
    legs = LegModel(chain, low, high, torque, reach, robot.weight, mirror, box)
    found, least = refine_braces(legs, begun, 0.8, 0.1, lambda points, posture: True)
    assert found
    assert least <= min(one.utilisation for one in found) + 1e-12
    normal = np.sign(found[0].toes) * [-1.0, 0.0, 0.0]
    best = found[0]
    contacts = BracedStance(
        best.toes, normal, chain.jacobian(best.angles), torque, robot.weight, 0.8, 0.1
    )
    share = compute_shifted_utilisation(chain, (low, high), best.angles, contacts)[0]
    assert share == pytest.approx(best.utilisation, rel=1e-6)
    np.testing.assert_allclose(np.abs(found[0].toes[:, 0]), found[0].gap / 2, atol=1e-9)
    assert found == sorted(
        found, key=lambda one: -min(one.reach_margin, 0.06) * (1 - one.utilisation)
    )


def test_a_shift_takes_the_weight_to_the_legs_that_stay() -> None:
    toes = np.array([[0.3, 0.3, -0.4], [0.3, -0.3, -0.4], [-0.3, -0.3, -0.4], [-0.3, 0.3, -0.4]])
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    jacobian, torque = np.tile(np.eye(3), (4, 1, 1)), np.full((4, 3), 1e3)
    contacts = BracedStance(toes, up, jacobian, torque, 100.0, friction=0.7, max_shift=0.2)
    share, shift = compute_torque_utilisation(contacts)
    # 5 % of the weight at every toe: the corner opposite to the lifted one bears 50 % less that
    assert 0.01 < shift < 0.1
    assert share <= 0.1
    assert not np.isfinite(compute_torque_utilisation(replace(contacts, max_shift=0.005))[0])


@pytest.mark.slow
def test_implausible_data_is_named_and_replaced(tmp_path: Path) -> None:
    text = Walker(joints=3, effort=1000.0).text()
    path = tmp_path / "walker.urdf"
    path.write_text(text.replace('velocity="', 'velocity="9', 1))
    found = propose_robot(path)
    assert any("effort 1000 N m" in note and "ASSUMED" in note for note in found.implausible)
    own = found.draft.joints["L1_yaw"]
    assert own["max_torque"] < 100
    assert found.robot.max_torque.max() < 100


def test_speeds_that_no_urdf_says_go_by_size() -> None:
    tree = parse_urdf(
        Walker(joints=3).text().replace('velocity="', 'velocity="9000'), Path("r.urdf")
    )
    joints = tuple(joint for joint in tree.joints.values() if joint.velocity)[:3]
    short, long = (propose_motors([joints], np.array([reach]), 100.0) for reach in (0.25, 1.0))
    fast, slow = (next(iter(own.joints.values())).max_speed for own in (short, long))
    assert fast is not None
    assert slow is not None
    assert slow == pytest.approx(3.5 * np.sqrt(9.81), rel=0.02)
    assert fast == pytest.approx(2 * slow, rel=0.05)
    assert any("rad/s ASSUMED" in note for note in short.implausible)


def test_massless_links_and_missing_meshes_are_told(tmp_path: Path) -> None:
    path = tmp_path / "walker.urdf"
    path.write_text(Walker(link_mass=0.0, mesh="package://nowhere/base.stl").text())
    found = propose_robot(path)
    assert any("12 of 12 moving links have no mass" in note for note in found.implausible)
    assert any("nowhere" in note for note in found.assumptions)
    assert found.half_size is not None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('<robot name="r"><link name="base"/></robot>', "found 0"),
        (
            f'<robot name="r"><link name="base"/>{chain("a", "base", ["revolute"] * 3)}</robot>',
            "found 1",
        ),
    ],
)
def test_what_cannot_be_proposed(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(text)
    with pytest.raises(UsageError, match=words):
        propose_robot(path)


def test_mistakes_of_the_urdf_have_lines(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text('<robot name="r">\n<link name="a"/>\n<link name="a"/>\n</robot>')
    with pytest.raises(SpecError, match=r"r\.urdf:3"):
        propose_robot(path)


def waisted(tmp_path: Path, locked: str) -> Path:
    """A walker whose front legs hang on a waist."""
    text = Walker(joints=3).text()
    joint = (
        '<link name="chest"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" '
        'iyz="0" izz="1"/></inertial></link><joint name="waist" type="revolute">'
        '<parent link="base_link"/><child link="chest"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="10" velocity="5"/></joint></robot>'
    )
    text = text.replace("</robot>", joint)
    for leg in ("L1", "R1"):
        at = text.index(f'<joint name="{leg}_yaw"')
        text = text[:at] + text[at:].replace(
            '<parent link="base_link"/>', '<parent link="chest"/>', 1
        )
    (tmp_path / "walker.urdf").write_text(text)
    legs = "".join(
        f"  {n}: {{toe: {n}_toe, posture_deg: {{{n}_lift: 30, {n}_knee: 20}}}}\n"
        for n in ("L1", "R1", "L2", "R2")
    )
    path = tmp_path / "robot.yaml"
    path.write_text(f"kind: robot\nurdf: walker.urdf\n{locked}legs:\n{legs}")
    return path


def test_a_shared_joint_can_be_locked(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match=r"moves L1 and R1 together.*`locked: {waist: DEGREES}`"):
        load_any_robot(waisted(tmp_path, ""))
    straight = build_robot(load_any_robot(waisted(tmp_path, "locked: {waist: 0}\n")))
    turned = build_robot(load_any_robot(waisted(tmp_path, "locked: {waist: 30}\n")))
    assert "waist" not in {j for own in straight.limbs.joint_names for j in own}
    # The front legs are turned about the waist's axis, the rear ones stay
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    middle = straight.shoulder_body[:2].mean(axis=0) - [0, 0.2, 0]  # the base's origin
    expected = (straight.shoulder_body[:2] - middle) @ turn.T
    rear = turned.shoulder_body[2:].mean(axis=0)
    moved = turned.shoulder_body[:2] - rear - [0, 0.2, 0]
    assert np.allclose(moved[:, :2], expected[:, :2], atol=1e-9)


@pytest.mark.parametrize(
    ("locked", "words"),
    [
        ("locked: {wast: 0}\n", "no joint 'wast'.*did you mean 'waist'"),
        ("locked: {waist: 90}\n", "within the joint's bounds"),
        ("locked: {waist: 0}\njoints: {waist: {stiffness: 5}}\n", "locked: it has no limits"),
        ("locked: {waist: 0, L1_tip: 0}\n", "a fixed joint.*expected one that turns"),
    ],
)
def test_mistakes_of_locked_joints(tmp_path: Path, locked: str, words: str) -> None:
    with pytest.raises(SpecError, match=words):
        load_any_robot(waisted(tmp_path, locked))
