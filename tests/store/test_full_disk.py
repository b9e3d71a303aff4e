"""Where a disk is full, a run ends with a message and leaves nothing behind; HDF5 would crash."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from climbplan.cli.app import run
from climbplan.cli.output_directory import OutputDirectory
from climbplan.errors import UsageError
from climbplan.reports.report_files import write_files
from climbplan.store.csv_file import write_csv
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_writing import create_store, update_store, write_dataset

SIZE = 256  # [KiB] of the disk
ROWS = DatasetLayout(("n",))
TEXTS = DatasetLayout(("n",), kind="text")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk with room for a little."""
    place = tmp_path / "disk"
    place.mkdir()
    options = ["-t", "tmpfs", "-o", f"size={SIZE}k", "none", str(place)]
    mount, unmount = shutil.which("mount"), shutil.which("umount")
    if mount is None or unmount is None:
        pytest.skip("needs mount, to make a small disk")
    if subprocess.run([mount, *options], capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount, to make a small disk")
    try:
        yield place
    finally:
        subprocess.run([unmount, "--lazy", str(place)], check=True)


def _numbers(path: Path) -> None:
    with create_store(path) as file:
        write_dataset(file, "a", np.random.default_rng(0).random(10**5), ROWS)


def _compressed(path: Path) -> None:
    with create_store(path) as file:
        write_dataset(file, "a", np.random.default_rng(0).random(10**5), ROWS, compressed=True)


def _texts(path: Path) -> None:
    with create_store(path) as file:
        write_dataset(file, "t", ["x" * 1000] * 1000, TEXTS)


def _table(path: Path) -> None:
    write_csv(path, ("a", "b"), ((1 / 3, 2 / 3) for _ in range(10**5)))


def _report(path: Path) -> None:
    write_files(path.parent, {"a": 1}, "x" * 10**6, {"b": b"x" * 1000})


def _figures(path: Path) -> None:
    write_files(path.parent, {"a": 1}, "x", {"b": b"x" * 10**6})


WRITERS: dict[str, Callable[[Path], None]] = {
    "numbers": _numbers,
    "compressed numbers": _compressed,
    "texts": _texts,
    "table": _table,
    "page": _report,
    "figures": _figures,
}


@pytest.mark.parametrize("name", WRITERS)
def test_files(disk: Path, name: str) -> None:
    older = b"what was there before"
    path = disk / "plan.h5"
    path.write_bytes(older)
    with pytest.raises(UsageError, match="cannot be written: No space left on device"):
        WRITERS[name](path)
    assert path.read_bytes() == older
    assert not [entry for entry in disk.iterdir() if entry.name.startswith(".")]


def test_marks_of_verification(disk: Path) -> None:
    """A plan that just fits is changed, or stays what it was."""
    path = disk / "plan.h5"
    with create_store(path) as file:
        write_dataset(file, "a", np.random.default_rng(0).random(20_000), ROWS)
        file.attrs["verified"] = False
    before = path.read_bytes()
    with (
        pytest.raises(UsageError, match=r"plan.h5: cannot be written: No space left"),
        update_store(path) as file,
    ):
        file.attrs["verified"] = True
    assert path.read_bytes() == before
    assert [entry.name for entry in disk.iterdir()] == ["plan.h5"]


@pytest.mark.parametrize("name", WRITERS)
def test_output_directories_name_the_target(disk: Path, name: str) -> None:
    target = disk / "outputs" / "climb"
    with (
        pytest.raises(UsageError, match=f"^{target}: cannot be written: No space left on device$"),
        OutputDirectory(target) as directory,
    ):
        WRITERS[name](directory.path / "plan.h5")
    assert not list(disk.iterdir())


def test_a_file_as_large_as_allowed(tmp_path: Path) -> None:
    """`ulimit -f`, which ends in another error than a full disk."""
    program = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n"
        "import numpy as np\n"
        "from pathlib import Path\n"
        "from climbplan.cli.output_directory import OutputDirectory\n"
        "from climbplan.store.hdf5_layout import DatasetLayout\n"
        "from climbplan.store.hdf5_writing import create_store, write_dataset\n"
        "with OutputDirectory(Path('out')) as directory:\n"
        "    with create_store(directory.path / 'plan.h5') as file:\n"
        "        write_dataset(file, 'a', np.arange(1e5), DatasetLayout(('n',)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1  # a Python exception, not a signal
    assert "UsageError: out: cannot be written: File too large" in done.stderr
    assert not list(tmp_path.iterdir())


def test_commands(disk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A dataset of problems, its marks and its table; what fits is left alone."""
    whole = tmp_path / "whole"
    spec = ["gen-data", str(Path(__file__).parents[2] / "specs" / "dataset_bookshelf.yaml")]
    options = ["--set", "count=3", "-q"]
    assert run([*spec, *options, "-o", str(whole)]) == 0
    assert (whole / "dataset.h5").is_file()
    (disk / "filler").write_bytes(b"x" * (SIZE - 24) * 1024)
    for command in (
        [*spec, *options, "-o", str(disk / "out")],
        ["export", str(whole), "-o", str(disk / "out" / "table.csv")],
        ["report", str(whole), "-o", str(disk / "out")],
        ["new", "climb", str(disk / "out")],
    ):
        shutil.rmtree(disk / "out", ignore_errors=True)
        if command[0] == "export":
            (disk / "out").mkdir()
        with (disk / "rest").open("wb") as rest:
            while os.statvfs(disk).f_bavail > 0:
                rest.write(b"x" * 4096)
                rest.flush()
        code = run(command)
        said = capsys.readouterr().err
        assert code == 2, (command, said)
        assert "cannot be written: No space left" in said or "cannot be created" in said
        left = [path for path in disk.rglob("*") if path.name not in ("filler", "rest", "out")]
        assert not left, command
        (disk / "rest").unlink()


@pytest.mark.parametrize("command", ["verify", "report --json"])
def test_a_plan_on_a_full_disk_is_read(
    disk: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reading writes nothing."""
    path = disk / "plan.h5"
    with create_store(path) as file:
        file.attrs["format"] = "climbplan/none"
    (disk / "filler").write_bytes(b"x" * (os.statvfs(disk).f_bavail * 4096))
    first, *options = command.split()
    assert run([first, str(path), *options]) == 2
    assert "holds 'climbplan/none', expected one of" in capsys.readouterr().err
    with h5py.File(path) as file:
        assert file.attrs["format"] == "climbplan/none"
