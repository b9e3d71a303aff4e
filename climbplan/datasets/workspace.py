"""The working directory of a run: beside the output, hidden, there until the run is complete.

It holds the shards and a note of what is run. A stopped run goes on only if that is the same.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import climbplan
from climbplan.datasets.schema.model import DatasetSpec
from climbplan.errors import UsageError
from climbplan.store.atomic_file import replace_atomically
from climbplan.store.dataset import DatasetFrame

_NOTE = "run.json"
_LOCK = "lock"
_MOST_LISTED = 6
_TITLES = ("title",)  # keys of a spec that change no row


@dataclass(frozen=True)
class Identity:
    """What makes two runs the same: equal ones make equal rows."""

    spec: Mapping[str, Any]  # plain values of the whole spec
    problem: Mapping[str, Any]  # name, columns and facts of the problem
    files: Mapping[str, str]  # SHA-256 of what the spec or the command line names

    @classmethod
    def of(cls, spec: DatasetSpec, frame: DatasetFrame, files: tuple[Path, ...]) -> Identity:
        """Return the identity of a run that is about to start.

        Raises UsageError for a file that cannot be read.
        """
        values = spec.model_dump(mode="json")
        problem = {
            "kind": frame.kind,
            "name": frame.problem,
            "parameters": list(frame.parameter_names),
            "integers": list(frame.integer_names),
            "facts": dict(frame.facts),
        }
        return cls(
            {key: value for key, value in values.items() if key not in _TITLES},
            json.loads(json.dumps(problem)),
            {str(path): _compute_digest(path) for path in files},
        )

    @property
    def token(self) -> str:
        """A hash of it all."""
        text = json.dumps([self.spec, self.problem, self.files], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


class RunDirectory:
    """Context: the working directory of the run into `target`, locked against other runs.

    Raises UsageError on entry if another run is at it, or a stopped run is there and `resume` is
    not set, or it is not the same run.
    """

    def __init__(self, target: Path, identity: Identity, resume: bool, force: bool) -> None:
        final = Path(os.path.realpath(target))
        self.path = final.parent / f".{final.name}.rows"
        self.continues = False  # a stopped run is there
        self._target = target
        self._identity = identity
        self._resume, self._force = resume, force
        self._lock: int | None = None

    def __enter__(self) -> Self:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._take_lock()
            try:
                self._open()
            except BaseException:
                if not (self.path / _NOTE).exists():  # nothing that a run could go on with
                    self.remove()
                self._release()
                raise
        except OSError as error:
            reason = error.strerror or str(error)
            raise UsageError(f"{self.path}: cannot be written: {reason}") from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._release()

    def remove(self) -> None:
        """The run is complete: nothing here is needed any more."""
        shutil.rmtree(self.path, ignore_errors=True)

    def _open(self) -> None:
        note = self.path / _NOTE
        if note.exists() and not self._resume and not self._force:
            raise UsageError(
                f"{self._target}: a stopped run is there; --resume goes on with it, --force "
                "starts anew"
            )
        if note.exists() and self._resume:
            self._require_same(note)
            self.continues = True
            return
        for entry in self.path.iterdir():
            if entry.name != _LOCK:
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        text = json.dumps(
            {
                "token": self._identity.token,
                "spec": self._identity.spec,
                "problem": self._identity.problem,
                "files": self._identity.files,
                "climbplan_version": climbplan.__version__,
            },
            indent=1,
        )
        with replace_atomically(note) as temporary_path:
            temporary_path.write_text(text, encoding="utf-8")

    def _require_same(self, note: Path) -> None:
        try:
            stored = json.loads(note.read_text(encoding="utf-8"))
            stored_sections = [dict(stored[name]) for name in ("spec", "problem", "files")]
            token = stored["token"]
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise UsageError(
                f"{note}: damaged, so the stopped run cannot be told; --force starts anew"
            ) from error
        if token == self._identity.token:
            return
        now = (self._identity.spec, self._identity.problem, self._identity.files)
        differences = [
            line
            for name, before, after in zip(
                ("", "problem", "contents of"), stored_sections, now, strict=True
            )
            for line in _list_differences(before, after, name)
        ]
        listed = [
            *differences[:_MOST_LISTED],
            *(["..."] if len(differences) > _MOST_LISTED else []),
        ]
        what = "; ".join(listed) or "another version of its files"
        raise UsageError(
            f"{self._target}: the stopped run was another one, --resume cannot go on with it: "
            f"{what}; --force starts anew"
        )

    def _take_lock(self) -> None:
        self._lock = os.open(self.path / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._release()
            raise UsageError(f"{self._target}: another run is writing it") from None

    def _release(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _list_differences(before: Any, after: Any, place: str) -> Iterator[str]:
    """Yield where two plain values differ: "problem.books: 3 in the stopped run, 4 now"."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted({*before, *after}):
            below = f"{place}.{key}" if place else key
            yield from _list_differences(before.get(key), after.get(key), below)
    elif before != after:
        yield f"{place}: {_shorten(before)} in the stopped run, {_shorten(after)} now"


def _shorten(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _compute_digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error
