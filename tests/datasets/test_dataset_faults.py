"""Runs that are killed, lose workers or their disk: after --resume the rows are undisturbed."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from climbplan.store.dataset_file import read_dataset_file

pytest.importorskip("pymunk")
pytestmark = pytest.mark.slow

COUNT = 240
SPEC = f"""
kind: dataset
count: {COUNT}
seed: 9
shard_size: 10
problem: {{kind: bookshelf, books: 2}}
"""


def command(*arguments: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "climbplan",
        "gen-data",
        "faults.yaml",
        "--out",
        "out",
        *arguments,
    ]


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """A run in a session of its own, so that the test's Ctrl-C is not its."""
    root = str(Path(__file__).parents[2])
    path = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        command(*arguments),
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(folder: Path, *arguments: str) -> str:
    """A run to its end; its standard error."""
    run = start(folder, *arguments)
    out, err = run.communicate(timeout=300)
    assert run.returncode == 0, err
    assert out == "out/dataset.h5\n"
    assert not (folder / ".out.rows").exists()
    return err


def workers_of(run: subprocess.Popen[str]) -> list[int]:
    """Processes below a run that make rows."""
    found = []
    # The process that was started watches over the one that gives rows to workers
    below = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            status = (entry / "stat").read_text().rpartition(")")[2].split()
            line = (entry / "cmdline").read_text()
        except OSError:
            continue
        # loky's resource tracker is a child too, and makes no rows
        if status[1] in below and "loky" in line and "resource_tracker" not in line:
            found.append(int(entry.name))
    return found


def wait_for(what: object, seconds: float = 60.0) -> None:
    """Until a function says so."""
    assert callable(what)
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "faults.yaml").write_text(SPEC)
    finish(folder, "--jobs", "2")
    return folder / "out" / "dataset.h5"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "faults.yaml").write_text(SPEC)
    return tmp_path


def assert_undisturbed(folder: Path, undisturbed: Path) -> None:
    """The same rows, times excluded."""
    found = read_dataset_file(folder / "out" / "dataset.h5")
    wanted = read_dataset_file(undisturbed)
    np.testing.assert_array_equal(found.parameters, wanted.parameters)
    np.testing.assert_array_equal(found.seed, wanted.seed)
    np.testing.assert_array_equal(found.integers, wanted.integers)
    np.testing.assert_allclose(found.objective, wanted.objective, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.solution["pose"], wanted.solution["pose"], atol=1e-9)
    assert found.status == wanted.status
    assert found.message == wanted.message


def some_shards(folder: Path, least: int = 1) -> bool:
    return len(list((folder / ".out.rows").glob("*.shard"))) >= least


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_a_run_that_is_asked_to_stop_says_how_to_go_on(
    folder: Path, undisturbed: Path, kind: signal.Signals
) -> None:
    run = start(folder, "--jobs", "1")
    wait_for(lambda: some_shards(folder) or run.poll() is not None)
    run.send_signal(kind)
    _, err = run.communicate(timeout=60)
    assert run.returncode == (130 if kind == signal.SIGINT else 143)
    assert "rows are kept, --resume goes on with them" in err
    assert {p.name for p in folder.iterdir()} == {"faults.yaml", ".out.rows"}
    err = finish(folder, "--jobs", "2", "--resume")
    assert "going on: " in err
    assert_undisturbed(folder, undisturbed)


@pytest.mark.parametrize("moment", np.random.default_rng(5).uniform(0.3, 1.0, 10).round(3))
def test_kill_at_a_random_moment(folder: Path, undisturbed: Path, moment: float) -> None:
    """Ten moments between the first rows and the end, by how many shards there are."""
    run = start(folder, "--jobs", "2")
    wanted = max(1, int(moment * COUNT / 10))
    wait_for(lambda: some_shards(folder, wanted) or run.poll() is not None)
    time.sleep(0.05 * moment)
    run.kill()
    run.communicate()  # until its orphaned workers have ended too
    if (folder / "out").exists():  # it was through already
        assert_undisturbed(folder, undisturbed)
        return
    assert (folder / ".out.rows").exists()
    finish(folder, "--resume")
    assert {p.name for p in folder.iterdir()} == {"faults.yaml", "out"}
    assert_undisturbed(folder, undisturbed)


