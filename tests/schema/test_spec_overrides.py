"""`--set` overrides: values, list entries, created mappings, and mistakes by option."""

from __future__ import annotations

from pathlib import Path

import pytest

from climbplan.climb.schema.loading import LoadedClimb, load_climb
from climbplan.errors import SpecError
from climbplan.schema.overrides import Override


@pytest.fixture
def spec_path(tmp_path: Path, small_climb: str) -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(small_climb, encoding="utf-8")
    return path


def refusal(path: Path, *overrides: str | Override) -> list[str]:
    with pytest.raises(SpecError) as caught:
        load_climb(path, overrides)
    return str(caught.value).splitlines()


def test_values_of_every_shape(spec_path: Path) -> None:
    spec = load_climb(
        spec_path,
        [
            "task.rounds=6",
            "task.goal.com=[0, 0.1, 1e-1]",
            "task.goal.com.2=0.2",
            "terrain.regions.0.friction=0.5",
            "title=a = b",
            "task.external_wrench={force: [1, 2, 3]}",
            "trajectory.rate=40",
            "posture.stance_workspace=false",
        ],
    ).spec
    assert spec.task.rounds == 6
    assert spec.task.goal.com == (0.0, 0.1, 0.2)
    assert spec.terrain.regions[0].friction == 0.5
    assert spec.title == "a = b"
    assert spec.task.external_wrench.force == (1.0, 2.0, 3.0)
    assert spec.trajectory.rate == 40  # the file has no `trajectory`
    assert spec.posture.stance_workspace is False


def test_text_after_overrides_says_the_same(spec_path: Path, tmp_path: Path) -> None:
    loaded = load_climb(spec_path, ["task.rounds=6", "title=yes"])
    again = tmp_path / "again.yaml"
    again.write_text(loaded.text, encoding="utf-8")
    assert load_climb(again).spec == loaded.spec
    assert loaded.text.startswith("kind: climb\n")
    assert loaded.sha256 != load_climb(spec_path).sha256


def test_a_loaded_climb_takes_more_overrides(spec_path: Path) -> None:
    loaded = load_climb(spec_path, ["task.rounds=6"])
    more = loaded.with_overrides(["terrain.friction=0.7"])
    assert isinstance(more, LoadedClimb)
    assert (more.spec.task.rounds, more.spec.terrain.friction) == (6, 0.7)
    assert loaded.spec.terrain.friction == 0.9


def test_mistakes_of_more_overrides_are_placed_in_the_file(spec_path: Path) -> None:
    loaded = load_climb(spec_path, ["seed=4"])
    with pytest.raises(SpecError) as caught:
        loaded.with_overrides(["task.goal.com=3"])
    assert "task.goal.com" in str(caught.value)
    line = loaded.document.lines["task", "rounds"]
    assert spec_path.read_text().splitlines()[line - 1].strip().startswith("rounds:")
    assert loaded.with_overrides(["seed=5"]).document.lines["task", "rounds"] == line


def test_data_needs_no_yaml_and_is_in_the_text(spec_path: Path) -> None:
    data = {"com": [0.0, 0.1, 0.25]}
    loaded = load_climb(spec_path, [Override.of("task.start", data, "found")])
    data["com"][0] = 9.0
    assert loaded.spec.task.start.com == (0.0, 0.1, 0.25)
    assert "com: [0.0, 0.1, 0.25]" in loaded.text
    off = load_climb(spec_path, [Override.of("posture.stance_workspace", False, "found")])
    assert not off.spec.posture.stance_workspace


def test_the_last_override_wins(spec_path: Path) -> None:
    assert load_climb(spec_path, ["seed=2", "seed=3"]).spec.seed == 3


def test_overrides_can_mend_a_file(spec_path: Path, small_climb: str) -> None:
    spec_path.write_text(small_climb.replace("rounds: 2", "rounds: !!python/name:os.system x"))
    assert load_climb(spec_path, ["task.rounds=2"]).spec.task.rounds == 2


@pytest.mark.parametrize(
    ("override", "fragments"),
    [
        ("task.round=3", ["--set task.round=3: task.round: ", "did you mean 'rounds'?"]),
        ("tsk.rounds=3", ["--set tsk.rounds=3: tsk: ", "did you mean 'task'?"]),
        ("task.rounds=0", ["task.rounds: expected a whole number >= 1", "got 0"]),
        ("task.payload.mass=3 kg", ["expected a number in kg", "(write 3)"]),
        ("task.payload.mass=.nan", ["got .nan"]),
        ("terrain.regions.1.friction=1", ["'1' is not an entry of the list `terrain.regions`"]),
        ("terrain.regions.x=1", ["'x' is not an entry of the list"]),
        ("terrain.regions.-1.friction=1", ["'-1' is not an entry"]),
        ("title.x=1", ["`title` is 'two rounds", "no key 'x'"]),
        ("task.rounds", ["expected dotted.key=value"]),
        ("=3", ["expected a key"]),
        ("task..rounds=3", ["expected a key"]),
        ("task.rounds=[1, 2", ["--set task.rounds=[1, 2: not valid YAML"]),
        ("task.rounds=!!python/name:os.system x", ["not allowed"]),
        ("task.payload={mass: 1, mass: 2}", ["task.payload.mass: appears twice"]),
        (".".join("a" * 100) + "=1", ["at most 64 parts"]),
        ("study.x=3", ["study.x: unknown key"]),
        ("solver.force_solver=scip", ["expected one of `daqp`, `clarabel`, `osqp`, got 'scip'"]),
    ],
)
def test_mistakes_name_the_option(spec_path: Path, override: str, fragments: list[str]) -> None:
    (line,) = refusal(spec_path, override)
    assert line.startswith("--set ")
    for fragment in fragments:
        assert fragment in line


def test_all_overrides_are_checked(spec_path: Path) -> None:
    lines = refusal(spec_path, "task.rounds=0", "nonsense", "terrain.regions.9.friction=1", "sed=1")
    assert len(lines) == 4


def test_options_that_stand_for_a_key_go_by_their_own_name(spec_path: Path) -> None:
    (line,) = refusal(spec_path, Override("seed", "-1", "--seed -1"))
    assert line.startswith("--seed -1: seed: expected a whole number >= 0")
