"""`climbplan bench mpc`: tables as they come, or one JSON object, and files of both."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

from climbplan.cli.console import Session, print_json, standard_output


def bench_walks(
    session: Session, given: Mapping[str, Any], out: Path | None, force: bool, as_json: bool
) -> None:
    """Run it; a directory that is taken is refused before.

    given: options by name, as of `OnlineOptions`, and `methods`.
    """
    from climbplan.bench.walking.online_options import OnlineOptions
    from climbplan.bench.walking.run import run_mpc
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress

    options = dict(given)
    tables = options.pop("methods", None)
    options["assignments"] = tuple(options.get("assignments", ()))
    with ExitStack() as stack:
        directory = stack.enter_context(OutputDirectory(out, force)) if out is not None else None
        shown = io.StringIO() if as_json else stack.enter_context(standard_output())
        stream = _Twice(shown)
        progress = stack.enter_context(StageProgress(session))
        found = run_mpc(OnlineOptions(**options), tables, stream, progress.report)
        if directory is not None:
            text = json.dumps(found, indent=1, allow_nan=False)
            (directory.path / "bench.json").write_text(text + "\n")
            (directory.path / "bench.txt").write_text(stream.kept)
            directory.publish()
    if as_json:
        print_json(found)


class _Twice(io.TextIOBase, TextIO):
    """Text that is shown as it comes, and kept."""

    def __init__(self, shown: TextIO) -> None:
        self._shown, self.kept = shown, ""

    def write(self, text: str) -> int:
        """To both."""
        self.kept += text
        return self._shown.write(text)

    def flush(self) -> None:
        """What was written is shown."""
        self._shown.flush()
