"""Climbs that are well described but impossible: the reason, and nothing left.

Exit code 3 where geometry proves it; 4 where no forces carry postures that we chose: a limb that is
stretched out holds any load along itself, so that neither friction nor motors prove anything.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import RunCommand

# (settings, words one of which the message must use)
NOT_PROVED = ("slippery walls", "payload beyond the motors")
IMPOSSIBLE = {
    "goal too far for two rounds": (["task.goal.com=[0, 0, 1.5]"], ("goal", "round")),
    "goal toe out of reach": (["task.goal.toes.RF=[0.615, 0.9, 1.5]"], ("RF", "goal", "round")),
    "start toe out of reach": (["task.start.toes.RF=[0.615, 0.9, 1.5]"], ("RF", "start", "round")),
    "walls out of reach": (
        ["terrain.walls.gap=3.0", "terrain.regions=[]", "task.goal.toes={}"],
        ("reach", "round"),
    ),
    "slippery walls": (["terrain.friction=0.05", "terrain.regions=[]"], ("friction",)),
    "payload beyond the motors": (["task.payload.mass=200"], ("torque", "friction")),
}


def arguments(name: str) -> list[str]:
    settings = [*IMPOSSIBLE[name][0], "study=null", "solver.time_limit=10"]
    return ["plan-climb", "small.yaml", *(part for one in settings for part in ("--set", one))]


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_impossible_climb(run_command: RunCommand, workplace: Path, name: str) -> None:
    outcome = run_command(*arguments(name))
    assert outcome.code == (4 if name in NOT_PROVED else 3), outcome.err
    assert ("not proved: " in outcome.err) == (name in NOT_PROVED)
    assert outcome.out == ""
    lines = outcome.err.splitlines()
    assert next(line for line in lines if not line.startswith("progress")).startswith("error: ")
    assert "Traceback" not in outcome.err
    assert [entry.name for entry in workplace.iterdir()] == ["small.yaml"]


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_the_reason_is_in_the_robots_terms(run_command: RunCommand, name: str) -> None:
    said = run_command(*arguments(name)).err
    assert any(word in said for word in IMPOSSIBLE[name][1]), said
