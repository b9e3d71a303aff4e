"""Plan files that were tampered with: every command refuses them alike, and none ends in a bug."""

from __future__ import annotations

import io
import shutil
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from climbplan.bookshelf.plan_file import write_shelf_plan
from climbplan.bookshelf.runs import run_shelf
from climbplan.cli.app import run
from climbplan.cli.plan_kinds import plan_kind
from climbplan.climb.planner import plan_climb
from climbplan.errors import ClimbplanError, ExitCode
from climbplan.limms.plan_file import write_limms_plan
from climbplan.limms.planner import plan_limms
from climbplan.mpc.plan_file import write_walk_plan
from climbplan.mpc.planner import plan_walk
from climbplan.plans.climb_file import write_climb
from climbplan.spec.bookshelf_loading import load_shelf
from climbplan.spec.limms_loading import load_limms
from climbplan.spec.loading import load_climb
from climbplan.spec.mpc_loading import load_mpc

SPECS = Path(__file__).parents[2] / "specs"
Change = Callable[[h5py.File], None]
A_KIND = 8  # changes of the files of each kind; which, the names of datasets decide


def _bookshelf(path: Path) -> None:
    write_shelf_plan(run_shelf(load_shelf(SPECS / "bookshelf_scene.yaml")), path)


def _climb(path: Path) -> None:
    write_climb(plan_climb(load_climb(SPECS / "climb_tube.yaml")), path)


def _limms(path: Path) -> None:
    write_limms_plan(plan_limms(load_limms(SPECS / "limms_throw.yaml")), path)


def _walk(path: Path) -> None:
    write_walk_plan(plan_walk(load_mpc(SPECS / "mpc_forward.yaml", ["solver.method=nlp"])), path)


MAKERS = {"bookshelf": _bookshelf, "climb": _climb, "limms": _limms, "walk": _walk}


@pytest.fixture(scope="module", params=MAKERS)
def original(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of each kind."""
    path = tmp_path_factory.mktemp(request.param) / "plan.h5"
    MAKERS[request.param](path)
    assert plan_kind(path).verify(path).passed
    return path


def dataset_changes(name: str, values: Any) -> Iterator[Change]:
    """What a dataset can be replaced by."""

    def instead(new: Any) -> Change:
        def change(file: h5py.File) -> None:
            del file[name]
            file[name] = new

        return change

    def with_last(value: Any) -> Any:
        changed = values.copy()
        changed.reshape(-1)[-1:] = value
        return changed

    def huge(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, (10**8, 10**4), values.dtype, chunks=True)

    yield lambda file: file.__delitem__(name)
    yield instead(["text"])
    yield instead(values[:-1] if values.ndim else [1.0])
    yield instead(values[:0] if values.ndim else [1.0])
    if values.dtype.kind == "O":
        yield instead([b"\xff\xfe"] * max(len(values), 1))
        return
    yield huge
    yield instead(values[..., None])
    if values.dtype.kind == "f":
        for value in (np.nan, np.inf, 1e300, -1e40, 1e-300, -1.0):
            yield instead(with_last(value))
            yield instead(np.full_like(values, value))
    elif values.dtype.kind in "iu":
        for value in (-7, 99, 2**62):
            yield instead(with_last(value))
            yield instead(np.full_like(values, value))
    else:
        yield instead(~values)


def attribute_changes(holder: str, name: str) -> Iterator[Change]:
    """What an attribute can be replaced by."""
    values: tuple[Any, ...] = ("", "[]", "{}", '{"a": [null, "b"]}', "[[1]]", np.nan, 1e300, -1)
    for value in (*values, 2**62, np.array([1.0, 2.0]), h5py.Empty("f")):
        yield lambda file, value=value: file[holder].attrs.__setitem__(name, value)
    yield lambda file: file[holder].attrs.__delitem__(name)


def changes_of(path: Path) -> list[tuple[str, Change]]:
    """One change of every dataset and attribute, by its name."""
    found: list[tuple[str, Change]] = []

    def add(label: str, options: list[Change]) -> None:
        found.append((label, options[zlib.crc32(label.encode()) % len(options)]))

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        if isinstance(item, h5py.Dataset):
            add(name, list(dataset_changes(name, item[()])))
            return
        for attribute in item.attrs:
            add(f"{name}@{attribute}", list(attribute_changes(name, attribute)))

    with h5py.File(path) as file:
        file.visititems(visit)
        visit("/", file)
    return found


def outcome_of(path: Path) -> int:
    """What comes of a file: every reader of it ends alike, or goes through."""
    kind = plan_kind(path)
    verification = kind.verify(path)
    verification.require_sound(path)
    kind.report_dict(path)
    kind.export_csv(path, io.StringIO())
    kind.scene(path)
    return 0 if verification.passed else 5


def test_no_change_ends_in_a_bug(original: Path, tmp_path: Path) -> None:
    changes = sorted(changes_of(original), key=lambda c: zlib.crc32(c[0].encode()))
    codes = set()
    for _, change in changes[:A_KIND]:
        path = Path(shutil.copy(original, tmp_path / "plan.h5"))
        with h5py.File(path, "r+") as file:
            change(file)
        try:
            codes.add(outcome_of(path))
        except ClimbplanError as error:
            codes.add(int(error.exit_code))
    assert {2, 5} <= codes <= {0, 2, 5}


UNSOUND: dict[str, Change] = {
    "limms/mode": lambda file: file["limms/mode"].__setitem__((5, 0), 99),
    "limms/tip_anchor": lambda file: file["limms/tip_anchor"].__setitem__((5, 0), 99),
    "limms/link_lengths": lambda file: file["limms/link_lengths"].__setitem__(0, 0.1),
    "instants/force": lambda file: file["instants/force"].__setitem__((0, 0, 0), np.nan),
    "robot/link_lengths": lambda file: file["robot/link_lengths"].__setitem__((0, 0), -1.0),
    "time": lambda file: file["time"].__setitem__(3, 1e9),
    "scenes/theta": lambda file: file["scenes/theta"].__setitem__((0, 3), -1.0),
}


def test_every_command_refuses_what_is_unsound(
    original: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with h5py.File(original) as file:
        own = {name: change for name, change in UNSOUND.items() if name in file}
        own.pop("time" if "limms" in file else "", None)
    assert own
    for name, change in own.items():
        path = Path(shutil.copy(original, tmp_path / "plan.h5"))
        with h5py.File(path, "r+") as file:
            change(file)
        commands = [["verify"], ["report", "--json"], ["view", "--no-browser"], ["export", "-o-"]]
        if plan_kind(path).csv_name in ("trajectory.csv", "walk.csv"):
            commands.append(["simulate", "--no-pictures", f"-o{tmp_path / 'out'}"])
        for command, *options in commands:
            assert run([command, str(path), *options]) == ExitCode.UNVERIFIED, (name, command)
        assert "Traceback" not in capsys.readouterr().err
