"""Recovery studies: the same trials whatever the workers, and what they say of failures."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from walk_tasks import walk_task

from benchmarks.walking.online_options import OnlineOptions, in_words, online_inputs
from benchmarks.walking.recovery_study import Study, Trial, run_study
from benchmarks.walking.run import run_mpc
from climbplan.errors import UsageError
from climbplan.walking.online.closed_loop import LoopScenario
from climbplan.walking.online.library import build_library
from climbplan.walking.online.state_feedback import StateNoise

TASK = walk_task(integrator="mean", min_contacts=2, workspace_over_stance=True)


@pytest.fixture(scope="module")
def study() -> Study:
    world = LoopScenario(noise=StateNoise(velocity=0.01))
    library = build_library(TASK, 3, 0, gaits=0)
    return Study(TASK, library, np.array([-1.0, 0.2, 0.0]), 4, world=world)


def without_times(trials: tuple[Trial, ...]) -> list[Trial]:
    return [replace(trial, tick_time=np.zeros(0)) for trial in trials]


def test_trials_do_not_depend_on_workers_or_their_number(study: Study) -> None:
    alone = run_study(study)
    assert len(alone) == 4
    assert len({trial.off for trial in alone}) == 4  # at other times, to either side
    told: list[float] = []
    apart = run_study(replace(study, count=3), jobs=2, report=told.append)
    for one, other in zip(without_times(alone), without_times(apart), strict=False):
        assert vars(one) | {"tick_time": 0} == vars(other) | {"tick_time": 0}
    assert told[-1] == 1.0


def test_endings(study: Study) -> None:
    (thrown,) = run_study(replace(study, push=np.array([0.0, 7.0, 0.0]), count=1))
    assert thrown.ending == "fell"
    assert thrown.fell is not None
    assert thrown.fell < 1.4
    assert thrown.fault.startswith("safe stance")
    (still,) = run_study(replace(study, push=np.zeros(3), count=1))
    assert still.ending == "recovered"
    assert still.safe == 0


def test_tables_and_figures() -> None:
    options = OnlineOptions(quick=True, count=1, library_size=3, assignments=("loop.delay=0.02",))
    stream = io.StringIO()
    found = run_mpc(options, "recovery", stream, lambda stage, share: None)
    text = stream.getvalue()
    assert "delay 20 ms" in text
    assert [row["push"] for row in found["recovery"]] == [
        "back 1 m/s",
        "back 1.5 m/s",
        "aside 0.5 m/s",
        "back 2.8 m/s",
    ]
    for row in found["recovery"]:
        assert row["recovered"] + row["fell"] + row["off_the_reference"] == row["trials"] == 1
        assert row["walks"] == 3
    with pytest.raises(UsageError, match="recovering"):
        run_mpc(options, "recovering", stream, lambda stage, share: None)
    pushes = "loop.pushes=[{time: 1, velocity: [0, -0.5, 1]}]"
    chosen = online_inputs(
        replace(options, assignments=(pushes,), library_size=1), lambda stage, share: None
    )
    assert [in_words(push) for push in chosen.pushes] == ["aside 0.5, up 1 m/s"]


@pytest.mark.slow
def test_pushes_beside_what_is_asked() -> None:
    options = OnlineOptions(quick=True, count=1, library_size=3)
    stream = io.StringIO()
    found = run_mpc(options, "pushes", stream, lambda stage, share: None)["pushes"]
    text = stream.getvalue()
    assert "estimated state, ideal legs, delay 20 ms" in text
    assert [row["asked"] for row in found] == [0.99, 0.99, 0.95, 0.99, 0.9]
    assert found[2]["push"] == "back 2.8 m/s"
    line = text.splitlines()[-7]
    assert line.startswith("back 1 m/s             3    99 %")
    assert text.splitlines()[-2].startswith("pushes: ")
    assert f"{found[0]['median_ms']:.2f}, {found[0]['most99_ms']:.2f} ms" in line
    assert all(row["broken"] == 0 for row in found)  # none stood too far out of its box
    assert all(row["refused"] == row["fell"] for row in found)
