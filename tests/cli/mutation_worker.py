"""A warm process that forks a child for each command line, as its parent asks.

Each line of standard input is JSON. {warm, folder}: run these commands here, so that what they load
and compile is there for all children. {folder, command}: run one in a child; the line of output
tells how it ended: {code, seconds, message, memory}. A child that does not end is killed. Commands
that begin with ! are functions that read a file, for readers that a command reaches after long
computations only, and commands in an environment and process of their own.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import io
import json
import os
import resource
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import typer
from mutation_sources import made_sources

from climbplan.cli.app import run
from climbplan.climb.envelopes.file import read_envelopes
from climbplan.errors import ClimbplanError
from climbplan.instances import check_solution
from climbplan.learning.model_file import read_model
from climbplan.mechanics.gripper import read_grips
from climbplan.mechanics.gripper_model import load_model
from climbplan.mechanics.identification import fit

_MAX_ADDRESSES = 4 * 2**30  # [bytes]
_MAX_CPU = 12  # [s] after which a child is ended by a signal
_PATIENCE = 120.0  # [s] of waiting, on a machine that has other things to do
_RESAMPLES = 3  # of fits of stiffness: more of them read nothing more


class _Unseen:
    """In place of the server of `view`: the scene was built, that is all."""

    address = "nowhere"

    def __init__(self, *_: Any) -> None: ...

    def __enter__(self) -> _Unseen:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    def run(self) -> None: ...


def _run_in_child(folder: str, command: list[str]) -> dict[str, Any]:
    """Run a command in a forked child and return how it ended."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        resource.setrlimit(resource.RLIMIT_AS, (_MAX_ADDRESSES, _MAX_ADDRESSES))
        resource.setrlimit(resource.RLIMIT_CPU, (_MAX_CPU, _MAX_CPU + 2))
        os.chdir(folder)
        with os.fdopen(writer, "w") as stream:
            json.dump(_outcome(command), stream)
        os._exit(0)
    os.close(writer)
    ready, _, _ = select.select([reader], [], [], _PATIENCE)
    if not ready:
        os.killpg(child, signal.SIGKILL)
    with os.fdopen(reader) as stream:
        text = stream.read()
    _, status, usage = os.wait4(child, 0)
    if text:
        answer = json.loads(text)
    elif not ready or os.WTERMSIG(status) == signal.SIGXCPU:
        answer = {"code": -3, "message": "did not end"}
    else:
        answer = {"code": -2, "message": f"the process ended with signal {os.WTERMSIG(status)}"}
    seconds = usage.ru_utime + usage.ru_stime
    return {**answer, "seconds": seconds, "memory": 1024 * usage.ru_maxrss}


def _outcome(command: list[str]) -> dict[str, Any]:
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = _code(command)
    except BaseException as error:  # nothing may come through
        code = -1
        err.write(f"{type(error).__name__}: {error}")
    return {"code": code, "message": err.getvalue()[-1500:]}


def _code(command: list[str]) -> int:
    first, *rest = command
    if first == "!environment":
        return _in_environment(*rest)
    if first == "!instance":
        # 1 says there that a solution is not feasible
        return {0: 0, 1: 0}.get(check_solution.main(rest), 2)
    if first in _READERS:
        try:
            _READERS[first](Path(rest[0]))
        except ClimbplanError as error:
            print(error, file=sys.stderr)
            return int(error.exit_code)
        return 0
    return int(run(command))


_READERS: dict[str, Callable[[Path], object]] = {
    "!sources": made_sources,
    "!gripper": lambda path: load_model(str(path)),
    "!grips": read_grips,
    "!model": read_model,
    "!envelopes": read_envelopes,
}


def _in_environment(name: str, value: str, *command: str) -> int:
    done = subprocess.run(
        [sys.executable, "-m", "climbplan", *command],
        env={**os.environ, name: value},
        capture_output=True,
        check=False,
    )
    print(done.stderr.decode(errors="replace"), file=sys.stderr)
    return done.returncode if done.returncode >= 0 else -2


def _prepare() -> None:
    """Make what commands do without their files cheap: help, a window, draws of a fit."""
    typer.main.get_command = functools.cache(typer.main.get_command)
    fit._NUM_RESAMPLES = _RESAMPLES
    with contextlib.suppress(ImportError):
        from climbplan.reports.viewer import server

        server.Viewer = _Unseen  # type: ignore[assignment, misc]


def main() -> None:
    """Answer until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    _prepare()
    for line in sys.stdin:
        request = json.loads(line)
        if "warm" in request:
            os.chdir(request["folder"])
            answer = {"ends": [_outcome(command) for command in request["warm"]]}
            gc.collect()
            gc.freeze()  # collections in children then copy no pages of this process
        else:
            answer = _run_in_child(request["folder"], request["command"])
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
