"""Rows on disk while a run goes on: each shard a file that is whole, or damaged and named.

A shard holds those of its rows that were made so far. First line: JSON with the run's token and the
SHA-256 of what follows, arrays in NumPy's own archive (never pickles).
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import time
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from climbplan.errors import PlanFileError, UsageError
from climbplan.store.atomic_file import replace_atomically
from climbplan.store.dataset import Dataset, DatasetFrame
from climbplan.store.dataset_row import Row, RowAnswer, build_dataset

_FORMAT = "climbplan/shard 1"
_COLUMNS = ("parameters", "feasible", "integers", "objective", "bound", "time", "seed", "row")
_LONGEST_HEADER = 4096
_MAX_WAIT = 10.0  # [s] that rows of an incomplete shard wait to be written
_MAX_WRITING = 0.05  # fraction of a run's time for writing incomplete shards


@dataclass(frozen=True)
class Found:
    """What an earlier run left."""

    rows: frozenset[int]
    answered: int
    damaged: tuple[str, ...]  # shards that were removed, each with its rows and what was wrong


@dataclass
class ShardStore:
    """The shards of one run in a directory of its own."""

    directory: Path
    frame: DatasetFrame
    token: str  # of the run: a shard of another is not taken
    count: int  # rows of the whole run
    size: int  # rows of a shard
    _open: dict[int, list[Row]] = field(default_factory=dict)  # incomplete shards
    _unsaved: set[int] = field(default_factory=set)
    _save_at: float = -math.inf  # `time.monotonic` [s]: the first rows are written at once

    def find(self) -> Found:
        """Take up what is there; damaged shards are removed.

        Raises UsageError if the directory cannot be written.
        """
        rows: set[int] = set()
        answered, damaged = 0, []
        for shard in range(-(-self.count // self.size)):
            path = self._path(shard)
            if not path.exists():
                continue
            try:
                stored = self._read(shard)
            except PlanFileError as error:
                damaged.append(str(error))
                path.unlink()
                continue
            rows.update(int(k) for k in stored.row)
            answered += int(stored.feasible.sum())
            if stored.count < len(self._rows(shard)):
                self._open[shard] = _convert_to_rows(stored)
        return Found(frozenset(rows), answered, tuple(damaged))

    def read_rows(self) -> Dataset:
        """Return the rows that were made so far, in order; a run may be going on.

        Raises PlanFileError for a damaged shard, and UsageError where there are no rows.
        """
        stored = [
            self._read(shard)
            for shard in range(-(-self.count // self.size))
            if self._path(shard).exists()
        ]
        if not stored:
            raise UsageError(f"{self.directory}: no rows in it")
        return Dataset.join(stored)

    def add(self, rows: Iterable[Row]) -> None:
        """Keep rows: the first ones and complete shards are written at once, others now and then.

        A run that is killed loses the rows of at most `_MAX_WAIT` seconds, and never all of them.
        Files of rows are written before them. Raises UsageError if the disk does not take them.
        """
        for row in rows:
            shard = row.index // self.size
            for name, content in row.answer.files.items():
                self._write_file(name, content)
            stored = replace(row, answer=replace(row.answer, files={}))
            self._open.setdefault(shard, []).append(stored)
            self._unsaved.add(shard)
        for shard in sorted(self._unsaved):
            if len(self._open[shard]) == len(self._rows(shard)):
                self._write(shard)
                del self._open[shard]
        if self._unsaved and time.monotonic() >= self._save_at:
            self.flush()

    def flush(self) -> None:
        """Write what is not written yet; raises UsageError if the disk does not take it."""
        begin = time.monotonic()
        for shard in sorted(self._unsaved):
            self._write(shard)
        end = time.monotonic()
        self._save_at = end + min((end - begin) / _MAX_WRITING, _MAX_WAIT)

    def dataset(self) -> Dataset:
        """Return all rows of a complete run, in order.

        Raises PlanFileError for a shard that is missing or was damaged since.
        """
        datasets = []
        for shard in range(-(-self.count // self.size)):
            stored = self._read(shard)
            if stored.count != len(self._rows(shard)):
                raise PlanFileError(f"{self._path(shard)}: {stored.count} rows, expected more")
            datasets.append(stored)
        return Dataset.join(datasets)

    def _rows(self, shard: int) -> range:
        return range(shard * self.size, min((shard + 1) * self.size, self.count))

    def _path(self, shard: int) -> Path:
        rows = self._rows(shard)
        return self.directory / f"rows_{rows.start:08d}_{rows.stop - 1:08d}.shard"

    def _write_file(self, name: str, content: bytes) -> None:
        path = self.directory / name
        try:
            path.parent.mkdir(exist_ok=True)
        except OSError as error:
            raise UsageError(f"{path.parent}: cannot be created: {error.strerror}") from error
        with replace_atomically(path) as temporary_path:
            temporary_path.write_bytes(content)

    def _write(self, shard: int) -> None:
        dataset = build_dataset(self.frame, self._open[shard])
        content = io.BytesIO()
        texts = json.dumps([dataset.status, dataset.message]).encode()
        arrays: dict[str, Any] = {name: vars(dataset)[name] for name in _COLUMNS}
        arrays |= {f"solution.{name}": value for name, value in dataset.solution.items()}
        np.savez(content, texts=np.frombuffer(texts, np.uint8), **arrays)
        payload = content.getvalue()
        header = {
            "format": _FORMAT,
            "run": self.token,
            "sha256": hashlib.sha256(payload).hexdigest(),
        }
        with replace_atomically(self._path(shard)) as temporary_path:
            temporary_path.write_bytes(json.dumps(header).encode() + b"\n" + payload)
        self._unsaved.discard(shard)

    def _read(self, shard: int) -> Dataset:
        """Raises PlanFileError for anything but a whole shard of this run."""
        path, rows = self._path(shard), self._rows(shard)

        def refuse(what: str) -> PlanFileError:
            return PlanFileError(f"{path.name} (rows {rows.start} to {rows.stop - 1}): {what}")

        try:
            with path.open("rb") as file:
                line = file.readline(_LONGEST_HEADER)
                payload = file.read()
            header = json.loads(line)
        except FileNotFoundError:
            raise refuse("missing") from None
        except (OSError, ValueError) as error:
            raise refuse(f"damaged: {error}") from error
        if not isinstance(header, dict) or header.get("format") != _FORMAT:
            raise refuse("damaged: no shard")
        if header.get("run") != self.token:
            raise refuse("of another run")
        if header.get("sha256") != hashlib.sha256(payload).hexdigest():
            raise refuse("damaged: its checksum does not fit")
        try:
            with np.load(io.BytesIO(payload), allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            status, message = json.loads(arrays["texts"].tobytes())
            stored = Dataset(
                frame=self.frame,
                solution={name: arrays[f"solution.{name}"] for name in self.frame.layouts},
                status=tuple(status),
                message=tuple(message),
                **{name: arrays[name] for name in _COLUMNS},
            )
        except (ValueError, KeyError, zipfile.BadZipFile) as error:
            raise refuse(f"damaged: {error}") from error
        expected_rows = set(rows)
        if len(set(stored.row.tolist()) & expected_rows) != stored.count:
            raise refuse("damaged: other rows in it")
        return stored


def _convert_to_rows(stored: Dataset) -> list[Row]:
    """Return a part of a shard as rows again, to be completed."""
    rows = []
    for k in range(stored.count):
        solution = {name: value[k] for name, value in stored.solution.items()}
        is_drawn = bool(np.isfinite(stored.parameters[k]).all())
        rows.append(
            Row(
                index=int(stored.row[k]),
                seed=int(stored.seed[k]),
                parameters=stored.parameters[k] if is_drawn else None,
                answer=RowAnswer(
                    status=stored.status[k],
                    message=stored.message[k],
                    solution=solution,
                    integers=stored.integers[k],
                    objective=float(stored.objective[k]),
                    bound=float(stored.bound[k]),
                    time=float(stored.time[k]),
                    evidence=solution,
                ),
            )
        )
    return rows
