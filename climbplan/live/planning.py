"""Plans of the live page: one planning process at a time, its lines, and what it answers.

A plan is made by the command line itself in a process of its own. What the page shows is therefore
what a terminal shows, and cancelling it cannot harm the server.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Self

from climbplan.errors import UsageError
from climbplan.progress import INTERVAL_VARIABLE
from climbplan.schema.source import NAME_VARIABLE

# By kind of spec: the kinds that plans are made of
COMMANDS = {
    "climb": "plan-climb",
    "transition": "plan-transition",
    "mpc": "plan-mpc",
    "limms": "plan-limms",
    "bookshelf": "solve-bookshelf",
}
MAX_RUNS = 50  # that are kept; their plan files stay in the folder
_MAX_LINES = 1000  # of one run
_MAX_LINE_LENGTH = 2000  # [characters]
_MAX_ANSWER = 100_000_000  # [bytes] of the report
_GRACE = 4.0  # [s] from cancelling to killing; the command line itself ends within 2 s
_PROGRESS_INTERVAL = 1  # [s] between lines of progress
_PROGRESS = "progress"  # how these lines begin


@dataclass
class Run:
    """One run of a planner: what it was given, its lines so far, and its answer."""

    number: int
    kind: str
    spec_text: str
    is_complete: bool = False
    is_cancelled: bool = False
    exit_code: int | None = None  # of the command line; None while it runs
    answer: dict[str, Any] = field(default_factory=dict)  # the object that `--json` prints
    plan_path: Path | None = None  # of the plan, or of the part of the way that was planned
    lines: list[str] = field(default_factory=list)  # of standard error, progress left out
    progress_text: str = ""  # the latest line of progress
    revision: int = 0  # rises with every change
    started: float = field(default_factory=time.monotonic)  # [s]
    seconds: float | None = None  # from start to end

    def summarise(self) -> dict[str, Any]:
        """Return plain values about the run, for the page's list of runs."""
        answer = self.answer
        outcome = answer.get("level") or answer.get("status") or "error"
        return {
            "number": self.number,
            "kind": self.kind,
            "complete": self.is_complete,
            "outcome": "cancelled" if self.is_cancelled else outcome if self.is_complete else "",
            "cost": answer.get("objective"),
            "seconds": self.seconds,
            "replayable": self.plan_path is not None,
        }


class PlannerBusy(UsageError):
    """A plan is being made: the next one has to wait, or that one is cancelled first."""


