"""`new robot --urdf`: from a URDF alone to files that plan as they are."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from mjcf_walkers import write_nested_defaults_model
from urdf_walkers import Walker

import climbplan
from climbplan.api.new_robot import new_robot
from climbplan.cli.app import run
from climbplan.errors import UsageError
from climbplan.robots.any_robot import build_robot
from climbplan.robots.urdf.proposal.package_urdfs import find_package_urdf
from climbplan.robots.urdf.proposal.propose_robot import propose_robot
from climbplan.schema.robots.source import load_any_robot


@pytest.fixture(scope="module", name="folder")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which `new robot` was run on a quadruped's URDF in another one beside it."""
    place = tmp_path_factory.mktemp("robots")
    (place / "urdf").mkdir()
    Walker(joints=3).write(place / "urdf" / "walker.urdf")
    assert (
        run(["new", "robot", "--urdf", str(place / "urdf/walker.urdf"), str(place / "mine")]) == 0
    )
    return place / "mine"


@pytest.mark.slow
def test_the_specs_plan_as_they_are(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sorted(path.name for path in folder.iterdir()) == [
        "walker4.html",
        "walker4.yaml",
        "walker4_chimney.yaml",
        "walker4_ground.yaml",
        "walker4_walk.yaml",
        "walker4_wall.yaml",
    ]
    for spec in ("ground", "chimney", "wall", "walk"):
        plan = climbplan.plan(folder / f"walker4_{spec}.yaml")
        assert plan.verify().passed
        assert spec != "ground" or "found by" not in " ".join(plan.notes)  # not by trials


@pytest.mark.slow
def test_the_robot_file_is_commented_and_names_its_urdf_by_place(folder: Path) -> None:
    text = (folder / "walker4.yaml").read_text()
    assert 'urdf: "../urdf/walker.urdf"' in text
    assert "ASSUMED" in text
    assert "joint_stiffness" in text
    robot = build_robot(load_any_robot(folder / "walker4.yaml"))
    assert robot.limb_names == ("RF", "RR", "LR", "LF")
    assert robot.mass == pytest.approx(4.0 + 12 * 0.2)


@pytest.mark.slow
def test_the_page_shows_both_postures(folder: Path) -> None:
    page = (folder / "walker4.html").read_text()
    assert page.count("data:image/png") == 2
    assert "walks on ground" in page
    assert "climbs between walls" in page
    assert "goes from the ground to walls" in page
    assert "walks at speed" in page
    assert "L1_knee" in page
    assert "IMPLAUSIBLE" not in page or "their limbs go on" in page
    assert "<script" not in page


@pytest.mark.slow
def test_an_mjcf_model_leads_to_specs_that_plan(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    path = tmp_path / "model.xml"
    path.write_text(write_nested_defaults_model(), encoding="utf-8")
    assert run(["new", "robot", "--urdf", str(path), str(tmp_path / "mine")]) == 0
    text = (tmp_path / "mine" / "nested_quadruped.yaml").read_text()
    assert 'urdf: "../model.xml"' in text
    for spec in ("ground", "chimney", "wall", "walk"):
        plan = climbplan.plan(tmp_path / "mine" / f"nested_quadruped_{spec}.yaml")
        assert plan.verify().passed
    simulation = climbplan.plan(tmp_path / "mine" / "nested_quadruped_ground.yaml").simulate()
    assert simulation.passed


def test_a_file_that_exists_is_told_before_anything_is_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Walker(joints=3).write(tmp_path / "walker.urdf")
    (tmp_path / "walker4_wall.yaml").write_text("mine")

    def propose_nothing(*_: object) -> None:
        raise AssertionError("nothing is proposed")

    monkeypatch.setattr("climbplan.api.new_robot.propose_robot", propose_nothing)
    assert run(["new", "robot", "--urdf", str(path), str(tmp_path)]) == 2
    assert "walker4_wall.yaml: already exists; --force replaces it" in capsys.readouterr().err


@pytest.mark.slow
def test_motors_that_cannot_stand_are_told_in_newton_metres(tmp_path: Path) -> None:
    path = Walker(joints=3, effort=0.5).write(tmp_path / "weak.urdf")
    with pytest.raises(UsageError, match=r"times their torque limits .* N m, and has 0\.5 N m"):
        propose_robot(path)


@pytest.mark.slow
def test_motors_that_hold_nothing_are_told(tmp_path: Path) -> None:
    path = Walker(joints=3, effort=0.5).write(tmp_path / "weak.urdf")
    with pytest.raises(UsageError, match="no posture in which it stands"):
        new_robot(path, tmp_path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["climb", "--urdf", "walker.urdf"], "for `new robot`"),
        (["robot", "--urdf", "a.urdf", "--package", "b"], "expected one of"),
        (["robot", "--package", "no-such-package"], "no Python package"),
        (["robot", "--urdf", "missing.urdf"], "no such file"),
    ],
)
def test_mistakes_end_with_two(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["new", *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow
def test_nothing_is_overwritten(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "walker4.yaml").read_text()
    (folder / "walker4.yaml").write_text("mine")
    urdf = folder.parent / "urdf/walker.urdf"
    assert run(["new", "robot", "--urdf", str(urdf), str(folder)]) == 2
    assert "--force" in capsys.readouterr().err
    assert (folder / "walker4.yaml").read_text() == "mine"
    (folder / "walker4.yaml").write_text(before)


def test_urdfs_of_packages() -> None:
    try:
        distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    assert find_package_urdf("example-robot-data:solo12").name == "solo12.urdf"
    assert (
        find_package_urdf("example-robot-data:anymal_c").parts[-3] == "anymal_c_simple_description"
    )
    # As the list of what there is calls them
    for name in ("anymal_b_simple_description/anymal", "solo_description/solo12"):
        assert find_package_urdf(f"example-robot-data:{name}").stem == name.partition("/")[2]
    assert find_package_urdf("example-robot-data:robots/solo12.urdf").name == "solo12.urdf"
    with pytest.raises(UsageError, match=r"solo_description/solo, solo_description/solo12"):
        find_package_urdf("example-robot-data:solo_")
    with pytest.raises(UsageError, match="--package example-robot-data:PART"):
        find_package_urdf("example-robot-data:no_such_robot")


@pytest.mark.slow
@pytest.mark.timeout(1800)  # each is walked, climbed and judged in hundreds of worlds
@pytest.mark.parametrize("part", ["a1_desc", "go2"])
def test_robots_of_a_package_walk_and_climb(part: str, tmp_path: Path) -> None:
    try:
        urdf = find_package_urdf(f"example-robot-data:{part}")
    except UsageError:
        pytest.skip("example-robot-data is not installed")
    made = new_robot(urdf, tmp_path)
    columns = ("walks on ground", "climbs between walls", "goes from the ground to walls")
    for what, note in zip(columns, made.notes[-4:-1], strict=True):
        assert re.fullmatch(f"{what}: verified, (but )?stands in \\d+ of \\d+ worlds .*", note)
    assert made.notes[-1].startswith("walks at speed: verified, ")
