"""Loading: what comes out of a good spec, and how mistakes in a bad one are told."""

from __future__ import annotations

import hashlib
import io
import pickle
import sys
from pathlib import Path

import pytest

from climbplan.climb.schema.loading import LoadedClimb, load_climb
from climbplan.errors import SpecError, SpecMistake
from climbplan.schema.loading import load_spec
from climbplan.schema.robots.robot import RobotSpec
from climbplan.schema.robots.source import list_builtin_robots, load_robot, read_robot_text
from climbplan.schema.source import NAME_VARIABLE

MANY_MISTAKES = """\
s.yaml:5: terrain.friction: missing, expected a number > 0: friction coefficient where a region has none
s.yaml:7: terrain.walls.gap: expected a number in m > 0, got '1230 mm' (write 1.23)
s.yaml:20: task.round: unknown key (did you mean 'rounds'?)
s.yaml:24: task.goal.com.1: expected a number in m, got .nan
s.yaml:24: task.goal.com: expected a list of three numbers in m, got [0.0, .nan]
s.yaml:30: task.payload.mass: expected a number in kg >= 0, got 'heavy'
s.yaml:34: solver.method: expected one of `auto`, `micp`, `nlp`, `coupled`, `coupled-modes`, `coupled-mccormick`, `coupled-nlp`, `coupled-minlp-scip`, `sl1-relaxation`, `contact-search`, got 'mcip' (did you mean 'micp'?)
s.yaml:36: seed: appears twice, on lines 36 and 38
s.yaml:37: friction: unknown key here; `friction` belongs under `terrain` or `terrain.regions[]` or `terrain.walls` or `terrain.ground` or `terrain.panel` or `terrain.panel.holds[]` or `terrain.boxes[]` or `terrain.scan` or `margins` or `uncertainty`
s.yaml:39: titel: unknown key (did you mean 'title'?)"""  # noqa: E501


def broken(tmp_path: Path, text: str, *sets: str) -> list[str]:
    """The lines that loading `text` is refused with, without the file's directory."""
    path = tmp_path / "s.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SpecError) as caught:
        load_climb(path, sets)
    return str(caught.value).replace(f"{tmp_path}/", "").splitlines()


def change(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


def test_a_good_spec(tmp_path: Path, small_climb: str) -> None:
    path = tmp_path / "shaft.yaml"
    path.write_text(small_climb, encoding="utf-8")
    loaded = load_climb(path)
    assert loaded.name == "shaft"
    assert loaded.text == small_climb
    assert loaded.sha256 == hashlib.sha256(small_climb.encode()).hexdigest()
    assert loaded.source == str(path)
    assert loaded.spec.task.rounds == 2
    assert loaded.robot.name == "SiLVIA"
    assert pickle.loads(pickle.dumps(loaded)) == loaded  # studies send it to worker processes


def test_standard_input(small_climb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(small_climb.encode())))
    loaded = load_climb("-")
    assert (loaded.name, loaded.source) == ("stdin", "stdin")
    assert loaded.directory == Path.cwd()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(small_climb.encode())))
    monkeypatch.setenv(NAME_VARIABLE, "live_3")  # who writes there may name it
    loaded = load_climb("-")
    assert (loaded.name, loaded.source) == ("live_3", "live_3")


def test_robot_beside_the_spec(tmp_path: Path, small_climb: str) -> None:
    (tmp_path / "robots").mkdir()
    robot = read_robot_text("silvia").replace("mass: 10.3", "mass: 9.5")
    (tmp_path / "robots" / "light.yaml").write_text(robot, encoding="utf-8")
    spec = tmp_path / "s.yaml"
    spec.write_text(change(small_climb, "robot: silvia", "robot: robots/light.yaml"))
    assert load_climb(spec).robot.mass == 9.5
    assert load_climb(spec, robot_dir=tmp_path).robot.mass == 9.5
    with pytest.raises(SpecError, match=r"s\.yaml:4: robot: .*no such file"):
        load_climb(spec, robot_dir=tmp_path / "robots")


def test_every_builtin_robot_loads() -> None:
    assert list_builtin_robots()
    for name in list_builtin_robots():
        assert isinstance(load_robot(name), RobotSpec)


def test_any_kind(tmp_path: Path, small_climb: str) -> None:
    climb, robot = tmp_path / "c.yaml", tmp_path / "r.yaml"
    climb.write_text(small_climb)
    robot.write_text(read_robot_text("silvia"))
    assert isinstance(load_spec(climb), LoadedClimb)
    assert isinstance(load_spec(robot), RobotSpec)


