"""Plan files: layout to the letter, exact round trip, and clear words about anything else."""

from __future__ import annotations

import hashlib
import json
import os
import random
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from example_climb import Climb

from climbplan.climb.plan.climb_plan import ClimbPlan, Study
from climbplan.climb.plan.file import read_climb, write_climb
from climbplan.errors import PlanFileError, UsageError

N, M = 6, 2
K = 2 * N * M


def assert_same(a: Any, b: Any, where: str = "plan") -> None:
    """Equality to the last bit, through dataclasses, tuples and arrays."""
    assert type(a) is type(b), where
    if is_dataclass(a):
        for field in fields(a):
            mine, theirs = getattr(a, field.name), getattr(b, field.name)
            assert_same(mine, theirs, f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype, where
        assert a.shape == b.shape, where
        assert np.array_equal(a, b), where
    elif isinstance(a, tuple):
        assert len(a) == len(b), where
        for index, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_same(x, y, f"{where}[{index}]")
    else:
        assert a == b, where


def test_a_plan_comes_back_exactly(climb: Climb, original: Path) -> None:
    assert_same(climb.plan, read_climb(original))


def test_optional_parts_come_back_exactly(climb: Climb, tmp_path: Path) -> None:
    study = Study(
        keys=("terrain.friction", "terrain.walls.angle_deg"),
        values=(np.array([0.3, 0.6]), np.array([0.0, 10.0, 20.0])),
        label=np.array([[0, 1, 2], [0, 0, 1]]),
        detail=("", "Reibung an RF: µ zu klein", "b", "", "", "c"),
    )
    forces = replace(climb.plan.forces, safety_friction=np.full(K, np.inf))
    plan = replace(
        climb.plan, study=study, bound=None, gap=None, verified=True, warnings=(), forces=forces
    )
    write_climb(plan, tmp_path / "p.h5")
    assert_same(plan, read_climb(tmp_path / "p.h5"))
    one_key = replace(study, keys=study.keys[:1], values=study.values[:1], label=study.label[:, :1])
    one_key = replace(one_key, detail=("", "no"))
    write_climb(replace(plan, study=one_key), tmp_path / "p.h5")
    assert_same(one_key, read_climb(tmp_path / "p.h5").study)


def test_a_tube_comes_back_exactly(climb: Climb, tmp_path: Path) -> None:
    from climbplan.terrain.model import Terrain
    from climbplan.terrain.surfaces import Tube

    tube = Tube("tube", np.array([0.1, -0.2]), 0.66, -1.0, 2.0, 0.9)
    plan = replace(
        climb.plan,
        terrain=Terrain((tube,), np.ones((N, 1), bool), (), ()),
        rounds=replace(climb.plan.rounds, region=np.zeros((M + 1, N), np.int64)),
        instants=replace(climb.plan.instants, region=np.zeros((K, N), np.int64)),
    )
    write_climb(plan, tmp_path / "p.h5")
    assert_same(plan, read_climb(tmp_path / "p.h5"))


def test_a_very_long_spec_fits(climb: Climb, tmp_path: Path) -> None:
    text = climb.plan.spec_text + "# größer\n" * 400_000
    write_climb(replace(climb.plan, spec_text=text), tmp_path / "p.h5")
    assert read_climb(tmp_path / "p.h5").spec_text == text


def test_time_and_version_are_filled_in(climb: Climb, tmp_path: Path) -> None:
    write_climb(replace(climb.plan, created="", climbplan_version=""), tmp_path / "p.h5")
    plan = read_climb(tmp_path / "p.h5")
    assert plan.created.endswith("+00:00")
    assert plan.climbplan_version


# Names, shapes and units that other tools rely on
LAYOUT = {
    "robot/shoulder_body": ((N, 3), "m"),
    "robot/link_lengths": ((N, 3), "m"),
    "robot/mount_yaw": ((N,), "rad"),
    "robot/max_torque": ((N, 3), "N m"),
    "robot/joint_stiffness": ((N, 3), "N m/rad"),
    "robot/limb_names": ((N,), ""),
    "rounds/com": ((M + 1, 3), "m"),
    "rounds/rpy": ((M + 1, 3), "rad"),
    "rounds/toes": ((M + 1, N, 3), "m"),
    "rounds/region": ((M + 1, N), ""),
    "instants/round": ((K,), ""),
    "instants/lifted": ((K, N), ""),
    "instants/contact": ((K, N), ""),
    "instants/com": ((K, 3), "m"),
    "instants/rpy": ((K, 3), "rad"),
    "instants/toes": ((K, N, 3), "m"),
    "instants/normal": ((K, N, 3), ""),
    "instants/force": ((K, N, 3), "N"),
    "instants/mu": ((K, N), ""),
    "instants/joint_angles": ((K, N, 3), "rad"),
    "instants/joint_torques": ((K, N, 3), "N m"),
    "instants/joint_command": ((K, N, 3), "rad"),
    "instants/toe_command": ((K, N, 3), "m"),
    "instants/wall_deflection": ((K, N, 3), "m"),
    "instants/com_deflection": ((K, 6), "m, rad"),
    "instants/safety_torque": ((K,), ""),
    "instants/safety_friction": ((K,), ""),
    "instants/mu_critical": ((K, N), ""),
    "instants/external_wrench": ((K, 6), "N, N m"),
    "trajectory/time": (("T",), "s"),
    "trajectory/com": (("T", 3), "m"),
    "trajectory/rpy": (("T", 3), "rad"),
    "trajectory/joint_command": (("T", N, 3), "rad"),
    "trajectory/contact": (("T", N), ""),
}
WORLD = ("rounds/com", "rounds/toes", "instants/force", "instants/com_deflection", "trajectory/com")


def test_layout_is_the_published_one(climb: Climb, original: Path) -> None:
    samples = len(climb.plan.trajectory.time)
    with h5py.File(original) as file:
        for name, (shape, units) in LAYOUT.items():
            wanted = tuple(samples if size == "T" else size for size in shape)
            assert file[name].shape == wanted, name
            assert file[name].attrs["units"] == units, name
        for name in WORLD:
            assert file[name].attrs["frame"] == "world"
        assert file["robot/shoulder_body"].attrs["frame"] == "body"
        for name in ("instants/lifted", "instants/contact", "trajectory/contact"):
            assert file[name].dtype == np.bool_
        assert set(file["robot"].attrs) >= {
            "name",
            "mass",
            "gravity",
            "structural_compliance_share",
        }
        root = dict(file.attrs)
    assert root["format"] == "climbplan/climb"
    assert root["format_version"] == 1
    assert root["spec_sha256"] == hashlib.sha256(root["spec"].encode()).hexdigest()
    assert root["status"] == "feasible"
    assert not root["verified"]
    assert root["seed"] == 0
    assert root["bound"] <= root["objective"]
    assert root["gap"] == pytest.approx(0.1)
    assert json.loads(root["timings"]) == {"posture": 0.25, "force": 0.125}
    assert json.loads(root["solvers"]) == {"posture": "none", "force": "HiGHS"}


def test_every_dataset_states_its_units_and_nothing_holds_objects(original: Path) -> None:
    def look(name: str, item: h5py.HLObject) -> None:
        if isinstance(item, h5py.Dataset):
            assert "units" in item.attrs, name
            assert item.dtype.kind in "fib" or h5py.check_string_dtype(item.dtype), name
            assert h5py.check_ref_dtype(item.dtype) is None

    with h5py.File(original) as file:
        file.visititems(look)


def test_writing_replaces_whole_files_and_leaves_nothing_behind(
    climb: Climb, tmp_path: Path
) -> None:
    path = tmp_path / "plan.h5"
    path.write_text("old")
    with pytest.raises(AttributeError):
        write_climb(replace(climb.plan, terrain=None), path)  # type: ignore[arg-type]
    assert path.read_text() == "old"
    write_climb(climb.plan, path)
    assert os.listdir(tmp_path) == ["plan.h5"]
    with pytest.raises(UsageError, match="a directory"):
        write_climb(climb.plan, tmp_path)
    with pytest.raises(UsageError, match="cannot be written"):
        write_climb(climb.plan, tmp_path / "nowhere" / "plan.h5")


# Files that are not plans


def _missing(path: Path) -> Path:
    return path / "nothing.h5"


def _directory(path: Path) -> Path:
    return path


def _text(path: Path) -> Path:
    (path / "a.h5").write_text("kind: climb\n")
    return path / "a.h5"


def _empty(path: Path) -> Path:
    (path / "a.h5").touch()
    return path / "a.h5"


def _other_hdf5(path: Path) -> Path:
    with h5py.File(path / "a.h5", "w") as file:
        file["x"] = [1.0]
    return path / "a.h5"


def _other_kind(path: Path) -> Path:
    with h5py.File(path / "a.h5", "w") as file:
        file.attrs["format"] = "climbplan/bookshelf"
    return path / "a.h5"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (_missing, "no such file"),
        (_directory, "a directory, expected a plan file"),
        (_text, "not an HDF5 file"),
        (_empty, "empty, expected a plan file"),
        (_other_hdf5, "not a climbplan file"),
        (_other_kind, "holds 'climbplan/bookshelf', expected 'climbplan/climb'"),
    ],
)
def test_other_things_are_refused(
    make: Callable[[Path], Path], message: str, tmp_path: Path
) -> None:
    with pytest.raises(PlanFileError, match=message):
        read_climb(make(tmp_path))


