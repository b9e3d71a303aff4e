"""Model files: nothing in them is run, and nothing wrong is read as right."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from learned_rows import made_up, stored_model

from climbplan.errors import PlanFileError
from climbplan.learning.model import FitOptions, ModelKind, fit_strategy
from climbplan.learning.model_file import read_model, write_model

Damage = Callable[[h5py.File], None]
_OPTIONS = {
    "trees": 5, "depth": 6, "hidden": (8,), "epochs": 3, "rounds": 3, "leaves": 4,
    "cluster_trees": 5,
}  # fmt: skip


@pytest.fixture
def stored(tmp_path: Path) -> Callable[[ModelKind], Path]:
    def write(kind: ModelKind) -> Path:
        model = fit_strategy(made_up(80), FitOptions(kind=kind, **_OPTIONS), np.array([0, 1]))
        path = tmp_path / f"{kind}.h5"
        write_model(stored_model(model), path)
        return path

    return write


class _Bomb:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch exploded",)


def _replaced(file: h5py.File, name: str, value: object) -> None:
    del file[name]
    file[name] = value


def _edit(name: str, at: object, value: float) -> Damage:
    def damage(file: h5py.File) -> None:
        file[name][at] = value

    return damage


def _huge(file: h5py.File) -> None:
    del file["forest/label"]
    file["forest"].create_dataset("label", shape=(2**40,), dtype=int, chunks=(2**16,))


def _pickled(file: h5py.File) -> None:
    raw = np.frombuffer(pickle.dumps(_Bomb()), np.uint8)
    file["forest/pickle"] = raw


def _opaque(file: h5py.File) -> None:
    _replaced(file, "forest/share", np.void(pickle.dumps(_Bomb())))


def _linked(file: h5py.File) -> None:
    del file["scale"]
    file["scale"] = h5py.ExternalLink("/etc/passwd", "/x")


def _chain(file: h5py.File) -> None:
    """One tree whose every inner node has a leaf and the next inner node below it."""
    inner, leaf = np.arange(20_000), -1
    feature = np.append(np.column_stack([0 * inner, 0 * inner + leaf]).ravel(), leaf)
    left = np.append(np.column_stack([2 * inner + 1, 0 * inner + leaf]).ravel(), leaf)
    right = np.append(np.column_stack([2 * inner + 2, 0 * inner + leaf]).ravel(), leaf)
    first = np.append(0, np.cumsum(feature == leaf))
    for name, value in {
        "root": np.array([0]), "feature": feature, "threshold": np.zeros(len(feature)),
        "left": left, "right": right, "first": first,
        "label": np.zeros(first[-1], np.int64), "share": np.ones(first[-1]),
    }.items():  # fmt: skip
        _replaced(file, f"forest/{name}", value)


def _shared(file: h5py.File) -> None:
    left, right = file["forest/left"], file["forest/right"]
    node = int(np.argmax(left[()] >= 0))
    right[node] = left[node]


HOSTILE: list[tuple[ModelKind, Damage, str]] = [
    ("forest", _edit("forest/threshold", 0, np.nan), "finite"),
    ("forest", _edit("forest/left", 0, 0), "behind"),
    ("forest", _edit("forest/right", 0, 10**9), "behind"),
    ("forest", _chain, "deeper than 1000"),
    ("forest", _shared, "child of two"),
    ("forest", _edit("forest/feature", 0, 99), "feature"),
    ("forest", _edit("forest/label", 0, 10**6), "class"),
    ("forest", _edit("forest/share", 0, -1.0), "share"),
    ("forest", _edit("forest/first", -1, 10**12), "entries"),
    ("forest", _edit("library/points", (0, 0), np.inf), "finite"),
    ("forest", _edit("library/points", (0, 2), 0.5), "neither 0 nor 1"),
    ("forest", _edit("scale", 0, 0.0), "positive"),
    ("forest", lambda f: _replaced(f, "forest/share", np.zeros((2, 2))), "shape"),
    ("forest", lambda f: _replaced(f, "forest/left", np.zeros(3, np.int64)), "shape"),
    ("forest", lambda f: _replaced(f, "forest/label", np.zeros(3)), "expected int"),
    ("forest", lambda f: f["forest"].attrs.modify("classes", 10**9), "classes"),
    ("forest", lambda f: f.attrs.modify("kind", "oracle"), "oracle"),
    ("forest", lambda f: f.attrs.modify("format_version", 9), "version 9"),
    ("forest", lambda f: f.attrs.modify("format", "climbplan/plan"), "not a model"),
    ("forest", lambda f: f.attrs.modify("context", "[1]"), "JSON object"),
    ("forest", lambda f: f.__delitem__("forest"), "missing"),
    ("forest", _huge, "claims shape"),
    ("forest", _pickled, "which no model"),
    ("forest", _opaque, "expected float"),
    ("forest", _linked, "link"),
    ("network", _edit("network/sizes", 1, 10**15), "layers of sizes"),
    ("network", _edit("network/sizes", 1, -4), "layers of sizes"),
    ("network", _edit("network/weight", 0, np.nan), "finite"),
    ("network", _edit("network/scale", 0, -1.0), "positive"),
    ("boosting", _edit("boosting/option", 0, 10**6), "option"),
    ("boosting", _edit("boosting/level", (0, 0), 10**6), "option of another choice"),
    ("boosting", _edit("boosting/choice", 1, 0), "follow one another"),
    ("boosting", _edit("boosting/value", 0, np.inf), "finite"),
    ("reduce", _edit("cluster", 0, 10**9), "no member"),
    ("reduce", _edit("cluster", 0, -7), "cluster"),
    ("knn", lambda f: f.create_dataset("cluster", data=np.zeros(3)), "which no model"),
]


@pytest.mark.parametrize(("kind", "damage", "word"), HOSTILE)
def test_hostile_files_are_refused(
    stored: Callable[[ModelKind], Path], kind: ModelKind, damage: Damage, word: str
) -> None:
    path = stored(kind)
    with h5py.File(path, "r+") as file:
        damage(file)
    with pytest.raises(PlanFileError, match=word) as caught:
        read_model(path)
    assert str(path) in str(caught.value)
    assert not Path("exploded").exists()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_files_that_were_cut_short(stored: Callable[[ModelKind], Path], share: float) -> None:
    path = stored("forest")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(PlanFileError, match=str(path)):
        read_model(path)


def test_a_pickle_instead_of_a_model(tmp_path: Path) -> None:
    path = tmp_path / "model.h5"
    path.write_bytes(pickle.dumps(_Bomb()))
    with pytest.raises(PlanFileError, match="not an HDF5 file"):
        read_model(path)
    assert not Path("exploded").exists()


def test_random_damage_never_gets_through_as_a_bug(stored: Callable[[ModelKind], Path]) -> None:
    path = stored("network")
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range(40):
        raw = bytearray(whole)
        for at in rng.integers(0, len(raw), 12):
            raw[at] = int(rng.integers(256))
        path.write_bytes(bytes(raw))
        try:
            model = read_model(path).model
        except PlanFileError:
            continue
        model.create_strategy().candidates(np.zeros(3), 3)