def test_mistakes_of_spec_and_robot_come_together(tmp_path: Path, small_climb: str) -> None:
    robot = change(read_robot_text("silvia"), "mass: 10.3 ", "mass: -10.3 ")
    robot = change(robot, "name: RM", "name: RF")
    (tmp_path / "bad.yaml").write_text(robot)
    text = change(small_climb, "robot: silvia", "robot: bad.yaml")
    text = change(text, "rounds: 2", "rounds: 0")
    lines = broken(tmp_path, text)
    assert len(lines) == 2  # names of limbs are compared once the robot is otherwise valid
    assert lines[0].startswith("s.yaml:21: task.rounds: expected a whole number >= 1")
    assert lines[1].startswith("bad.yaml:7: mass: expected a number in kg > 0, got -10.3")


def test_one_mistake_does_not_hide_another(tmp_path: Path, small_climb: str) -> None:
    text = change(small_climb, "  friction: 0.9\n", "")
    text = change(text, "gap: 1.23", "gap: 1230 mm")
    text = change(text, "rounds: 2", "round: 2")
    text = change(text, "com: [0.0, 0.0, 0.1]", "com: [0.0, .nan]")
    text = change(text, "mass: 0.5", "mass: heavy")
    text = change(text, "method: micp", "method: mcip")
    text = change(text, "seed: 1", "seed: 1\nfriction: 0.8\nseed: 2\ntitel: x")
    assert "\n".join(broken(tmp_path, text)) == MANY_MISTAKES


@pytest.mark.parametrize(
    ("old", "new", "line", "fragment"),
    [
        (
            "rounds: 2",
            "rounds: two",
            21,
            "expected a whole number >= 1 and <= 200, or auto, got 'two'",
        ),
        ("rounds: 2", "rounds: '2'", 21, "(write 2)"),
        ("rounds: 2", "rounds: 2.5", 21, "expected a whole number"),
        ("rounds: 2", "rounds: true", 21, "got true"),
        ("rounds: 2", "rounds:", 21, "got nothing"),
        ("gap: 1.23", "gap: 1,23", 8, "(write 1.23)"),
        ("gap: 1.23", "gap: 4 ft", 8, "(write 1.2192)"),
        ("gap: 1.23", "gap: .inf", 8, "got .inf"),
        ("gap: 1.23", "gap: 1e300", 8, "numbers end at 1e+09"),
        ("gap: 1.23", "gap_mm: 1230", 8, "did you mean 'gap'?"),
        ("rpy_deg: [0, 0, 0]", "rpy: [0, 0, 0]", 26, "did you mean 'rpy_deg'?"),
        ("name: ledge", "name: 7", 12, 'write "7" in quotes'),
        ("safety_friction: 1.8", "mu: 1.8", 33, "unknown key; expected one of `safety_friction`"),
        ("method: micp", "starts: {a: 1}", 35, "got a mapping with the keys a"),
        ("  payload:\n    mass: 0.5", "  payload: 0.5", 30, "expected a mapping with the keys"),
        ("gait: [RF,", "gait: RF #", 29, "expected a list, each text, got 'RF'"),
        ("limbs: [RF, RM]", "limbs: [RF, RN]", 19, "has no limb 'RN'"),
        ("      RF: [0.615", "      FR: [0.615", 28, "task.goal.toes.FR: SiLVIA has no limb"),
        ("gait: [RF, RM,", "gait: [RF, RF,", 29, "expected each limb once"),
        ("robot: silvia", "robot: sylvia", 4, "did you mean 'silvia'?"),
        ("robot: silvia", "robot: silvia.urdf", 4, "path of a robot YAML file"),
        ("kind: climb", "kind: clim", 2, "did you mean 'climb'?"),
        ("kind: climb", "kind: robot", 2, "expected a spec of kind `climb`, got a `robot`"),
        (
            "kind: climb",
            "kind: [climb]",
            2,
            "`program`, `dataset`, `strategy`, `limms`, `robot`, `module`",
        ),
        ("kind: climb\n", "", 2, "kind: missing, expected `kind: climb`"),
        ("name: ledge", "name: left", 12, "names must differ, 'left' is also a wall"),
        ("along: [-1.0, 1.0]", "along: [1.0, 1.0]", 9, "from < to"),
        ("gap: 1.23", "gap: 1.23\n    angle_deg: 80", 10, "the walls meet at y = -0.733 m"),
        ("normal: [-1, 0, 0]", "normal: [0, 0, 0]", 15, "expected a direction"),
        ("width: 0.4", "width: 0", 16, "expected a number in m > 0, got 0"),
        ("seed: 1", "seed: 1\nposture: {steps: {com_min: 0.05}}", 38, "--method nlp"),
        ("terrain.friction:", "terrain.frction:", 40, "did you mean 'friction'?"),
        ("terrain.friction:", "terrain.tube.radius:", 40, "this spec has no `terrain.tube`"),
        ("terrain.friction:", "terrain.regions.1.friction:", 40, "has no `terrain.regions.1`"),
        ("terrain.friction:", "robot:", 40, "expected the dotted key of one number"),
        ("friction: [0.7", "friction: [-0.7", 40, "as `terrain.friction`: expected"),
        ("terrain.friction: [0.7, 0.9]", "terrain.friction: []", 39, "at least one number"),
    ],
)
def test_mistakes_are_told_in_words(
    tmp_path: Path, small_climb: str, old: str, new: str, line: int, fragment: str
) -> None:
    lines = broken(tmp_path, change(small_climb, old, new))
    assert len(lines) == 1
    assert lines[0].startswith(f"s.yaml:{line}: ")
    assert fragment in lines[0]


