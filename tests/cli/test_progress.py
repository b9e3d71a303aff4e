"""Lines of progress: where they go, what they say, and when there are none."""

from __future__ import annotations

import io
import re
import time
from pathlib import Path

import numba
import pytest

import climbplan
from climbplan import compiling, progress
from climbplan.cli.console import Invocation
from climbplan.cli.environment import require_sound_environment
from climbplan.cli.progress import StageProgress
from climbplan.errors import UsageError
from climbplan.progress import ProgressMeter, format_seconds, report_search

PACKAGE = Path(climbplan.__file__).parent
STAGE = re.compile(r'(?:report|report_stage|progress|\.stage)\(\s*"([a-z]+)"')


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def _run_briefly(session: Invocation) -> None:
    """Report a stage for longer than the interval between lines."""
    with StageProgress(session) as stages:
        stages.report("posture", 0.4)
        report_search(0.0747, 0.0739, deadline=time.monotonic() + 60.0)
        time.sleep(0.2)


@pytest.fixture
def short_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("climbplan.progress.LINE_INTERVAL", 0.05)  # [s]


@pytest.mark.usefixtures("short_interval")
@pytest.mark.parametrize("as_json", [False, True])
def test_lines_go_to_standard_error_alone(
    as_json: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    _run_briefly(Invocation(as_json=as_json))
    out, err = capsys.readouterr()
    assert out == ""
    first = err.splitlines()[0]
    assert first.startswith("progress  posture   40 %  0 s elapsed, about 0 s left of this stage")
    assert first.endswith("incumbent 0.0747, bound 0.0739")


def test_the_environment_sets_the_interval(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(progress.INTERVAL_VARIABLE, "1")
    with StageProgress(Invocation()) as stages:
        stages.report("trajectory", 1.0)
        time.sleep(1.2)
    assert "progress  trajectory 100 % 1 s elapsed" in capsys.readouterr().err
    monkeypatch.setenv(progress.INTERVAL_VARIABLE, "soon")
    with pytest.raises(UsageError, match="CLIMBPLAN_PROGRESS_SECONDS"):
        require_sound_environment()


@pytest.mark.usefixtures("short_interval")
def test_quiet_runs_and_terminals_have_no_lines(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _run_briefly(Invocation(quiet=True))
    assert capsys.readouterr() == ("", "")
    terminal = _Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    _run_briefly(Invocation())
    assert "progress" not in terminal.getvalue()


def test_a_short_run_writes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with StageProgress(Invocation()) as stages:
        stages.report("posture", 0.5)
    assert capsys.readouterr().err == ""


def test_time_left_is_what_fraction_or_deadline_say(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    meter = ProgressMeter()
    with meter.observe():
        meter.report("solve", 0.0)
        clock[0] = 110.0
        assert meter.remaining is None
        assert meter.describe().split() == ["solve", "10", "s", "elapsed"]
        meter.report("solve", 0.25)
        assert meter.remaining == pytest.approx(30.0)
        report_search(deadline=115.0)  # the search ends before the estimate
        assert "at most 5 s left" in meter.describe()
        report_search(float("inf"), float("-inf"))  # as solvers say that there is none
        assert "incumbent" not in meter.describe()
        assert "bound" not in meter.describe()
        report_search(2.0, 1.0)
        meter.report("refine", 0.0)  # another stage, another search
        assert "incumbent" not in meter.describe()
        assert "at most 5 s left" in meter.describe()
        meter.report("verify", 0.0)  # what follows a search takes the time that it takes
        meter.report("report", 0.0)
        assert "left" not in meter.describe()
    report_search(3.0)  # nobody observes it
    assert meter.search.incumbent is None


def test_compilation_is_named_and_timed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("climbplan.cli.progress._LONG_COMPILATION", 0.0)
    monkeypatch.setattr(compiling, "LONG", 60.0)
    compiling._TELLER.__init__()
    names = []
    record = ProgressMeter.report_compilation

    def observe(meter: ProgressMeter, function: str) -> None:
        names.append(function)
        record(meter, function)

    monkeypatch.setattr(ProgressMeter, "report_compilation", observe)

    def double(x: int) -> int:
        return 2 * x

    with StageProgress(Invocation()):
        assert numba.njit(double)(3) == 6
    assert names[0].endswith(".double")
    assert names[-1] == ""
    assert "compiled 1 function in" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("seconds", "text"), [(7.6, "8 s"), (125.0, "2:05 min"), (3725.0, "1:02:05 h")]
)
def test_durations_for_people(seconds: float, text: str) -> None:
    assert format_seconds(seconds) == text


def test_the_glossary_has_every_stage() -> None:
    """Words of progress lines are in the table of stages on the page of concepts."""
    sources = [path.read_text() for path in PACKAGE.rglob("*.py")]
    stages = {name for source in sources for name in STAGE.findall(source)}
    assert {"posture", "force", "modes", "simulate"} <= stages
    table = (PACKAGE.parent / "docs" / "concepts.md").read_text().partition("| stage | what")[2]
    rows = table.partition("\n## ")[0].splitlines()
    listed = {word for row in rows for word in re.findall(r"[a-z]+", row.partition(" | ")[0])}
    unlisted = stages - listed - {"earlier", "done", "incumbent"}  # events in logs of a tree
    assert not unlisted
