"""`climbplan.find_limit`: what it answers, on a shelf whose limit is known and on a climb."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import climbplan
from climbplan.api import limits
from climbplan.api.limit_kinds import LIMIT_KINDS
from climbplan.api.limit_trials import Trial
from climbplan.errors import LimitReached, SpecError, Unresolved, UsageError

SPECS = Path(__file__).parents[2] / "specs"
WIDTH = "scene.insert.width_mm"
# A book of 20 mm on a shelf of 100 mm: the other one, too high to lie, is 80 mm wide at most
SHELF: dict[str, Any] = {
    "kind": "bookshelf",
    "shelf": {"left_mm": -50, "right_mm": 50, "height_mm": 110},
    "scene": {
        "books": [{"x_mm": -40, "height_mm": 60, "width_mm": 20}],
        "insert": {"height_mm": 105, "width_mm": 17},
    },
    "solver": {"method": "exact"},
}
CLIMB: dict[str, Any] = {
    "kind": "climb",
    "robot": "silvia",
    "terrain": {
        "friction": 1.0,
        "walls": {"gap": 1.23, "along": [-0.8, 0.8], "up": [-0.8, 1.0]},
    },
    "task": {"rounds": 1, "start": {"com": [0, 0, 0]}, "goal": {"com": [0, 0, 0.1]}},
    "solver": {"method": "micp"},
    "trajectory": {"speed": 0.01},
}


def test_the_widest_book() -> None:
    trials: list[Trial] = []
    limit = climbplan.find_limit(SHELF, WIDTH, tolerance=1.0, on_trial=trials.append)
    assert tuple(trials) == limit.trials
    assert trials[0].value == 17
    assert limit.value is not None
    assert 79 <= limit.value <= 80
    assert limit.plan is not None
    assert limit.plan.verify().passed
    assert f"{WIDTH.rpartition('.')[2]}: {limit.value}" in limit.plan.spec
    nearest = limit.next_failed
    assert nearest is not None
    assert nearest.outcome == "infeasible"
    assert limit.next_infeasible is nearest
    assert nearest.value - limit.value <= 1
    assert limit.ended_by == "failure"
    assert not limit.failed_within
    lines = limit.sentences()
    assert lines[0].startswith(f"largest {WIDTH} that is verified: {limit.value:.6g} mm")
    assert any("proved infeasible" in line for line in lines)
    assert any("mm of width are missing" in line for line in lines)
    header, rows = limit.table()
    assert header[0] == "value_mm"
    assert [row[0] for row in rows] == sorted(trial.value for trial in trials)


def test_a_range_in_which_everything_counts() -> None:
    limit = climbplan.find_limit(SHELF, WIDTH, lower=10, upper=30)
    assert (limit.value, limit.ended_by, limit.next_failed) == (30, "range", None)
    assert [trial.value for trial in limit.trials] == [17, 30]


def test_where_nothing_counts() -> None:
    with pytest.raises(Unresolved, match="at 90 mm proved infeasible") as failed:
        climbplan.find_limit(SHELF, WIDTH, lower=90)
    assert failed.value.exit_code == 4
    assert failed.value.remedies


def test_remedies_are_sought_for_the_stated_value_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = limits.plan_and_verify
    sought: list[bool] = []

    def record(loaded: object, options: Any) -> Any:
        sought.append(options.seek_remedies)
        return plan(loaded, options)

    monkeypatch.setattr(limits, "plan_and_verify", record)
    climbplan.find_limit(SHELF, WIDTH, lower=17, upper=30)
    assert sought == [True, False]


def test_time_limit_of_the_whole_search() -> None:
    with pytest.raises(LimitReached, match="before a plan was found"):
        climbplan.find_limit(SHELF, WIDTH, time_limit=1e-6)


def test_time_is_up_after_a_first_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = limits.plan_and_verify
    trials: list[Trial] = []

    def plan_once(loaded: object, options: Any) -> Any:
        if trials:
            clock.append(1e6)
            options.progress("solve", 0.0)
        return plan(loaded, options)

    clock = [0.0]
    monkeypatch.setattr(limits.time, "monotonic", lambda: clock[-1])
    monkeypatch.setattr(limits, "plan_and_verify", plan_once)
    limit = climbplan.find_limit(SHELF, WIDTH, time_limit=1e4, on_trial=trials.append)
    assert limit.value == 17
    assert limit.ended_by == "time"
    assert limit.trials[-1].outcome == "out_of_time"
    assert limit.next_failed is None
    assert "the time was over" in limit.sentences()[1]


@pytest.mark.parametrize(
    ("key", "options", "message"),
    [
        ("scene.insert.width", {}, "unknown key .did you mean 'width_mm'"),
        ("title", {}, "a key whose value is a number, not text"),
        ("scene.books", {}, "not a list of them"),
        ("scene.books.first.width_mm", {}, "index of an entry of the list `scene.books`"),
        ("shelf.published.sine_tolerance", {}, "nothing says whether its largest or its smallest"),
        (WIDTH, {"lower": 20, "upper": 20}, "a lower end below the upper one, got 20 and 20"),
        (WIDTH, {"upper": float("inf")}, "expected finite ends"),
        (WIDTH, {"tolerance": "5 %%"}, "tolerance: expected a number above zero"),
        (WIDTH, {"tolerance": -1.0}, "tolerance: expected a number above zero"),
        ("scene.books.0.y_mm", {"direction": "largest"}, "the spec has no value of it"),
        ("solver.node_limit", {"lower": 1.5, "direction": "largest"}, "expected whole numbers"),
    ],
)
def test_what_cannot_be_sought(key: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        climbplan.find_limit(SHELF, key, **options)


def test_ends_that_the_spec_cannot_have() -> None:
    with pytest.raises(SpecError, match="a number in mm > 0"):
        climbplan.find_limit(SHELF, WIDTH, lower=-1)
    with pytest.raises(SpecError, match="not an entry of the list"):
        climbplan.find_limit(SHELF, "scene.books.7.width_mm", lower=10)
    with pytest.raises(UsageError, match="limits are those of specs of kind climb, transition"):
        climbplan.find_limit(SPECS / "dataset_mpc.yaml", "count")


def test_a_value_that_makes_the_spec_invalid_is_a_failure() -> None:
    """The walls of a shelf may not change places, whatever the bounds of their keys."""
    limit = climbplan.find_limit(SHELF, "shelf.left_mm", upper=49, tolerance=5.0)
    assert limit.value is not None
    assert limit.next_failed is not None


def test_every_kind_has_its_checks_in_words() -> None:
    names = {
        "climb": "torque.limit",
        "transition": "force.friction",
        "mpc": "force.friction",
        "limms": "force.limit",
        "bookshelf": "book.overlap",
    }
    assert set(names) == set(LIMIT_KINDS)
    for kind, name in names.items():
        assert LIMIT_KINDS[kind].describe_check(name), kind
        assert not LIMIT_KINDS[kind].describe_check("no.check")


def test_a_payload_ends_where_plans_become_implausible() -> None:
    limit = climbplan.find_limit(CLIMB, "task.payload.mass", tolerance=0.5)
    assert limit.value == pytest.approx(1.75, abs=0.75)
    nearest, checked = limit.next_failed, limit.hardest_checked
    assert nearest is not None
    assert nearest.outcome == "implausible"
    assert nearest.plan is not None
    assert nearest.plan.verified
    assert checked is not None
    assert checked.value >= nearest.value
    names = {margin.check for margin in limit.trials[0].margins}
    assert {"force.friction", "torque.limit"} <= names
    assert any("torques within the limit over S_tau" in line for line in limit.sentences())
    assert any("checks alone pass as far as" in line for line in limit.sentences())
