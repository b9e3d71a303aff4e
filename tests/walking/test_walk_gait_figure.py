"""The gait figure of a closed loop shows the push, backward steps and who decided."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Text

from benchmarks.walking.shipped_tasks import shipped
from climbplan.walking.online.run import run_online
from climbplan.walking.pages.figure_loop import list_push_times, plot_loop_gait, split_runs
from climbplan.walking.pages.figure_walk import plot_snapshots, plot_tracking
from climbplan.walking.pages.report import select_figures
from climbplan.walking.plan.walk_plan import LoopRecord, WalkPlan


@pytest.fixture(scope="module")
def walked() -> WalkPlan:
    pushes = "loop.pushes=[{time: 1.02, velocity: [-2.8, 0, 0]}]"
    few = ("library.size=3", "library.gaits=0", "loop.duration=2")
    return run_online(shipped("mpc_recovery", pushes, *few)).plan


def test_steps_backward_and_deciders_are_told(walked: WalkPlan) -> None:
    assert list_push_times(walked) == pytest.approx([1.02])
    figure = plot_loop_gait(walked)
    whole, near, speed = figure.axes
    numbers = [float(text.get_text()) for text in near.texts]
    assert len(numbers) > 20
    assert min(numbers) < -5  # it steps back
    assert np.median(numbers) == pytest.approx(29, abs=4)  # 1.8 m/s in 160 ms
    for ax in (whole, near, speed):
        assert any(line.get_linestyle() == ":" for line in ax.lines)
    words = {text.get_text().strip() for text in figure.findobj(Text)}
    assert {"safe stance", "neighbour", "plan before", "named gait", "push"} <= words
    assert any("-2.8" in word for word in words)
    assert select_figures(walked)["gait"].function.endswith(":plot_loop_gait")


def test_snapshots_are_about_the_push(walked: WalkPlan) -> None:
    titles = {text.get_text() for text in plot_snapshots(walked).findobj(Text)}
    assert {"0.98 s", "1.06 s", "1.14 s"} <= titles
    shown = {text.get_text().strip() for text in plot_tracking(walked).findobj(Text)}
    assert {"walked", "push"} <= shown


def test_without_a_push_the_beginning_is_shown(walked: WalkPlan) -> None:
    loop = walked.loop
    assert isinstance(loop, LoopRecord)
    quiet = replace(walked, loop=replace(loop, push=np.zeros_like(loop.push)))
    titles = {text.get_text() for text in plot_loop_gait(quiet).findobj(Text)}
    assert {"The beginning", "no push"} <= titles
    assert split_runs(np.array([1.0, 1.0, 2.0])) == [(0, 2), (2, 3)]
