"""An output directory that appears whole or not at all.

Everything is written into a hidden sibling, `.<name>.<pid>.tmp`, synced to disk and renamed. A
process killed at any moment leaves the old directory, the new one, or none, never a half-written
one; siblings that a killed process left behind are removed by the next run.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import re
import shutil
import sys
from pathlib import Path
from types import TracebackType
from typing import Self

from climbplan.cli.supervision import remove_if_killed
from climbplan.errors import UsageError

# One of these marks a finished directory.
RESULTS = (
    "plan.h5",
    "dataset.h5",
    "envelopes.h5",
    "model.h5",
    "bench.json",
    "stiffness.csv",
    "simulation.csv",
    "gripper.json",
    "export.json",
    "regulator.npz",
    "instances.csv",
)
PARTIAL_PLAN = "partial.h5"  # of a run that planned part of the way
_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
_ENVIRONMENT = (
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG,
    errno.ENAMETOOLONG, errno.ENOTDIR, errno.EEXIST, errno.ENOTEMPTY, errno.EBUSY,
)  # fmt: skip


class OutputDirectory:
    """Context that collects a run's files in `path` until `publish` puts them at `target`.

    Leaving the context without `publish` removes everything that it created.

    Raises:
        UsageError: on entry if `target` is taken or cannot be written; later if the disk fails.
    """

    def __init__(self, target: Path, force: bool = False) -> None:
        self.target = target
        self.force = force
        self._final = Path(os.path.realpath(target))  # unlike resolve(), takes a loop of links
        self.path = self._sibling("tmp")
        self._created_parents: list[Path] = []
        self._lock: int | None = None

    def __enter__(self) -> Self:
        try:
            self._refuse_taken_target()
            self._make_parents()
            try:
                self._remove_stale_siblings()
                self._make_path()
            except BaseException:
                self._remove_created_parents()
                raise
        except OSError as error:
            raise self._cannot_write(error) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None
        shutil.rmtree(self.path, ignore_errors=True)
        self._remove_created_parents()
        # Files that are written aside say their own place, which is gone by now
        cause = error.__cause__ if isinstance(error, UsageError) else error
        if isinstance(cause, OSError) and cause.errno in _ENVIRONMENT and self._is_own(error):
            raise self._cannot_write(cause) from error

    def _is_own(self, error: BaseException | None) -> bool:
        return not isinstance(error, UsageError) or str(self.path) in str(error)

    def publish(self) -> None:
        """Sync all files to disk and put them at `target` in one step."""
        try:
            _sync_tree(self.path)
            if self._final.exists() and (self.force or self._holds_partial_plan_alone()):
                self._replace_existing()
            else:
                self.path.rename(self._final)
            _sync(self._final.parent)
        except OSError as error:
            raise self._cannot_write(error) from error

    def publish_beside(self, name: str) -> Path:
        """Put one file of a failed run at `target`, beside what is there; return its path."""
        try:
            _sync(self.path / name)
            self._final.mkdir(exist_ok=True)
            (self.path / name).replace(self._final / name)
            _sync(self._final)
        except OSError as error:
            raise self._cannot_write(error) from error
        return self.target / name

    def _holds_partial_plan_alone(self) -> bool:
        return [entry.name for entry in self._final.iterdir()] == [PARTIAL_PLAN]

    def _replace_existing(self) -> None:
        if exchange(self.path, self._final):
            return  # the old directory now stands at `path` and goes with it
        temporary = self._sibling("old")
        self._final.rename(temporary)
        self.path.rename(self._final)
        shutil.rmtree(temporary)

    def _refuse_taken_target(self) -> None:
        final = self._final
        if final == Path.cwd() or final in Path.cwd().parents:
            raise UsageError(f"{self.target}: is the current directory or above it, name another")
        # Resolved as far as it goes, and still a link
        if any(path.is_symlink() for path in (final, *final.parents)):
            raise UsageError(f"{self.target}: cannot be written: a link that leads to itself")
        if not final.exists():
            return
        if not final.is_dir():
            raise UsageError(f"{self.target}: is a file, expected a directory")
        if not any(final.iterdir()) or self._holds_partial_plan_alone():
            return
        finished = any((final / name).exists() for name in RESULTS)
        if not finished:
            raise UsageError(
                f"{self.target}: holds other files and no plan, so it is not replaced; "
                "name another with --out"
            )
        if not self.force:
            raise UsageError(f"{self.target}: already exists; --force replaces it")

    def _make_parents(self) -> None:
        missing = [self._final.parent, *self._final.parent.parents]
        for parent in reversed([p for p in missing if not p.exists()]):
            remove_if_killed(parent, whole=False)
            parent.mkdir(exist_ok=True)
            self._created_parents.append(parent)

    def _make_path(self) -> None:
        remove_if_killed(self.path)
        try:
            self.path.mkdir()
        except FileExistsError:
            # Same number, other process space (containers): not stale, or it would be gone.
            raise UsageError(f"{self.target}: another run is writing it") from None
        self._lock = os.open(self.path, os.O_RDONLY)
        _try_lock(self._lock)

    def _remove_stale_siblings(self) -> None:
        pattern = re.compile(rf"\.{re.escape(self._final.name)}\.(\d+)\.(tmp|old)")
        for entry in self._final.parent.iterdir():
            match = pattern.fullmatch(entry.name)
            if match is None or not _is_abandoned(entry, int(match[1])):
                continue
            if match[2] == "old" and not self._final.exists():
                entry.rename(self._final)  # its run was killed between two renames
                self._refuse_taken_target()
            else:
                shutil.rmtree(entry, ignore_errors=True)

    def _remove_created_parents(self) -> None:
        for parent in reversed(self._created_parents):
            try:
                parent.rmdir()
            except OSError:
                return  # in use by now, and so are those above it

    def _sibling(self, ending: str) -> Path:
        return self._final.parent / f".{self._final.name}.{os.getpid()}.{ending}"

    def _cannot_write(self, error: OSError) -> UsageError:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY):
            return UsageError(
                f"{self.target}: another run has written it meanwhile; name another with --out"
            )
        return UsageError(f"{self.target}: cannot be written: {error.strerror or error}")


def exchange(first: Path, second: Path) -> bool:
    """Swap two paths in one step; False where kernel or file system cannot."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:
        return False
    failed = renameat2(
        _AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE
    )
    if not failed:
        return True
    code = ctypes.get_errno()
    if code in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EPERM):
        return False
    raise OSError(code, os.strerror(code), str(second))


def _is_abandoned(entry: Path, pid: int) -> bool:
    """Return whether the process that wrote `entry` is gone and nobody holds its lock."""
    if pid != os.getpid() and _is_running(pid):  # its own is not made yet: a namesake's leftover
        return False
    try:
        descriptor = os.open(entry, os.O_RDONLY)
    except OSError:
        return False
    try:
        return _try_lock(descriptor)
    finally:
        os.close(descriptor)


def _is_running(pid: int) -> bool:
    """Return whether a process runs; zombies that nobody has reaped do not count.

    Containers often have such zombies, as their first process may reap none.
    """
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    try:
        state = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0]
    except (OSError, IndexError):
        return True
    return state not in (b"Z", b"X")


def _try_lock(descriptor: int) -> bool:
    """Lock a directory; True also where the file system knows no locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _sync_tree(directory: Path) -> None:
    for root, _, names in os.walk(directory):
        for name in names:
            _sync(Path(root, name))
        _sync(Path(root))


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # no sync on this file system
            raise
    finally:
        os.close(descriptor)