def _replace(name: str, value: Any, **options: Any) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, data=value, **options)

    return change


def _delete(name: str) -> Callable[[h5py.File], None]:
    return lambda file: file.__delitem__(name)


def _attribute(name: str, value: Any, group: str = "/") -> Callable[[h5py.File], None]:
    return lambda file: file[group].attrs.__setitem__(name, value)


def _put(name: str, index: Any, value: Any) -> Callable[[h5py.File], None]:
    return lambda file: file[name].__setitem__(index, value)


def _claim(file: h5py.File) -> None:
    del file["trajectory/time"]
    file.create_dataset("trajectory/time", (10**12,), "f8", chunks=(1024,))


def _link_elsewhere(file: h5py.File) -> None:
    del file["instants/com"]
    file["instants/com"] = h5py.ExternalLink("other.h5", "/secret")


def _raw_file(file: h5py.File) -> None:
    shape = file["instants/com"].shape
    del file["instants/com"]
    external = [("secret.bin", 0, 8 * int(np.prod(shape)))]
    file.create_dataset("instants/com", shape, "f8", external=external)


def _virtual(file: h5py.File) -> None:
    shape = file["instants/com"].shape
    del file["instants/com"]
    layout = h5py.VirtualLayout(shape=shape, dtype="f8")
    layout[...] = h5py.VirtualSource("other.h5", "data", shape=shape)
    file.create_virtual_dataset("instants/com", layout)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_attribute("format_version", 2), "format version 2, expected 1; a newer climbplan"),
        (_attribute("format_version", 0), "format version 0, expected 1"),
        (_attribute("format_version", "1"), "format_version is not an integer"),
        (_attribute("format", 3), "format is not text"),
        (_attribute("status", "splendid"), "status 'splendid', expected one of optimal"),
        (_attribute("timings", "{"), "timings is not JSON"),
        (_attribute("timings", "[1]"), "timings is not a JSON object"),
        (_attribute("verified", 3), "verified is not a boolean"),
        (_attribute("mass", "heavy", "robot"), "robot/mass is not a number"),
        (_attribute("mass", np.nan, "robot"), "NaN or infinity in robot/mass"),
        (_attribute("mass", [1.0, 2.0], "robot"), "robot/mass is not a single value"),
        (lambda file: file.attrs.__delitem__("seed"), "attribute seed is missing"),
        (_delete("instants/force"), r"instants/force is missing \(expected a dataset\)"),
        (_delete("robot"), r"robot is missing \(expected a group\)"),
        (_delete("limits"), "limits is missing"),
        (_delete("terrain/allowed"), "terrain/allowed is missing"),
        (_replace("rounds", 1.0), r"rounds is missing \(expected a group\)"),
        (
            _replace("instants/com", np.zeros((K, 4))),
            rf"instants/com has shape \({K}, 4\), expected \(K, 3\) with K = {K}",
        ),
        (_replace("instants/mu", np.zeros((K + 1, N))), "instants/mu has shape"),
        (_replace("instants/mu", "text"), "instants/mu holds object, expected float"),
        (_replace("instants/mu", np.zeros((K, N), int)), "instants/mu holds int64, expected float"),
        (_replace("instants/lifted", np.zeros((K, N))), "lifted holds float64, expected bool"),
        (_replace("robot/limb_names", np.zeros(N)), "limb_names holds float64, expected text"),
        (_replace("instants/com", h5py.Empty("f8")), "instants/com is empty"),
        (_put("instants/force", (0, 0, 0), np.nan), "NaN or infinity in instants/force"),
        (_put("instants/com", (0, 0), np.inf), "NaN or infinity in instants/com"),
        (_put("instants/safety_torque", 0, np.nan), "NaN or infinity in instants/safety_torque"),
        (_put("instants/region", (0, 0), 7), "instants/region names a surface that is not there"),
        (_put("rounds/region", (0, 0), -1), "rounds/region names a surface that is not there"),
        (_attribute("kind", "round", "terrain/surfaces/0000"), "unknown kind 'round'"),
        (_claim, r"trajectory/time claims shape \(1000000000000,\), but the file holds 0 bytes"),
        (_link_elsewhere, "instants/com is a link, expected data in the file itself"),
        (_raw_file, "instants/com refers to data outside the file"),
        (_virtual, "instants/com refers to data outside the file"),
    ],
)
def test_damage_is_named(
    change: Callable[[h5py.File], None], message: str, plan_file: Path
) -> None:
    with h5py.File(plan_file, "r+") as file:
        change(file)
    with pytest.raises(PlanFileError, match=message) as caught:
        read_climb(plan_file)
    assert str(plan_file) in str(caught.value)


