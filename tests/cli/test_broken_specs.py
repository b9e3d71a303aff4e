"""Broken specs and files: each named with its line, none a traceback, nothing left behind."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest
from command_line import RunCommand

from climbplan.schema.examples import read_example

# (what stands in the good spec, what breaks it, text on the line at fault, what is said)
BROKEN = {
    "typo in a key": ("rounds: 2", "rouns: 2", "rouns", "did you mean 'rounds'?"),
    "typo in a section": ("terrain:\n", "terain:\n", "terain", "did you mean 'terrain'?"),
    "key at the wrong level": ("seed: 1", "friction: 1", "friction: 1", "belongs under `terrain`"),
    "unknown key": ("seed: 1", "colour: red", "colour", "unknown key"),
    "key left out": ("  friction: 0.9\n", "", "terrain:", "terrain.friction: missing"),
    "section left out": ("  goal:", "  # goal:", "task:", "task.goal: missing"),
    "wrong unit": ("gap: 1.23", "gap: 1230 mm", "gap", "expected a number in m > 0.*write 1.23"),
    "decimal comma": ("gap: 1.23", "gap: 1,23", "gap", "write 1.23"),
    "text for a number": ("mass: 0.5", "mass: heavy", "mass", "expected a number in kg"),
    "number for text": ("robot: silvia", "robot: 5", "robot", "expected text or a .*, got 5"),
    "NaN": ("gap: 1.23", "gap: .nan", "gap", "got .nan"),
    "NaN in a vector": ("com: [0.0, 0.0, 0.1]", "com: [0, 0, .nan]", "nan", r"task.goal.com.2"),
    "NaN weight": ("seed: 1", "posture: {weights: {goal: .nan}}", "posture", "weights.goal"),
    "infinity": ("gap: 1.23", "gap: .inf", "gap", "got .inf"),
    "beyond doubles": ("gap: 1.23", "gap: 1e999", "gap", "got .inf"),
    "absurd size": ("gap: 1.23", "gap: 1e300", "gap", "numbers end at"),
    "endless digits": ("rounds: 2", "rounds: " + "1" * 5000, "rounds", "5000 digits"),
    "zero rounds": ("rounds: 2", "rounds: 0", "rounds", "expected a whole number >= 1"),
    "negative rounds": ("rounds: 2", "rounds: -3", "rounds", "got -3"),
    "half a round": ("rounds: 2", "rounds: 1.5", "rounds", "expected a whole number"),
    "truth for a number": ("rounds: 2", "rounds: true", "rounds", "got true"),
    "negative payload": ("mass: 0.5", "mass: -0.5", "mass", "expected a number in kg >= 0"),
    "zero friction": ("friction: 0.9", "friction: 0", "friction", "expected a number > 0"),
    "safety below one": ("friction: 1.8", "friction: 0.5", "safety", "expected a number >= 1"),
    "two coordinates": ("com: [0.0, 0.0, 0.1]", "com: [0, 0]", "com: [0, 0]", "three numbers"),
    "four coordinates": ("rpy_deg: [0, 0, 0]", "rpy_deg: [0, 0, 0, 1]", "rpy", "three numbers"),
    "mapping for a vector": ("com: [0.0, 0.0, 0.1]", "com: {x: 0}", "com: {x", "three numbers"),
    "unit in the name": ("rpy_deg: [0, 0, 0]", "rpy_rad: [0, 0, 0]", "rpy_rad", "unknown key"),
    "unknown method": ("method: micp", "method: magic", "magic", "one of `auto`, `micp`, `nlp`"),
    "unknown solver": (
        "method: micp", "posture_solver: cplex", "cplex", "one of `branch-and-bound`"
    ),
    "empty region": ("width: 0.4", "width: 0", "width", "expected a number in m > 0"),
    "no direction": ("normal: [-1, 0, 0]", "normal: [0, 0, 0]", "normal", "expected a direction"),
    "no surface": ("  walls:\n", "  Walls:\n", "Walls", "did you mean 'walls'?"),
    "empty walls": ("up: [-1.0, 2.0]", "up: [2.0, -1.0]", "up", "from < to"),
    "walls that meet": ("gap: 1.23", "angle_deg: 120\n    gap: 1.23", "along", "the walls meet"),
    "toe off its wall": ("0.615, 0.33, -0.02", "0.5, 0.33, -0.02", "RF: ", "115.00 mm off"),
    "toe above its wall": ("0.615, 0.33, -0.02", "0.615, 0.33, 9.0", "RF: ", "7000.00 mm off"),
    "unknown limb": ("      RF:", "      RX:", "RX", "has no limb 'RX'"),
    "unknown limb of a region": ("limbs: [RF, RM]", "limbs: [XX]", "XX", "has no limb 'XX'"),
    "limb twice in the gait": ("gait: [RF, RM", "gait: [RF, RF", "gait", "each limb once"),
    "limb left out of the gait": ("RR, LR, LM, LF]", "RR, LR, LM]", "gait", "each limb once"),
    "unknown robot": ("robot: silvia", "robot: slivia", "robot", "did you mean 'silvia'?"),
    "robot file that is none": ("robot: silvia", "robot: r.yaml", "robot", "no such file"),
    "robot that is a climb": ("robot: silvia", "robot: small.yaml", None, "got a `climb`"),
    "URDF robot": ("robot: silvia", "robot: silvia.urdf", "robot", "path of a robot YAML file"),
    "unknown kind": ("kind: climb", "kind: swim", "kind", "one of `climb`, .*`bookshelf`"),
    "kind of another command": ("kind: climb", "kind: robot", "kind", "expected a spec of kind"),
    "no kind": ("kind: climb\n", "", "title", "kind: missing"),
    "double key": ("seed: 1", "seed: 1\nseed: 2", "seed: 1", "appears twice"),
    "tag that runs code": (
        "rounds: 2", "rounds: !!python/object/apply:os.system ['touch pwned']", "rounds",
        "tag !!python/object/apply:os.system is not allowed",
    ),
    "own tag": ("rounds: 2", "rounds: !climb 2", "rounds", "tag !climb is not allowed"),
    "tab": ("  rounds: 2", "\trounds: 2", "rounds", "a tab in the indentation"),
    "open list": ("rpy_deg: [0, 0, 0]", "rpy_deg: [0, 0, 0", "toes:", "not valid YAML"),
    "open quote": ("title: two", "title: 'two", None, "a quote is not closed"),
    "unknown alias": ("seed: 1", "seed: *one", "seed", "an alias without its anchor"),
    "two documents": ("seed: 1", "---\nseed: 1", "---", "a second document"),
    "escape out of range": ("title: two", 'title: "\\Uffffffff" #', "title", "out of range"),
    "control character": ("title: two", 'title: "\\x00" #', "title", "control character"),
    "half a surrogate": ("title: two", 'title: "\\ud800" #', "title", "control character"),
    "deep nesting": ("seed: 1", "seed: " + "[" * 50_000, "seed", "nested deeper"),
    "alias bomb": (
        "seed: 1",
        "a: &a [0,0,0,0,0,0,0,0]\n" + "\n".join(
            f"{y}: &{y} [*{x},*{x},*{x},*{x},*{x},*{x},*{x},*{x}]"
            for x, y in zip("abcdefg", "bcdefgh", strict=True)
        ),
        None, "once aliases are expanded",
    ),
    "alias in itself": ("seed: 1", "seed: &a [*a]", "seed", "nested deeper"),
    "study of nothing": ("terrain.friction: [0.7, 0.9]", "x: []", "grid", "at least one number"),
    "study of an unknown key": ("terrain.friction:", "terrain.mu:", "terrain.mu", "unknown key"),
    "study of a text": ("terrain.friction:", "robot:", "robot: [", "dotted key of one number"),
    "study with a bad value": ("[0, 1e-1]", "[0, -1]", "task.payload.mass", "got -1"),
    "least step with micp": (
        "seed: 1", "posture: {steps: {toe_min: 0.01}}", "posture", "use `--method nlp`"
    ),
    "steps that exclude each other": (
        "seed: 1", "posture: {steps: {com_min: 0.2}}", "posture", "expected less than com_max 0.15"
    ),
    "tube beside walls": (
        "  regions:", "  tube: {radius: 0.6, up: [0, 1]}\n  regions:", "tube", "or `tube`"
    ),
    "box inside out": (
        "task:\n", "  obstacles: [{name: o, lower: [0, 0, 0], upper: [1, 1, -1]}]\ntask:\n",
        "obstacles", "the box is empty along z",
    ),
    "flat solid": (
        "task:\n",
        "  obstacles: [{name: o, vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]}]\ntask:\n",
        "obstacles", "the points lie in one plane",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_broken_spec(run_command: RunCommand, workplace: Path, small_climb: str, name: str) -> None:
    old, new, mark, said = BROKEN[name]
    assert old in small_climb
    text = small_climb.replace(old, new, 1)
    (workplace / "broken.yaml").write_text(text, encoding="utf-8")
    before = sorted(workplace.iterdir())
    outcome = run_command("plan-climb", "broken.yaml")
    assert outcome.code == 2
    assert outcome.out == ""
    assert "Traceback" not in outcome.err
    at_fault = [line for line in outcome.err.splitlines() if re.search(said, line)]
    assert at_fault, outcome.err
    if mark is not None:
        changed = small_climb.rindex("\n", 0, small_climb.index(old)) + 1
        where = text.find(mark, changed) if mark in text[changed:] else text.index(mark)
        number = text.count("\n", 0, where) + 1
        assert at_fault[0].startswith(f"broken.yaml:{number}: "), outcome.err
    assert sorted(workplace.iterdir()) == before
    assert len(outcome.err) < 4000


def robot_text(old: str, new: str) -> str:
    text = read_example("silvia")
    assert old in text
    return text.replace(old, new, 1)


BROKEN_ROBOTS = {
    "negative mass": ("mass: 10.3", "mass: -10.3", "mass: expected a number in kg > 0, got -10.3"),
    "zero limbs": ("limbs:\n", "limbs: []\nlegs:\n", "limbs: expected a list of at least three"),
    "negative length": ("[0.057, 0.195", "[-0.057, 0.195", "link_lengths: expected three numbers"),
    "no torque": ("max_torque: [25,", "max_torque: [0,", "max_torque: expected three numbers > 0"),
    "bounds swapped": ("lower_deg: [-60", "lower_deg: [60", "coxa: expected less than joint_upper"),
    "limb twice": ("name: RM", "name: RF", "names must differ, 'RF' is also limb 0"),
    "limb without a name": ("name: RF", "nam: RF", "did you mean 'name'?"),
    "all compliance": ("share: 0.3", "share: 1.0", "expected a number >= 0 and < 1"),
    "body of no size": ("[0.13, 0.22, 0.05]", "[0.13, 0, 0.05]", "body_half_size: expected three"),
    "unknown side": ("side: right", "side: up", "expected one of `left`, `right`, `any`"),
    "no such base": ("<<: *leg", "<<: *arm", "an alias without its anchor"),
}


@pytest.mark.parametrize("name", BROKEN_ROBOTS)
def test_broken_robot(
    run_command: RunCommand, workplace: Path, small_climb: str, name: str
) -> None:
    old, new, said = BROKEN_ROBOTS[name]
    (workplace / "robot.yaml").write_text(robot_text(old, new), encoding="utf-8")
    spec = small_climb.replace("robot: silvia", "robot: robot.yaml")
    (workplace / "broken.yaml").write_text(spec, encoding="utf-8")
    outcome = run_command("plan-climb", "broken.yaml")
    assert outcome.code == 2
    assert said in outcome.err
    lines = outcome.err.splitlines()
    assert all(line.startswith(f"{workplace}/robot.yaml:") for line in lines), outcome.err
    assert not (workplace / "outputs").exists()
    assert run_command("validate", "robot.yaml").code == 2


def binary(path: Path) -> None:
    path.write_bytes(bytes(range(256)) * 8)


def not_utf8(path: Path) -> None:
    path.write_bytes("kind: climb\ntitle: Stra\xdfe\n".encode("latin-1"))


def plan(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "climbplan/climb"


def huge(path: Path) -> None:
    with path.open("wb") as stream:
        stream.write(b"kind: climb\n")
        stream.truncate(300_000_000)  # a hole: takes no space on disk


BROKEN_FILES: dict[str, tuple[Callable[[Path], None], str]] = {
    "missing": (lambda path: None, "no such file"),
    "directory": (lambda path: path.mkdir(), "a directory, expected a YAML file"),
    "empty": (lambda path: path.touch(), "empty"),
    "comments only": (lambda path: path.write_text("# nothing\n") and None, "expected keys"),
    "a list": (lambda path: path.write_text("- kind: climb\n") and None, "expected keys"),
    "a word": (lambda path: path.write_text("climb\n") and None, "expected keys"),
    "binary": (binary, "a binary file"),
    "not UTF-8": (not_utf8, "broken.yaml:2: not UTF-8"),
    "a plan": (plan, "climbplan verify broken.yaml"),
    "huge": (huge, "too large: 300.0 MB"),
    "a link to nowhere": (lambda path: path.symlink_to("nowhere"), "no such file"),
    "a link to itself": (lambda path: path.symlink_to("broken.yaml"), "cannot be read"),
}


@pytest.mark.parametrize("name", BROKEN_FILES)
@pytest.mark.parametrize("command", ["plan-climb", "validate"])
def test_broken_file(run_command: RunCommand, workplace: Path, name: str, command: str) -> None:
    make, said = BROKEN_FILES[name]
    make(workplace / "broken.yaml")
    outcome = run_command(command, "broken.yaml")
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.startswith("broken.yaml")
    assert said in outcome.err
    assert "Traceback" not in outcome.err
    assert not (workplace / "outputs").exists()


@pytest.mark.parametrize("name", ["tag that runs code", "deep nesting", "alias bomb"])
def test_broken_spec_as_a_process(workplace: Path, small_climb: str, name: str) -> None:
    old, new, _, said = BROKEN[name]
    done = subprocess.run(
        [sys.executable, "-m", "climbplan", "plan-climb", "-"],
        input=small_climb.replace(old, new, 1),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert done.stderr.startswith("stdin:")
    assert "Traceback" not in done.stderr
    assert [entry.name for entry in workplace.iterdir()] == ["small.yaml"]
