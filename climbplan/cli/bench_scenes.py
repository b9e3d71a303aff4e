"""Comparisons of methods on the same scenes: `bench bookshelf`, `strategies` and `limms`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from climbplan.cli.console import Session, print_json, standard_output


@dataclass(frozen=True)
class Comparison:
    """A comparison of methods on the same scenes, ready to run and to be told.

    `run` takes what it reports to, and where it writes its tables as they are done, if it does.
    """

    run: Callable[[Callable[[str, float], None], TextIO | None], Any]
    plain: Callable[[Any], dict[str, Any]]
    write_files: Callable[[Any, Path], None]
    write_text: Callable[[Any, TextIO], None] | None  # None: `run` has written all of it


def comparison(name: str, given: dict[str, Any]) -> Comparison:
    """The one of this name, with these options."""
    if name == "bookshelf":
        from climbplan.bench.bookshelf import run as of_methods

        methods = of_methods.BenchOptions(**given)
        return Comparison(
            lambda report, out: of_methods.bench_bookshelf(methods, report),
            lambda result: of_methods.as_json(result, methods),
            lambda result, path: of_methods.write_files(result, methods, path),
            of_methods.write_text,
        )
    if name == "limms":
        from climbplan.bench.limms import run as of_modules

        limms = of_modules.LimmsOptions(**given)
        return Comparison(
            lambda report, out: of_modules.bench_limms(limms, report, out),
            lambda result: of_modules.as_json(result, limms),
            lambda result, path: of_modules.write_files(result, limms, path),
            None,
        )
    from climbplan.bench.bookshelf import strategies, strategy_tables

    options = strategies.StrategyOptions(**given)
    return Comparison(
        lambda report, out: strategies.bench_strategies(options, report),
        lambda result: strategies.as_json(result, options),
        lambda result, path: strategy_tables.write_files(result, options, path),
        strategy_tables.write_text,
    )


def bench_scenes(
    session: Session, chosen: Comparison, out: Path | None, force: bool, as_json: bool
) -> None:
    """Run it; a directory that is taken is refused before."""
    from climbplan.cli.output_directory import OutputDirectory
    from climbplan.cli.progress import StageProgress

    with ExitStack() as stack:
        directory = stack.enter_context(OutputDirectory(out, force)) if out is not None else None
        stream = None if as_json else stack.enter_context(standard_output())
        with StageProgress(session) as progress:
            result = chosen.run(progress.report, stream)
        if directory is not None:
            chosen.write_files(result, directory.path)
            directory.publish()
    if as_json:
        print_json(chosen.plain(result))
    elif chosen.write_text is not None:
        with standard_output() as stream:
            chosen.write_text(result, stream)
