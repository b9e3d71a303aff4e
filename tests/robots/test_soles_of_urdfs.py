"""Bipeds from their URDF alone: soles by collision geometry, and how they stand on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from climbplan.cli.app import run
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.climb.simulation.replay import simulate
from climbplan.errors import UsageError
from climbplan.robots.urdf.proposal.propose_robot import detect_legs, propose_robot
from climbplan.simulation.conditions import NOMINAL

BIPED = Path(__file__).parents[2] / "specs" / "biped.urdf"
FOOT = (
    '<collision><origin xyz="0.03 0 -0.045"/><geometry><box size="0.22 0.11 0.03"/>'
    "</geometry></collision>"
)
BALL = (
    '<collision><origin xyz="{x} {y} -0.05"/><geometry><sphere radius="0.01"/>'
    "</geometry></collision>"
)


def biped(path: Path, foot: str) -> Path:
    """The biped with other collision geometry of its feet."""
    text = BIPED.read_text()
    assert text.count(FOOT) == 2
    path.write_text(text.replace(FOOT, foot))
    return path


def test_a_sole_is_the_level_face_under_the_foot() -> None:
    found = detect_legs(BIPED)
    assert found.draft.sole == (0.22, 0.11)
    assert found.naming.names == ("R", "L")
    for toe in found.toes:
        # The links of the soles are in their middles
        assert toe.link.endswith("_sole")
        np.testing.assert_allclose(toe.offset, 0.0, atol=1e-9)
    assert found.soles is not None
    np.testing.assert_allclose(found.soles.axes_zero, np.eye(3)[None].repeat(2, 0), atol=1e-9)


def test_balls_at_corners_bear_as_a_sole(tmp_path: Path) -> None:
    corners = [(-0.05, -0.03), (-0.05, 0.03), (0.11, -0.02), (0.11, 0.02)]
    balls = "".join(BALL.format(x=x, y=y) for x, y in corners)
    found = detect_legs(biped(tmp_path / "balls.urdf", balls))
    assert found.draft.sole is not None
    length, width = found.draft.sole
    # The largest rectangle of the shape of its extents, 160 x 60 mm, inside of the trapezoid:
    # at the half length s 80 mm ahead it is 40 + 20 (1 - s) / 2 mm wide, which is s 60 mm
    share = 50 / 70
    assert length == pytest.approx(share * 0.16, abs=1e-3)
    assert width == pytest.approx(share * 0.06, abs=1e-3)
    # 10 mm under the balls' centres
    assert found.toes[0].offset == pytest.approx((0.0, 0.0, 0.0), abs=1e-4)


def with_arms(path: Path) -> Path:
    """The biped with two arms of three joints on its shoulders, hanging at its sides."""
    parts = []
    for side, sign in (("L", 1), ("R", -1)):
        parent = "trunk"
        for number, (axis, place) in enumerate(
            (("0 1 0", f"0 {0.25 * sign} 0.5"), ("1 0 0", "0 0 0"), ("0 1 0", "0 0 -0.25"))
        ):
            link = f"{side}_arm{number}"
            parts.append(
                f'<joint name="{link}" type="revolute"><parent link="{parent}"/><child '
                f'link="{link}"/><origin xyz="{place}"/><axis xyz="{axis}"/><limit lower="-1.5" '
                f'upper="1.5" effort="40" velocity="8"/></joint><link name="{link}"><inertial>'
                '<origin xyz="0 0 -0.1"/><mass value="0.5"/><inertia ixx="2e-3" ixy="0" ixz="0" '
                'iyy="2e-3" iyz="0" izz="2e-3"/></inertial><collision><origin xyz="0 0 -0.12"/>'
                '<geometry><cylinder radius="0.03" length="0.2"/></geometry></collision></link>'
            )
            parent = link
    path.write_text(BIPED.read_text().replace("</robot>", "".join([*parts, "</robot>"])))
    return path


def test_a_robot_with_arms_stands_on_its_two_flat_feet(tmp_path: Path) -> None:
    path = with_arms(tmp_path / "arms.urdf")
    assert sum(detect_legs(path).naming.is_arm) == 2
    found = propose_robot(path)
    assert found.naming.names == ("R", "L")
    assert found.draft.sole == (0.22, 0.11)
    assert any("--toes" in note and "arm" in note for note in found.assumptions)


@pytest.mark.parametrize("foot", ["", BALL.format(x=0, y=0)])
def test_without_a_level_face_two_legs_are_refused(tmp_path: Path, foot: str) -> None:
    with pytest.raises(UsageError, match="no level face of 20 mm or more"):
        detect_legs(biped(tmp_path / "point.urdf", foot))


@pytest.mark.parametrize(
    ("toes", "words"),
    [
        ("L_sole", "two different links or more"),
        ("L_sole,L_sole", "two different links or more"),
        ("L_sole,", "two different links or more"),
        ("L_sole,R_sol", "no link 'R_sol', did you mean 'R_sole'"),
        ("L_sole,trunk", "link 'trunk' is moved by 0 joints of its own, expected 3 or more"),
        ("L_sole,L_foot", "joints of its own, expected 3 or more"),
        ("L_shin,R_shin", "two of at least 6 with flat feet"),
    ],
)
def test_toes_that_cannot_be_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], toes: str, words: str
) -> None:
    assert run(["new", "robot", "--urdf", str(BIPED), "--toes", toes, str(tmp_path)]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_toes_are_of_a_urdf(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["new", "climb", "--toes", "a,b", str(tmp_path)]) == 2
    assert "--urdf or --package" in capsys.readouterr().err


def test_motors_too_weak_for_one_leg_are_told(tmp_path: Path) -> None:
    weak = tmp_path / "weak.urdf"
    weak.write_text(BIPED.read_text().replace('effort="120"', 'effort="6"'))
    with pytest.raises(UsageError, match=r"need [\d.]+ times their torque limits on one leg"):
        propose_robot(weak)


@pytest.mark.slow
def test_a_biped_stands_as_proposed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["new", "robot", "--urdf", str(BIPED), str(tmp_path)]) == 0
    assert "walks on ground: verified" in capsys.readouterr().err
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"biped.yaml", "biped_ground.yaml", "biped.html"}
    assert "220 x 110 mm" in (tmp_path / "biped.html").read_text()
    plan = plan_climb(load_climb(tmp_path / "biped_ground.yaml", ()))
    run_of_it = simulate(plan, NOMINAL)
    assert not run_of_it.fallen


@pytest.mark.slow
def test_the_pace_asked_for_does_not_rock_flat_feet() -> None:
    fast = plan_climb(load_climb(BIPED.parent / "climb_biped.yaml", ("trajectory.speed=0.1",)))
    assert not simulate(fast, NOMINAL).fallen
