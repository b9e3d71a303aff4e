"""`climbplan data`: describe, merge, split and export datasets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from climbplan.api.plan_path import find_plan
from climbplan.cli.console import Invocation, print_json, print_result, standard_output, warn
from climbplan.cli.options import Force, Json, Quiet, Verbose
from climbplan.errors import UsageError

if TYPE_CHECKING:
    from climbplan.store.dataset import Dataset

File = Annotated[
    Path, typer.Argument(metavar="FILE", help="Dataset, or the output directory it is in.")
]
Files = Annotated[
    list[Path], typer.Argument(metavar="FILE...", help="Datasets, or their output directories.")
]

data = typer.Typer(
    help="Describe, merge, split and export datasets.",
    no_args_is_help=True,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@data.command()
def info(
    files: Files, as_json: Json = False, quiet: Quiet = False, verbose: Verbose = False
) -> None:
    """Print rows, outcomes, costs, times and reasons of failures."""
    from climbplan.datasets.motions.statistics import build_motion_values, format_motion_counts
    from climbplan.reports.report_files import replace_non_finite
    from climbplan.store.dataset_statistics import compute_statistics, format_statistics

    datasets = [(path, _read(path)) for path in map(find_plan, files)]
    if as_json:
        print_json(
            {
                "datasets": [
                    replace_non_finite(
                        {"file": str(p), **compute_statistics(d), "motions": build_motion_values(d)}
                    )
                    for p, d in datasets
                ]
            }
        )
        return
    for path, dataset in datasets:
        lines = [str(path), *format_statistics(dataset), *format_motion_counts(dataset)]
        print_result("\n".join(lines))


@data.command()
def merge(
    context: typer.Context,
    files: Files,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The merged dataset.")],
    *,
    drop_duplicates: Annotated[
        bool,
        typer.Option("--drop-duplicates", help="Leave out rows whose problem an earlier row has."),
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Merge datasets of one problem, made with different seeds, into one."""
    from climbplan.datasets.combining import merge as merged
    from climbplan.store.dataset_file import write_dataset_file

    _require_place(out, force)
    done = merged(
        [(str(path), _read(path).move(path.parent, out.parent)) for path in map(find_plan, files)],
        drop_duplicates,
    )
    if done.dropped:
        warn(f"{done.dropped} rows left out: an earlier row holds the same problem")
    write_dataset_file(done.data, out)
    context.ensure_object(Invocation).note(f"merge     {done.data.count} rows")
    print_result(str(out))


@data.command()
def split(
    context: typer.Context,
    file: File,
    *,
    test: Annotated[
        float,
        typer.Option("--test", metavar="SHARE", help="Fraction of the problems that is for tests."),
    ] = 0.2,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="Seed of the split.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="Dataset to write, with masks [default: the file itself].",
        ),
    ] = None,
    files: Annotated[
        Path | None,
        typer.Option(
            "--files", metavar="DIR", help="Directory for train.h5 and test.h5, in place of masks."
        ),
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Divide the rows into train and test; no problem is in both.

    Masks `split/train` and `split/test` are written into the dataset, or two datasets into DIR.
    Rows whose problem could not be drawn are in neither.
    """
    from climbplan.datasets.combining import split as divided
    from climbplan.store.dataset_file import write_dataset_file

    if out is not None and files is not None:
        raise UsageError("--out and --files: expected one of them")
    path = find_plan(file)
    dataset = _read(path)
    masks = divided(dataset, test, seed)
    context.ensure_object(Invocation).note(
        f"split     {int(masks.train.sum())} train, {int(masks.test.sum())} test"
    )
    if files is None:
        target = path if out is None else out
        if target.resolve() != path.resolve():
            _require_place(target, force)
        dataset = dataset.move(path.parent, target.parent)
        write_dataset_file(replace(dataset, train=masks.train, test=masks.test), target)
        print_result(str(target))
        return
    targets = {files / "train.h5": masks.train, files / "test.h5": masks.test}
    _make(files)
    for target in targets:
        _require_place(target, force)
    dataset = dataset.move(path.parent, files)
    for target, mask in targets.items():
        write_dataset_file(dataset.rows(mask.nonzero()[0]), target)
        print_result(str(target))


@data.command("export")
def export_table(
    file: File,
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="File ending in .csv or .parquet, or - for CSV on standard output "
            "[default: dataset.csv beside it].",
        ),
    ] = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
    force: Force = False,
) -> None:
    """Write a dataset as a table, one line a row: CSV or Parquet."""
    from climbplan.datasets.exports.table import FORMATS, export_parquet, write_table

    path = find_plan(file)
    dataset = _read(path)
    if out == "-":
        with standard_output() as stream:
            write_table(dataset, stream)
        return
    target = Path(out) if out is not None else path.with_suffix(".csv")
    ending = target.suffix.lower().removeprefix(".")
    if ending not in FORMATS:
        raise UsageError(f"{target}: expected a name that ends in .csv or .parquet")
    _require_place(target, force)
    if ending == "csv":
        write_table(dataset, target)
    else:
        export_parquet(dataset, target)
    print_result(str(target))


def _read(path: Path) -> Dataset:
    from climbplan.store.dataset_file import read_dataset_file

    return read_dataset_file(path)


def _require_place(target: Path, force: bool) -> None:
    if target.exists() and not force:
        raise UsageError(f"{target}: already exists; --force replaces it")
    if not target.absolute().parent.is_dir():
        raise UsageError(f"{target}: no such directory {str(target.parent)!r}")


def _make(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{directory}: cannot be created: {error.strerror}") from error
