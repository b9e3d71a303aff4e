"""A process that runs command lines one after another, as its parent asks.

Each line of standard input is JSON, {folder, commands}; each line of its output tells how they
ended: [{code, seconds, said}]. The parent kills it where one does not end.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from climbplan.cli.app import run

_MOST_MEMORY = 8 * 2**30  # [bytes]


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
            code = int(run(command))
    except BaseException as error:  # nothing may come through
        code = -1
        err.write(f"{type(error).__name__}: {error}")
    seconds = time.process_time() - start
    return {"code": code, "seconds": seconds, "said": err.getvalue()[-1500:]}


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
