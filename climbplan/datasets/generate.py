"""From a spec to all rows of its dataset, whatever stopped the run in between."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from climbplan.datasets.dask_engine import DaskEngine
from climbplan.datasets.engine import Engine
from climbplan.datasets.local_engine import LocalEngine
from climbplan.datasets.recipe import Recipe
from climbplan.datasets.run import Count, run_rows
from climbplan.datasets.schema.loading import LoadedDataset
from climbplan.datasets.shards import ShardStore
from climbplan.datasets.workspace import Identity, RunDirectory
from climbplan.store.dataset import Dataset


@dataclass(frozen=True)
class RunOptions:
    """How a run goes about it; none of it changes a row."""

    target: Path  # output directory; the working directory is beside it
    jobs: int = 1
    scheduler: str | None = None  # of a Dask cluster, instead of `jobs` processes
    resume: bool = False
    force: bool = False


@dataclass(frozen=True)
class Generated:
    """A complete dataset that is not written yet, and how its rows came about."""

    data: Dataset
    count: Count
    resumed: int  # rows of the stopped run
    directory: Path  # that paths of the rows' files start from

    def copy_files(self, target: Path) -> None:
        """Put the files of the rows into a folder, where the dataset will be.

        Links are made where the file system can, so that this takes no room.
        """
        for folder in (path for path in self.directory.iterdir() if path.is_dir()):
            shutil.copytree(folder, target / folder.name, copy_function=_link)


@contextmanager
def generate_rows(
    loaded: LoadedDataset,
    recipe: Recipe,
    files: tuple[Path, ...],
    options: RunOptions,
    report: Callable[[Count], None] | None = None,
    tell: Callable[[str], None] | None = None,
) -> Iterator[Generated]:
    """Yield all rows of a spec; shards are removed after the block, kept if anything stops it.

    files: that the rows depend on beside the spec. tell: is called with lines for people.

    Raises:
        UsageError: a stopped run that is another one or was not to go on, a full disk, a cluster
            that does not answer; whatever making the source raises.
    """
    log = tell or _ignore_line
    spec = loaded.spec
    frame = recipe.source().frame  # what cannot work at all fails here, before any worker
    identity = Identity.of(spec, frame, files)
    with RunDirectory(options.target, identity, options.resume, options.force) as place:
        store = ShardStore(place.path, frame, identity.token, spec.count, spec.shard_size)
        try:
            begin = time.perf_counter()
            stored_rows = store.find()
            for name in stored_rows.damaged:
                log(f"shard {name}; its rows are made again")
            if place.continues:
                log(f"going on: {len(stored_rows.rows)} of {spec.count} rows are there")
            with _select_engine(replace(recipe, token=identity.token), options) as engine:
                count = run_rows(
                    store, engine, spec.seed, stored_rows.rows, stored_rows.answered, report
                )
            data = replace(
                store.dataset(),
                name=loaded.name,
                title=spec.title,
                spec_text=loaded.text,
                spec_sha256=loaded.sha256,
                base_seed=spec.seed,
                timings={
                    "rows": time.perf_counter() - begin,
                    "rows_resumed": len(stored_rows.rows),
                },
                solvers={"method": spec.problem.solver.method},
            )
            yield Generated(data, count, len(stored_rows.rows), place.path)
        except BaseException:
            num_kept = len(store.find().rows)
            if num_kept:
                log(
                    f"stopped: {num_kept} of {spec.count} rows are kept, --resume goes on with them"
                )
            else:
                place.remove()
            raise
        place.remove()


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        shutil.copy2(source, target)


def _select_engine(recipe: Recipe, options: RunOptions) -> Engine:
    if options.scheduler is not None:
        return DaskEngine(recipe, options.scheduler)
    return LocalEngine(recipe, options.jobs)


def _ignore_line(line: str) -> None:
    pass
