"""Plan files that were tampered with: every command refuses them alike, and none ends in a bug."""

from __future__ import annotations

import hashlib
import io
import json
import re
import shutil
import time
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from plan_mutations import Change, one_change_each
from scenes import SCENES, PlannedScenes

from climbplan.api.kinds import identify_kind
from climbplan.cli.app import run
from climbplan.errors import ClimbplanError, ExitCode

A_KIND = 5  # changes of the files of each kind; which, the names of datasets decide


@pytest.fixture(scope="session", params=SCENES)
def original(request: pytest.FixtureRequest, planned_scenes: PlannedScenes) -> Path:
    """A plan of each kind."""
    return planned_scenes[request.param]


def outcome_of(path: Path) -> int:
    """What comes of a file: every reader of it ends alike, or goes through."""
    kind = identify_kind(path)
    verification = kind.verify(path)
    verification.require_sound(path)
    kind.build_report(path)
    kind.export_csv(path, io.StringIO())
    kind.read_scene(path)
    return 0 if verification.passed else 5


def test_no_change_ends_in_a_bug(original: Path, tmp_path: Path) -> None:
    changes = sorted(one_change_each(original), key=lambda c: zlib.crc32(c[0].encode()))
    codes = set()
    for _, change in changes[:A_KIND]:
        path = Path(shutil.copy(original, tmp_path / "plan.h5"))
        with h5py.File(path, "r+") as file:
            change(file)
        try:
            codes.add(outcome_of(path))
        except ClimbplanError as error:
            codes.add(int(error.exit_code))
    assert {2} <= codes <= {0, 2, 5}


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
        if identify_kind(path).csv_name in ("trajectory.csv", "walk.csv"):
            commands.append(["simulate", "--no-pictures", f"-o{tmp_path / 'out'}"])
        for command, *options in commands:
            assert run([command, str(path), *options]) == ExitCode.UNVERIFIED, (name, command)
        assert "Traceback" not in capsys.readouterr().err


def changed(original: Path, folder: Path, change: Change) -> str:
    path = Path(shutil.copy(original, folder / "plan.h5"))
    with h5py.File(path, "r+") as file:
        change(file)
    return str(path)


def with_spec(text: str) -> Change:
    """Another spec with its own fingerprint."""

    def change(file: h5py.File) -> None:
        file.attrs["spec"] = text
        file.attrs["spec_sha256"] = hashlib.sha256(text.encode()).hexdigest()

    return change


def spec_of(path: Path) -> str:
    with h5py.File(path) as file:
        return str(file.attrs["spec"])


@pytest.mark.slow
@pytest.mark.parametrize("keys", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_tables_that_lack_an_entry(original: Path, tmp_path: Path, keys: int) -> None:
    """Verification refuses what the page would need, and nothing else ends in a bug."""
    with h5py.File(original) as file:
        tables = {n: json.loads(file.attrs[n]) for n in ("timings", "sizes", "solvers")}
    for name, table in tables.items():
        for place, key in enumerate(list(table)[:keys]):
            for value in (None, 10**70) if keys == 1 else (None, [], 10**70):
                other = {k: v for k, v in table.items() if k != key}
                other |= {} if value is None else {key: value}
                text = json.dumps(other)
                path = changed(original, tmp_path, lambda f, n=name, t=text: f.attrs.update({n: t}))
                codes = {run(["verify", path]), run(["report", "--json", path])}
                assert codes in ({0}, {2}), (name, key, value)
                if keys > 1 and (value, codes, place, name) == (None, {0}, 0, "timings"):
                    assert run(["report", path, "-o", str(tmp_path / "page"), "--force"]) == 0
    for text in ("[1e400]", "[NaN]", "[-Infinity]", "[" * 500 + "]" * 500, '{"a": "\\ud800"}'):
        path = changed(original, tmp_path, lambda f, t=text: f.attrs.update({"sizes": t}))
        assert run(["verify", path]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("number", ["9" * 399, "0x" + "f" * 390])
def test_numbers_in_stored_specs(original: Path, tmp_path: Path, number: str) -> None:
    spec = spec_of(original)
    outside_comments = r"^[^#\n]*?: (?=[0-9])"
    places = [found.end() for found in re.finditer(outside_comments, spec, re.MULTILINE)]
    assert places
    for place in places[:2]:
        end = re.compile("[^0-9.e+-]|$").search(spec, place)
        assert end is not None
        text = spec[:place] + number + spec[end.start() :]
        path = changed(original, tmp_path, with_spec(text))
        assert run(["verify", path]) == ExitCode.UNVERIFIED
        assert run(["report", "--json", path]) in (0, ExitCode.USAGE)


def test_stored_specs_that_grow(original: Path, tmp_path: Path) -> None:
    """A few lines of merges that ask for millions of entries: at once, not after minutes."""
    keys = ", ".join(f"k{i}: 1" for i in range(6000))
    bomb = f"b: &b {{{keys}}}\na: {{<<: [{','.join(['*b'] * 6000)}]}}\n"
    path = changed(original, tmp_path, with_spec(f"{spec_of(original)}\n{bomb}"))
    start = time.process_time()
    assert run(["verify", path]) == ExitCode.UNVERIFIED
    assert time.process_time() - start < 10


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["nobody", "../../robot", "nobody.yaml", "[]"])
def test_stored_specs_of_other_robots(
    original: Path, tmp_path: Path, robot: str, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = spec_of(original)
    if "robot: " not in spec:
        assert "shelf" in spec
        return
    text = re.sub("robot: .*", f"robot: {robot}", spec)
    path = changed(original, tmp_path, with_spec(text))
    assert run(["verify", path]) in (0, ExitCode.UNVERIFIED)
    said = capsys.readouterr().out
    assert "robot" in said or "module" in said or "file.spec_values" in said
    assert run(["report", "--json", path]) in (0, ExitCode.USAGE)
