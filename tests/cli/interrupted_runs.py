"""Commands that are stopped while a solver runs, and how long they then take to end.

Moments are counted in processor time that a run has used since its output directory was begun, not
by the clock, so that a busy machine stops a run at the same place of its work. The time to the end
is the clock's less what the run waited for a core, which Linux counts for each thread: on a quiet
machine the two are the same, and on one that others use the bound of two seconds stays what a user
alone would see. A bound in processor time would not do: whoever sleeps until a worker ends uses
none.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

TICK = os.sysconf("SC_CLK_TCK")
_LOOK = 0.01  # [s] between looks at a run
_PATIENCE = 300.0  # [s] for a run to come to its moment
_KILLED = 40.0  # [s] after the signal


@dataclass(frozen=True)
class Ending:
    """How a run ended that was told to."""

    code: int
    seconds: float  # from the signal to the end, waits for a core taken off
    clock: float  # [s] with them
    used: float  # [s] of processor time since the output directory was begun, at the signal
    early: bool  # it had ended before the signal: the moment says nothing
    left: tuple[str, ...]  # files and folders that were not there before
    survivors: tuple[int, ...]  # processes below it that outlived it by a second
    told: str  # standard error


def stop_run(
    arguments: list[str], folder: Path, after: float, number: signal.Signals, root: Path
) -> Ending:
    """Start a command in `folder`, send the signal after so much of its work, and wait.

    after: [s] of processor time of the run and all below it, counted from when its output
    directory is begun, or from the start if it has none. root: folder of the package to run.
    """
    before = {p.name for p in folder.iterdir()}
    run = subprocess.Popen(
        [sys.executable, "-m", "climbplan", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(root)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # the test's own Ctrl-C is not its
        # Shells start what runs in the background deaf to Ctrl-C, and children inherit it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    limit = time.monotonic() + _PATIENCE
    begun: float | None = None
    used = 0.0
    while run.poll() is None and time.monotonic() < limit:
        family = _family(run.pid)
        if begun is None and "-o" not in arguments:
            begun = 0.0
        if begun is None and any(p.name not in before for p in folder.iterdir()):
            begun = sum(map(_used, family))
        if begun is not None:
            used = sum(map(_used, family)) - begun
            if used >= after:
                break
        time.sleep(_LOOK)
    early = run.poll() is not None
    family = _family(run.pid)
    waited_before = {pid: waited_for_core(pid) for pid in family}
    waited: dict[int, float] = {}
    start = time.monotonic()
    run.send_signal(number)
    while run.poll() is None and time.monotonic() < start + _KILLED:
        for pid, known in waited_before.items():
            waited[pid] = max(waited.get(pid, 0.0), waited_for_core(pid) - known)
        time.sleep(_LOOK)
    clock = time.monotonic() - start
    if run.poll() is None:
        run.kill()
    _, told = run.communicate()
    # Of several processes the one that waited longest held up the end
    lost = max(waited.values(), default=0.0)
    end = time.monotonic() + max(1.0, lost)
    survivors = tuple(pid for pid in family if _alive(pid))
    while survivors and time.monotonic() < end:
        time.sleep(_LOOK)
        survivors = tuple(pid for pid in survivors if _alive(pid))
    for pid in survivors:
        os.kill(pid, signal.SIGKILL)
    left = tuple(sorted(p.name for p in folder.iterdir() if p.name not in before))
    return Ending(run.returncode, max(clock - lost, 0.0), clock, used, early, left, survivors, told)


def _family(pid: int) -> list[int]:
    """A process and all below it."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and (fields := _stat(int(entry.name))):
            parents.setdefault(int(fields[1]), []).append(int(entry.name))
    found, new = [pid], [pid]
    while new:
        new = [child for parent in new for child in parents.get(parent, [])]
        found += new
    return found


def _stat(pid: int) -> list[str]:
    """What Linux says of a process, from its state on; nothing of one that is gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def _used(pid: int) -> float:
    """Processor time [s] of all its threads and of its children that have ended."""
    fields = _stat(pid)
    return sum(map(int, fields[11:15])) / TICK if fields else 0.0


def waited_for_core(pid: int) -> float:
    """Seconds that its main thread was ready and had no core."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError):
        return 0.0


def _alive(pid: int) -> bool:
    fields = _stat(pid)
    return bool(fields) and fields[0] != "Z"