def test_workers_of_a_killed_run_end(folder: Path) -> None:
    run = start(folder, "--jobs", "2")
    wait_for(lambda: some_shards(folder) or run.poll() is not None)
    workers = workers_of(run)
    assert len(workers) == 2
    run.kill()
    run.communicate()  # until its orphaned workers have ended too
    wait_for(lambda: not any(Path("/proc", str(pid)).exists() for pid in workers), 20.0)


def test_a_killed_worker_is_replaced(folder: Path, undisturbed: Path) -> None:
    run = start(folder, "--jobs", "2")
    wait_for(lambda: some_shards(folder) or run.poll() is not None)
    killed = workers_of(run)[0]
    os.kill(killed, signal.SIGKILL)
    _, err = run.communicate(timeout=120)
    assert run.returncode == 0, err
    assert_undisturbed(folder, undisturbed)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 160 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("only root mounts a small file system")
    options = ["-t", "tmpfs", "-o", "size=160k", "tmpfs", str(place)]
    if subprocess.run([mount, *options], capture_output=True, check=False).returncode:
        pytest.skip("a small file system cannot be mounted here")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_full_disk(small_disk: Path, undisturbed: Path) -> None:
    (small_disk / "faults.yaml").write_text(SPEC)
    run = start(small_disk, "--jobs", "2")
    _, err = run.communicate(timeout=120)
    assert run.returncode == 2
    assert "No space left on device" in err
    assert "rows are kept, --resume goes on with them" in err
    assert not (small_disk / "out").exists()
    assert not list(small_disk.rglob("*.part"))
    subprocess.run(["mount", "-o", "remount,size=32m", str(small_disk)], check=True)
    finish(small_disk, "--resume")
    assert_undisturbed(small_disk, undisturbed)


def test_dask_makes_the_same_rows(folder: Path, undisturbed: Path) -> None:
    pytest.importorskip("distributed")
    finish(folder, "--scheduler", "local-cluster:2")
    assert_undisturbed(folder, undisturbed)


def is_at_row(pid: int) -> bool:
    """Whether a worker runs Bonmin for a row, in a process of its own."""
    lists = Path(f"/proc/{pid}/task").glob("*/children")
    children = [child for path in lists for child in path.read_text().split()]
    return any("bonmin" in Path(f"/proc/{child}/cmdline").read_text() for child in children)


@contextmanager
def running_cluster(
    folder: Path, port: int
) -> Iterator[tuple[str, subprocess.Popen[bytes], list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers: its address, and their processes."""
    root = str(Path(__file__).parents[2])
    env = {**os.environ, "PYTHONPATH": root}
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    scheduler = subprocess.Popen(
        [*dask, "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"],
        env=env, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    worker = [
        sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1",
        "--no-dashboard", "--no-nanny",
    ]  # fmt: skip
    workers = [
        subprocess.Popen(
            worker, env=env, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        for _ in range(2)
    ]
    try:
        yield address, scheduler, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def test_a_lost_dask_worker_changes_no_row(folder: Path, undisturbed: Path) -> None:
    """A cluster that runs already: one of its workers is killed, and comes back as another."""
    pytest.importorskip("distributed")
    with running_cluster(folder, 18786) as (address, _, workers):
        run = start(folder, "--scheduler", address)
        wait_for(lambda: some_shards(folder, 3) or run.poll() is not None, 120.0)
        workers[0].kill()
        _, err = run.communicate(timeout=240)
        assert run.returncode == 0, err
    assert_undisturbed(folder, undisturbed)


def test_dask_workers_end_with_a_killed_scheduler(folder: Path) -> None:
    """Rows that take minutes keep no worker, and the run says what was lost."""
    pytest.importorskip("distributed")
    (folder / "faults.yaml").write_text(
        SPEC.replace("books: 2", "books: 2, solver: {method: minlp-bonmin, time_limit: 600}")
    )
    with running_cluster(folder, 18787) as (address, scheduler, workers):
        run = start(folder, "--scheduler", address)
        wait_for(lambda: all(is_at_row(worker.pid) for worker in workers), 120.0)
        scheduler.kill()
        killed = time.monotonic()
        wait_for(lambda: all(worker.poll() is not None for worker in workers), 5.0)
        assert time.monotonic() - killed <= 5.0
        _, err = run.communicate(timeout=60)
        assert run.returncode == 2
        assert "the scheduler is gone" in err
