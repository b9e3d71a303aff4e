"""Old spec keys keep their meaning, with a warning that gives the new one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from climbplan.datasets.schema.model import BY_PROBLEM
from climbplan.deprecation import RENAMED_METHODS
from climbplan.errors import SpecError
from climbplan.schema.fields import find_slot
from climbplan.schema.kinds import KINDS
from climbplan.schema.loading import load_source
from climbplan.schema.renamed_keys import METHOD_KEYS, RENAMED_KEYS
from climbplan.schema.source import SourceText

CLIMB = """\
kind: climb
robot: silvia
terrain: {friction: 1.0, walls: {gap: 1.23, along: [-1, 1], up: [-1, 2]}}
task: {rounds: 2, start: {com: [0, 0, 0]}, goal: {com: [0, 0, 0.2]}}
force:
  least_pressure: 7
"""


def load(text: str, overrides: tuple[str, ...] = ()) -> object:
    return load_source(SourceText("climb.yaml", "climb", Path(), text), overrides)


def test_an_old_key_is_read_with_a_warning_that_has_its_line() -> None:
    words = "climb.yaml, line 6: the key `force.least_pressure` is now `force.min_normal_force`"
    with pytest.warns(FutureWarning, match=re.escape(words)):
        loaded = load(CLIMB)
    assert loaded.spec.force.min_normal_force == 7  # type: ignore[attr-defined]
    assert loaded.text == CLIMB  # type: ignore[attr-defined]  # the user's own text stays


@pytest.mark.parametrize("name", ["least_pressure", "min_normal_force"])
@pytest.mark.parametrize("in_file", ["least_pressure", "min_normal_force"])
def test_an_override_replaces_a_key_under_either_name(name: str, in_file: str) -> None:
    text = CLIMB.replace("least_pressure", in_file)
    if "least_pressure" in (name, in_file):
        with pytest.warns(FutureWarning, match=r"is now `force\.min_normal_force`"):
            loaded = load(text, (f"force.{name}=9",))
    else:
        loaded = load(text, (f"force.{name}=9",))
    assert loaded.spec.force.min_normal_force == 9  # type: ignore[attr-defined]


def test_a_mistake_under_an_old_key_has_the_line_of_the_file() -> None:
    with (
        pytest.warns(FutureWarning, match="is now"),
        pytest.raises(SpecError, match=r"climb\.yaml:6: force\.min_normal_force") as refusal,
    ):
        load(CLIMB.replace("7", "seven"))
    assert refusal.value.mistakes[0].line == 6


def test_a_key_under_both_names_is_refused() -> None:
    text = CLIMB + "  min_normal_force: 8\n"
    with pytest.raises(SpecError, match=r"old name of `force\.min_normal_force`"):
        load(text)


@pytest.mark.parametrize(
    ("kind", "old"), [(kind, old) for kind, table in RENAMED_KEYS.items() for old in table]
)
def test_every_new_key_is_one_of_the_model_and_no_old_one_is(kind: str, old: str) -> None:
    *above, last = (0 if name == "*" else name for name in old.split("."))
    models = list(BY_PROBLEM.values()) if kind == "dataset" else [KINDS[kind].model]
    new = (*above, RENAMED_KEYS[kind][old])
    assert any(find_slot(model, new) is not None for model in models)
    assert all(find_slot(model, (*above, last)) is None for model in models)


WALK = "kind: mpc\nsolver: {method: micp}\n"


def test_an_old_method_is_read_with_a_warning_that_has_its_line() -> None:
    words = "climb.yaml, line 2: the method `micp` of `solver.method` is now `spatial-branch-and-bo"
    with pytest.warns(FutureWarning, match=re.escape(words)):
        loaded = load(WALK)
    assert loaded.spec.solver.method == "spatial-branch-and-bound"  # type: ignore[attr-defined]
    start = WALK.replace("method: micp", "initial_solution: nlp")
    with pytest.warns(FutureWarning, match="method `nlp` of `solver.initial_solution` is now"):
        loaded = load(start)
    assert loaded.spec.solver.initial_solution == "mpcc"  # type: ignore[attr-defined]


def test_an_old_method_of_an_option_replaces_that_of_the_file() -> None:
    with pytest.warns(FutureWarning, match="--set solver.method=nlp: the method `nlp`") as warned:
        loaded = load(WALK, ("solver.method=nlp",))
    assert loaded.spec.solver.method == "mpcc"  # type: ignore[attr-defined]
    assert len(warned) == 1


def test_old_methods_of_the_problem_of_a_dataset_are_read() -> None:
    text = "kind: dataset\nproblem: {kind: bookshelf, solver: {method: micp}}\n"
    with pytest.warns(FutureWarning, match="`micp` of `problem.solver.method` is now `mccormick`"):
        loaded = load(text)
    assert loaded.spec.problem.solver.method == "mccormick"  # type: ignore[attr-defined]
    climb = load(CLIMB.replace("force:\n  least_pressure: 7", "solver: {method: micp}"))
    assert climb.spec.solver.method == "micp"  # type: ignore[attr-defined]  # no old name there


@pytest.mark.parametrize("kind", RENAMED_METHODS)
def test_every_new_method_is_one_of_the_model_and_no_old_one_is(kind: str) -> None:
    for key in METHOD_KEYS.get(kind, ("solver.method",)):
        slot = find_slot(KINDS[kind].model, tuple(key.split(".")))
        assert slot is not None
        assert not set(slot.choices) & set(RENAMED_METHODS[kind])
    slot = find_slot(KINDS[kind].model, ("solver", "method"))
    assert slot is not None
    assert set(RENAMED_METHODS[kind].values()) <= set(slot.choices)