def test_good_study_keys(tmp_path: Path, small_climb: str) -> None:
    path = tmp_path / "s.yaml"
    key = "terrain.regions.0.rectangle.center.2:"
    path.write_text(change(small_climb, "terrain.friction:", key))
    assert load_climb(path).spec.study is not None


def test_limb_without_region(tmp_path: Path, small_climb: str) -> None:
    walls = "  walls:\n    gap: 1.23\n    along: [-1.0, 1.0]\n    up: [-1.0, 2.0]\n"
    lines = broken(tmp_path, change(small_climb, walls, ""))
    assert lines == [
        f"s.yaml:7: terrain.regions: limb {limb} may use none of the regions"
        for limb in ("RR", "LR", "LM", "LF")
    ]


def test_tube_needs_nlp(tmp_path: Path, small_climb: str) -> None:
    start, end = small_climb.index("  walls:"), small_climb.index("task:")
    tube = "  tube: {radius: 0.6, up: [-1, 2]}\n"
    text = small_climb[:start] + tube + small_climb[end:]
    (line,) = broken(tmp_path, text)
    assert line.startswith("s.yaml:7: terrain.tube: ")
    assert "--method nlp" in line
    (tmp_path / "s.yaml").write_text(text)
    assert load_climb(tmp_path / "s.yaml", ["solver.method=nlp"]).spec.terrain.tube is not None


def test_so_many_mistakes_are_cut(tmp_path: Path, small_climb: str) -> None:
    extra = "".join(f"key{i}: {i}\n" for i in range(5000))
    lines = broken(tmp_path, small_climb + extra)
    assert len(lines) == 201
    assert any("4800 more mistakes" in line for line in lines)


def test_a_mistake_found_while_planning_gets_its_line(tmp_path: Path, small_climb: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(small_climb)
    loaded = load_climb(path, ["task.goal.toes.LF=[0, 0, 0]"])
    mistakes = [SpecMistake("task.goal.toes.RF", "a"), SpecMistake("task.goal.toes.LF.1", "b")]
    late = SpecError("x", mistakes)
    first, second = loaded.locate(late).mistakes
    assert (first.line, first.source) == (28, str(path))
    assert second.source == "--set task.goal.toes.LF=[0, 0, 0]"
    assert second.key == "task.goal.toes.LF.1"


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "empty"),
        (b" \n\n", "empty"),
        (b"# only a comment\n", "expected keys and values"),
        (b"- 1\n- 2\n", "expected keys and values, the first `kind: climb`, got [1, 2]"),
        (b"hello\n", "got 'hello'"),
        (b"\x89HDF\r\n\x1a\n\0\0\0\0", "climbplan verify"),
        (b"\x7fELF\x02\x01\x01\0\xff\xfe", "binary"),
        (b"kind: climb\0\n", "binary"),
        ("kind: climb\ntitle: Stra\xdfe\n".encode("latin-1"), ":2: not UTF-8 text: byte 0xdf"),
        ("kind: climb\n".encode("utf-16"), "not UTF-8"),
        (b"#" * 5_000_001, "too large: 5.0 MB"),
    ],
)
def test_files_that_are_no_spec(tmp_path: Path, content: bytes, fragment: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_bytes(content)
    with pytest.raises(SpecError) as caught:
        load_climb(path)
    assert str(caught.value).startswith(str(path))
    assert fragment in str(caught.value)


def test_a_byte_order_mark_is_no_mistake(tmp_path: Path, small_climb: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_bytes(small_climb.encode("utf-8-sig"))
    assert load_climb(path).text == small_climb


def test_windows_line_ends(tmp_path: Path, small_climb: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_bytes(small_climb.replace("\n", "\r\n").replace("rounds: 2", "rounds: 0").encode())
    with pytest.raises(SpecError, match=r":21: task\.rounds"):
        load_climb(path)


def test_places_without_a_file(tmp_path: Path) -> None:
    (tmp_path / "climb_steps.yaml").write_text("kind: climb\n")
    for path, fragment in (
        (tmp_path, "a directory"),
        (tmp_path / "climb_step.yaml", "climb_steps.yaml'?"),
        (tmp_path / "other.yaml", "climbplan new climb"),
        (tmp_path / "no" / "x.yaml", "no directory"),
        (tmp_path / "climb_steps.yaml" / "x.yaml", "no such file|cannot be read"),
    ):
        with pytest.raises(SpecError, match=fragment):
            load_climb(path)


def test_an_endless_device_is_not_read_to_its_end() -> None:
    with pytest.raises(SpecError, match="too large"):
        load_climb("/dev/zero")