class Planner:
    """Runs the command line on specs, one at a time, in a folder.

    Args:
        folder: the directory that relative paths in specs start from; plans are written to
            `outputs/live_N` in it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._changed = threading.Condition()
        self._runs: dict[int, Run] = {}
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        """End the planning process, if one runs, and wait for it."""
        child = self._child
        if child is not None:
            self.cancel()
            with suppress(subprocess.TimeoutExpired):
                child.wait(_GRACE + 1.0)

    def start(self, kind: str, spec_text: str, quick: bool) -> Run:
        """Begin to plan.

        Args:
            kind: kind of the spec.
            spec_text: YAML of the spec, which is not checked here.
            quick: plan with `--quick`.

        Raises:
            PlannerBusy: a plan is being made.
            UsageError: no plan is made from specs of this kind, or the folder cannot be written.
        """
        if kind not in COMMANDS:
            raise UsageError(
                f"no plan is made from specs of kind {kind!r}: expected {', '.join(COMMANDS)}"
            )
        with self._changed:
            if self._child is not None:
                raise PlannerBusy("a plan is being made: wait for it or cancel it")
            run = Run(self._choose_number(), kind, spec_text)
            self._child = child = self._start_child(run, quick)
            self._runs[run.number] = run
            for number in sorted(self._runs)[:-MAX_RUNS]:
                del self._runs[number]
        threading.Thread(target=self._follow, args=(run, child), daemon=True).start()
        return run

    def cancel(self) -> bool:
        """Ask the planning process to end, kill it if it does not; return whether one runs."""
        with self._changed:
            child = self._child
            if child is None:
                return False
            for run in self._runs.values():
                run.is_cancelled = run.is_cancelled or not run.is_complete
        child.send_signal(signal.SIGTERM)
        timer = threading.Timer(_GRACE, _kill_group, (child,))
        timer.daemon = True
        timer.start()
        return True

    def list_runs(self) -> list[Run]:
        """Return the runs that are kept, the latest last."""
        with self._changed:
            return list(self._runs.values())

    def find_run(self, number: int) -> Run | None:
        """Return the run of a number; None if there is none."""
        with self._changed:
            return self._runs.get(number)

    def follow(self, run: Run, patience: float) -> Iterator[int]:
        """Yield the number of lines so far whenever a run has changed, until it is complete.

        Args:
            run: the run.
            patience: longest time without a yield [s].
        """
        revision, is_complete = -1, False
        while not is_complete:
            with self._changed:
                if run.revision == revision and not run.is_complete:
                    self._changed.wait(patience)
                revision, is_complete, num_lines = run.revision, run.is_complete, len(run.lines)
            yield num_lines

    def _choose_number(self) -> int:
        """Return the first number whose output directory is free. Raises UsageError."""
        outputs = self.folder / "outputs"
        if not outputs.resolve().is_relative_to(self.folder.resolve()):
            raise UsageError(f"{outputs}: leads out of the folder that is served")
        number = max(self._runs, default=0) + 1
        while (outputs / f"live_{number}").exists():
            number += 1
        return number

    def _start_child(self, run: Run, quick: bool) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-P", "-m", "climbplan", COMMANDS[run.kind], "-", "--json"]
        command += ["--out", f"outputs/live_{run.number}", "--quick" if quick else "--no-report"]
        child = subprocess.Popen(
            command,
            cwd=self.folder,
            env={
                **os.environ,
                INTERVAL_VARIABLE: str(_PROGRESS_INTERVAL),
                NAME_VARIABLE: f"live_{run.number}",
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        assert child.stdin is not None
        with child.stdin as stream, suppress(BrokenPipeError):
            stream.write(run.spec_text.encode())
        return child

    def _follow(self, run: Run, child: subprocess.Popen[bytes]) -> None:
        """Read what the child prints until it ends, and keep its answer."""
        assert child.stdout is not None
        assert child.stderr is not None
        output: list[bytes] = []
        stdout = child.stdout
        reader = threading.Thread(target=lambda: output.append(stdout.read(_MAX_ANSWER + 1)))
        reader.start()
        for line in child.stderr:
            text = line.decode(errors="replace").rstrip()[:_MAX_LINE_LENGTH]
            self._change(run, partial(_add_line, run, text))
        reader.join()
        child.stdout.close()
        child.stderr.close()
        exit_code = child.wait()
        self._change(run, lambda: self._end(run, exit_code, output[0]))

    def _end(self, run: Run, exit_code: int, output: bytes) -> None:
        run.exit_code, run.is_complete = exit_code, True
        run.seconds = time.monotonic() - run.started
        if len(output) <= _MAX_ANSWER:
            with suppress(ValueError):
                run.answer = dict(json.loads(output or b"{}"))
        path = run.answer.get("plan") or run.answer.get("partial")
        run.plan_path = self.folder / path if isinstance(path, str) else None
        self._child = None

    def _change(self, run: Run, change: Callable[[], None]) -> None:
        with self._changed:
            change()
            run.revision += 1
            self._changed.notify_all()


def _add_line(run: Run, text: str) -> None:
    if text.startswith(_PROGRESS):
        run.progress_text = text.removeprefix(_PROGRESS).strip()
    elif len(run.lines) < _MAX_LINES:
        run.lines.append(text)


def _kill_group(child: subprocess.Popen[bytes]) -> None:
    if child.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
