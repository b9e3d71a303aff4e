"""A process that runs command lines one after another, as its parent asks.

Each line of standard input is JSON, {folder, commands}; each line of its output tells how they
ended: [{code, seconds, said, memory}]. The parent kills it where one does not end. Commands that
begin with ! are functions that read a file, for readers that a command reaches after long
computations only, and commands in an environment of their own.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from climbplan.bench.instances import check_solution
from climbplan.cli.app import run
from climbplan.climb.envelopes.file import read_envelopes
from climbplan.errors import ClimbplanError
from climbplan.learning.model_file import read_model
from climbplan.mechanics.gripper import read_grips
from climbplan.mechanics.gripper_model import load_model

_MOST_MEMORY = 4 * 2**30  # [bytes] of addresses


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


def _outcome(command: list[str]) -> dict[str, Any]:
    out, err = io.StringIO(), io.StringIO()
    start = time.process_time()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = _code(command)
    except BaseException as error:  # nothing may come through
        code = -1
        err.write(f"{type(error).__name__}: {error}")
    seconds = time.process_time() - start
    memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"code": code, "seconds": seconds, "said": err.getvalue()[-1500:], "memory": memory}


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
        timeout=120,
        check=False,
    )
    print(done.stderr.decode(errors="replace"), file=sys.stderr)
    return done.returncode if done.returncode >= 0 else -2


def main() -> None:
    """Answer until standard input ends."""
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    answers = os.fdopen(os.dup(1), "w")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    with contextlib.suppress(ImportError):
        from climbplan.reports.viewer import server

        server.Viewer = _Unseen  # type: ignore[assignment, misc]
    for line in sys.stdin:
        asked = json.loads(line)
        os.chdir(asked["folder"])
        print(json.dumps([_outcome(command) for command in asked["commands"]]), file=answers)
        answers.flush()
        os.chdir(Path(asked["folder"]).parent)


if __name__ == "__main__":
    main()
