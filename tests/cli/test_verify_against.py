"""`verify PLAN --spec SPEC`: a plan whose stored spec asks for less than its user's is caught."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from command_line import RunCommand

from climbplan.climb.plan.file import write_climb
from climbplan.climb.planner.planner import plan_climb
from climbplan.climb.schema.loading import load_climb
from climbplan.schema.robots.source import read_robot_text
from climbplan.schema.yaml_source import parse_yaml, write_yaml

SPECS = Path(__file__).parents[2] / "specs"
SMALL = Path(__file__).parents[1] / "schema" / "small_climb.yaml"
Make = Callable[..., Path]


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The user's spec, in a folder of its own beside that of its robot."""
    place = tmp_path_factory.mktemp("own")
    value = parse_yaml(SMALL.read_text(encoding="utf-8"), "small").value
    del value["study"], value["task"]["goal"]["toes"]
    value["robot"] = "../robots/climber.yaml"
    for name in ("specs", "robots"):
        (place / name).mkdir()
    (place / "robots" / "climber.yaml").write_text(read_robot_text("silvia"), encoding="utf-8")
    path = place / "specs" / "own.yaml"
    path.write_text(write_yaml(value), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def made(own: Path, tmp_path_factory: pytest.TempPathFactory) -> Make:
    """Plans of that spec with other values, each made once."""
    plans: dict[tuple[str, ...], Path] = {}

    def make(*assignments: str) -> Path:
        if assignments not in plans:
            path = tmp_path_factory.mktemp("made") / "plan.h5"
            write_climb(plan_climb(load_climb(own, list(assignments))), path)
            plans[assignments] = path
        return plans[assignments]

    return make


def test_a_plan_of_the_same_spec_passes(run_command: RunCommand, own: Path, made: Make) -> None:
    done = run_command("verify", str(made()), "--spec", str(own))
    assert done.code == 0, done.out
    first, second, third = done.out.splitlines()[:3]
    assert first == "verified"
    assert second.startswith("fine: ")
    assert third.startswith("spec ")
    assert third.endswith(f"…  {own}")
    alone = run_command("verify", str(made())).out.splitlines()
    assert alone[2] == f"{third.partition('…')[0]}…  stored in the plan (own)"


@pytest.mark.parametrize(
    ("assignment", "key", "check"),
    [
        ("force.safety_friction=1.0", "force.safety_friction", "force.friction"),
        ("task.rounds=3", "task.rounds", "file.spec_values"),
        ("task.goal.com=[0, 0, 0.05]", "task.goal.com", "file.spec_values"),
        ("terrain.walls.gap=1.22", "terrain.walls.gap", "terrain.spec"),
        ("terrain.friction=1.2", "terrain.friction", "terrain.spec"),
        ("task.payload.mass=0", "task.payload.mass", "file.spec_values"),
        ("posture.limb_clearance=0.001", "posture.limb_clearance", "spec.differences"),
    ],
)
def test_a_laxened_plan_passes_alone_and_fails_against_the_users_spec(
    run_command: RunCommand, own: Path, made: Make, assignment: str, key: str, check: str
) -> None:
    plan = made(assignment)
    assert run_command("verify", str(plan)).code == 0
    done = run_command("verify", str(plan), "--spec", str(own), "--json")
    assert done.code == 5
    told = json.loads(done.out)
    assert told["badge"] == "not verified"
    failed = {c["name"] for c in told["checks"] if c["result"] == "failed"}
    assert check in failed
    differences = told["verified_against"]["differences"]
    assert key in {d["key"] for d in differences}
    lines = run_command("verify", str(plan), "--spec", str(own)).out.splitlines()
    assert any(f"  {key}: plan's spec" in line and "yours" in line for line in lines)
    same = run_command("verify", str(plan), "--spec", str(own), "-s", assignment)
    assert same.code == 0, same.out


def test_a_plan_made_for_more_is_good_for_less(
    run_command: RunCommand, own: Path, made: Make
) -> None:
    done = run_command("verify", str(made()), "--spec", str(own), "-s", "force.safety_friction=1.5")
    assert done.code == 0, done.out
    assert "(the plan's own is " in done.out
    assert "differs in 1 key)" in done.out
    assert "force.safety_friction: plan's spec 1.8, yours 1.5" in done.out


def test_another_robot_than_the_users_is_caught(
    run_command: RunCommand, own: Path, made: Make, tmp_path: Path
) -> None:
    """The plan carries its robot's file and so passes alone; paths start from the spec's folder."""
    folder = tmp_path / "elsewhere"
    shutil.copytree(own.parents[1], folder)
    robot = folder / "robots" / "climber.yaml"
    text = robot.read_text(encoding="utf-8")
    value = parse_yaml(text, "robot").value
    value["limbs"][0]["max_torque"] = [2 * t for t in value["limbs"][0]["max_torque"]]
    robot.write_text(write_yaml(value), encoding="utf-8")
    theirs = folder / "specs" / own.name
    plan = tmp_path / "plan.h5"
    write_climb(plan_climb(load_climb(theirs)), plan)
    assert run_command("verify", str(plan)).code == 0
    done = run_command("verify", str(plan), "--spec", str(own))
    assert done.code == 5
    assert "robot.max_torque" in done.out
    assert run_command("verify", str(plan), "--spec", str(theirs)).code == 0


def test_joint_bounds_widened_with_the_carried_file_are_caught(
    run_command: RunCommand, own: Path, made: Make, tmp_path: Path
) -> None:
    plan = tmp_path / "plan.h5"
    shutil.copy(made(), plan)
    with h5py.File(plan, "r+") as file:
        value = parse_yaml(str(file["robot"].attrs["source"]), "robot").value
        for limb in value["limbs"]:
            limb["joint_upper_deg"] = [179.0] * 3
        file["robot"].attrs["source"] = write_yaml(value)
        file["robot/joint_upper"][...] = 3.12413936106985
    assert run_command("verify", str(plan)).code == 0
    done = run_command("verify", str(plan), "--spec", str(own))
    assert done.code == 5
    assert "robot.joint_upper" in done.out


def test_what_the_planner_chose_is_no_difference_that_counts(
    run_command: RunCommand, own: Path, made: Make
) -> None:
    plan = made("trajectory.swing_clearance=0.04")
    done = run_command("verify", str(plan), "--spec", str(own))
    assert done.code == 0, done.out
    assert (
        "trajectory.swing_clearance: plan's spec 0.04, yours 0.05 (left out: the planner's"
        in done.out
    )
    written = run_command(
        "verify", str(plan), "--spec", str(own), "-s", "trajectory.swing_clearance=0.05"
    )
    assert written.code == 5


def test_usage(run_command: RunCommand, own: Path, made: Make) -> None:
    plan = str(made())
    other = run_command("verify", plan, "--spec", str(SPECS / "mpc_forward.yaml"))
    assert other.code == 2
    assert "a spec of kind `mpc`" in other.err
    assert run_command("verify", plan, "-s", "task.rounds=3").code == 2
    assert run_command("verify", plan, "--spec", "none.yaml").code == 2
    assert run_command("verify", plan, "--spec", str(own), "-s", "task.roundz=3").code == 2


def test_walks(run_command: RunCommand) -> None:
    spec = str(SPECS / "mpc_forward.yaml")
    lax = ["-s", "task.integrator=euler", "-s", "terrain.friction=2.5"]
    done = run_command("plan-mpc", spec, "--method", "mpcc", *lax, "-o", "walk")
    assert done.code == 5, done.err
    assert done.err.splitlines()[0].startswith("warning: implausible: friction 2.5 of the ground")
    assert "verified in its model (implausible data, forward Euler)" in done.err
    assert "leaves out" in done.err
    assert "walk/plan.h5 must not be used: implausible: friction 2.5 of the ground" in done.err
    page = Path("walk/report.html").read_text(encoding="utf-8")
    assert page.index("friction 2.5 of the ground") < page.index("<h1>")
    assert (
        '<span class="badge bad">verified in its model (implausible data, forward Euler)</span>'
        in page
    )
    report = json.loads(Path("walk/report.json").read_text(encoding="utf-8"))
    assert report["verified"] is True
    assert report["level"] == "do_not_use"
    assert '<p class="level bad"><strong>do not use</strong>: data or deflections' in page
    assert report["verified_in"] == "implausible data, forward Euler"
    checked = run_command("verify", "walk")
    assert checked.code == 5
    assert checked.out.splitlines()[1].startswith("do not use: ")
    held = run_command("verify", "walk", "--spec", spec)
    assert held.code == 5
    assert "task.integrator: plan's spec 'euler', yours 'mean'" in held.out
    assert "terrain.friction: plan's spec 2.5, yours 1" in held.out
    own = run_command("verify", "walk", "--spec", spec, *lax)
    assert own.code == 5
    assert "FAILED" not in own.out


def test_books_one_and_many(run_command: RunCommand) -> None:
    spec = str(SPECS / "bookshelf_scene.yaml")
    thin = ["-s", "scene.insert.width_mm=14"]
    assert run_command("solve-bookshelf", spec, *thin, "-o", "thin").code == 0
    assert run_command("verify", "thin").code == 0
    held = run_command("verify", "thin", "--spec", spec)
    assert held.code == 5
    assert "scene.insert.width_mm: plan's spec 14, yours" in held.out
    assert run_command("verify", "thin", "--spec", spec, *thin).code == 0
    many = str(SPECS / "bookshelf_file.yaml")
    assert run_command("solve-bookshelf", many, "-o", "many").code == 0
    alone = run_command("verify", "many")
    assert alone.out.startswith("verified in its model (scenes as stored)\n")
    assert run_command("verify", "many", "--spec", many).out.startswith("verified\n")


def test_modules_say_that_they_have_no_mass(run_command: RunCommand) -> None:
    spec = str(SPECS / "limms_throw.yaml")
    done = run_command("plan-limms", spec, "-s", "box.mass=0.5", "-o", "throw")
    assert done.code == 0, done.err
    words = "modules have no mass: one weighs 40.6 N, 2.0 times the 20 N that a contact is said to"
    assert words in done.err
    assert words in Path("throw/report.html").read_text(encoding="utf-8")
    held = run_command("verify", "throw", "--spec", spec)
    assert held.code == 5
    assert "box.mass: plan's spec 0.5, yours" in held.out
    assert run_command("verify", "throw", "--spec", spec, "-s", "box.mass=0.5").code == 0


def test_a_dataset_has_no_one_spec_to_be_held_against(run_command: RunCommand) -> None:
    few = ["-s", "count=2", "-o", "data"]
    assert run_command("gen-data", str(SPECS / "dataset_bookshelf.yaml"), *few).code == 0
    done = run_command("verify", "data", "--spec", str(SPECS / "dataset_bookshelf.yaml"))
    assert done.code == 2
    assert "a dataset, which cannot be verified against --spec" in done.err
