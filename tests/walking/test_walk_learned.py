"""Strategies on tasks that the library has not seen: what the table of benchmark `mpc` counts."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from walk_tasks import walk_task

from benchmarks.walking import learned
from benchmarks.walking.online_options import OnlineInputs, OnlineOptions, online_inputs
from climbplan.walking.online import section_ranking
from climbplan.walking.online.library import SECTION, SectionLibrary, build_library
from climbplan.walking.online.section_ranking import (
    StrategyName,
    select_commonest,
    train_section_ranking,
)

TASK = walk_task(integrator="mean", min_contacts=2, workspace_over_stance=True)


@pytest.fixture(scope="module")
def inputs() -> OnlineInputs:
    given = online_inputs(
        OnlineOptions(quick=True, assignments=("library.size=1",), library_size=1), lambda *_: None
    )
    return replace(given, libraries=(build_library(TASK, 3, 0, gaits=0),))


def test_fresh_tasks_are_what_their_titles_say() -> None:
    drawn = {
        name: draw(TASK, 3, np.random.default_rng([0, 1, 3]))
        for name, draw in learned.KINDS.items()
    }
    flat, heavy, stairs, stones = drawn.values()
    assert flat.body.mass == TASK.body.mass
    assert abs(flat.start.state[4]) > 0
    assert 0 < abs(heavy.body.mass / TASK.body.mass - 1) < 0.2
    heavier = heavy.body.mass / TASK.body.mass
    np.testing.assert_allclose(heavy.body.inertia, heavier * TASK.body.inertia)
    assert len(stairs.ground.height) == 4
    assert len(stones.ground.height) > 10
    for task in (stairs, stones):
        region = task.ground.nearest(task.start.toes[:, :2])
        assert task.ground.compute_distance_outside(region, task.start.toes[:, :2]).max() <= 1e-9
    other = learned.KINDS["stones, 0.5 m/s"](TASK, 4, np.random.default_rng([0, 1, 4]))
    assert other.ground.names != stones.ground.names


@pytest.mark.slow
def test_costs_are_set_against_the_search(
    inputs: OnlineInputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(learned, "STRATEGIES", ("knn", "forest"))
    stream = io.StringIO()
    rows = learned.strategy_table(inputs, 0, True, stream)
    assert len(rows) == 2 * len(learned.KINDS)
    assert len(stream.getvalue().splitlines()) == len(rows) + 3
    for row in rows:
        assert 0 <= row["of_library"] <= row["answered"] <= 1
        if row["cost_to_search"] is not None:
            assert 0.5 < row["cost_to_search"] <= row["cost_to_search_95"]  # 30 QPs are few
    assert any(row["answered"] > 0 for row in rows)


@pytest.mark.parametrize("compared", [8000, 40])
def test_reduce_tries_the_gaits_of_the_likeliest_cluster_first(
    compared: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two kinds of motion, told apart by what is asked: each has gaits of its own."""
    monkeypatch.setattr(section_ranking, "_MAX_COMPARED", compared)
    rng, legs, knots = np.random.default_rng(0), 4, SECTION + 1
    count = 60
    kind = np.arange(count) % 2
    contact = np.ones((count, knots, legs), bool)
    contact[np.arange(count), 1 + rng.integers(0, 4, count), kind] = False
    force = rng.normal(0, 0.1, (count, knots, legs, 3)) + 50.0 * kind[:, None, None, None]
    features = rng.normal(0, 0.1, (count, 5))
    features[:, 0] += 5.0 * kind
    motion = np.zeros((count, knots, 12)), rng.normal(0, 1e-3, (count, knots, legs, 3))
    library = SectionLibrary(features, *motion, force, contact, np.arange(count))
    ranking = train_section_ranking("reduce", library, 0)
    for asked in (0, 1):
        wanted = np.array([5.0 * asked, 0, 0, 0, 0])
        found = ranking.rank(wanted, 4)
        assert kind[found].tolist() == [asked] * 4
        assert len({contact[k].tobytes() for k in found}) == 4
        apart = np.linalg.norm(features[found] - wanted, axis=1)
        assert (np.diff(apart) >= 0).all()
        more = ranking.rank(wanted, 8)
        assert kind[more].tolist() == [asked] * 4 + [1 - asked] * 4


def test_of_many_gaits_the_commonest_are_told_apart() -> None:
    labels = np.array([0, 1, 1, 2, 3, 3, 3, 4])
    kept, count = select_commonest(labels, 5, 3)
    assert count == 3
    assert kept.tolist() == [0, 1, 1, -1, 2, 2, 2, -1]  # of the rare ones the first
    assert select_commonest(labels, 5, 5) == (labels, 5)


@pytest.mark.parametrize("name", ["forest", "network"])
def test_gaits_too_rare_to_learn_are_never_proposed(
    inputs: OnlineInputs, name: StrategyName, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(section_ranking, "_MAX_GAITS", 1)
    library = inputs.libraries[-1]
    ranking = train_section_ranking(name, library, 0)
    told = {library.contact[k].tobytes() for x in library.features for k in ranking.rank(x, 9)}
    assert len(told) == 1 < len(np.unique(library.contact, axis=0))