def test_fewer_instants_than_the_gait_has_are_refused(plan_file: Path) -> None:
    with h5py.File(plan_file, "r+") as file:
        for name, data in {n: d[()] for n, d in file["instants"].items()}.items():
            _replace(f"instants/{name}", data[:-1])(file)
    with pytest.raises(PlanFileError, match=rf"holds {K - 1} instants, expected .*: {K}"):
        read_climb(plan_file)


@pytest.mark.parametrize("part", [0.01, 0.3, 0.7, 0.99])
def test_a_file_cut_short_is_refused(part: float, original: Path, tmp_path: Path) -> None:
    content = original.read_bytes()
    cut = tmp_path / "cut.h5"
    cut.write_bytes(content[: int(part * len(content))])
    with pytest.raises(PlanFileError, match="damaged"):
        read_climb(cut)


def test_a_damaged_text_heap_is_noticed_before_the_library_loops_on_it(plan_file: Path) -> None:
    content = bytearray(plan_file.read_bytes())
    heap = content.index(b"GCOL\x01\0\0\0")
    content[heap + 16 : heap + 32] = bytes(16)  # the first text: no index, no length
    plan_file.write_bytes(content)
    with pytest.raises(PlanFileError, match="damaged: its texts are not whole"):
        read_climb(plan_file)
    content[heap + 8 : heap + 16] = b"\xff" * 8  # a collection larger than the file
    plan_file.write_bytes(content)
    with pytest.raises(PlanFileError, match="damaged"):
        read_climb(plan_file)


def test_damaged_bytes_never_escape_as_other_errors(original: Path, tmp_path: Path) -> None:
    content = original.read_bytes()
    path = tmp_path / "damaged.h5"
    generator = random.Random(5)
    refused = 0
    for _ in range(150):
        damaged = bytearray(content)
        # Most bytes are array data, where any value is as good as another: aim at the rest too.
        for _ in range(generator.choice((1, 8, 64))):
            damaged[generator.randrange(generator.choice((4096, len(content))))] ^= 1 << (
                generator.randrange(8)
            )
        path.write_bytes(damaged)
        try:
            plan = read_climb(path)
        except PlanFileError:
            refused += 1
        else:
            assert isinstance(plan, ClimbPlan)
    assert refused > 30
