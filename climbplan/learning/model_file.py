"""Trained strategies as HDF5 files, format `climbplan/strategy`: plain arrays, nothing to execute.

library/    features (S, p), points (S, N), objective (S), alternatives (S, C), labels (S, L),
            integer (N), options (C)
scale (p)   cluster (S) of `reduce`
forest/     root (T), feature, threshold, left, right (M), first (M + 1), label, share (E)
boosting/   root, feature, threshold, left, right, value (M), option (T), baseline (R),
            choice (H + 1), level (U, H)
network/    sizes (L + 1), weight, bias, mean (p), scale (p)
Attributes: kind, program, context (JSON), fit (JSON: the evaluation), and those of every file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py

from climbplan.errors import PlanFileError, UsageError
from climbplan.learning.boosting import Boosting
from climbplan.learning.forest import Forest
from climbplan.learning.library import Library, ProgramSignature
from climbplan.learning.model import MODEL_KINDS, StrategyModel
from climbplan.learning.network import Network
from climbplan.learning.trees import Trees
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_datasets
from climbplan.store.root_attributes import Origin, read_root, require_other, write_root

FORMAT = "climbplan/strategy"
FORMAT_VERSION = 1

_LIBRARY = {
    "features": DatasetLayout(("S", "p")),
    "points": DatasetLayout(("S", "N")),
    "objective": DatasetLayout(("S",)),
    "alternatives": DatasetLayout(("S", "C"), kind="int"),
    "labels": DatasetLayout(("S", "tags"), kind="int"),
}
_FRAME = {
    "integer": DatasetLayout(("N",), kind="bool"),
    "options": DatasetLayout(("C",), kind="int"),
}
_TREES = {
    "root": DatasetLayout(("T",), kind="int"),
    "feature": DatasetLayout(("M",), kind="int"),
    "threshold": DatasetLayout(("M",)),
    "left": DatasetLayout(("M",), kind="int"),
    "right": DatasetLayout(("M",), kind="int"),
}
_FOREST = {
    "first": DatasetLayout(("M1",), kind="int"),
    "label": DatasetLayout(("E",), kind="int"),
    "share": DatasetLayout(("E",)),
}
_BOOSTING = {
    "value": DatasetLayout(("M",)),
    "option": DatasetLayout(("T",), kind="int"),
    "baseline": DatasetLayout(("R",)),
    "choice": DatasetLayout(("H1",), kind="int"),
    "level": DatasetLayout(("U", "H"), kind="int"),
}
_NETWORK = {
    "sizes": DatasetLayout(("L",), kind="int"),
    "weight": DatasetLayout(("W",)),
    "bias": DatasetLayout(("B",)),
    "mean": DatasetLayout(("p",)),
    "scale": DatasetLayout(("p",)),
}
_SCALE = DatasetLayout(("p",))
_CLUSTER = DatasetLayout(("S",), kind="int")
_CLASSIFIERS = {
    "forest": _TREES | _FOREST,
    "boosting": _TREES | _BOOSTING,
    "network": _NETWORK,
}
_OF_KIND = {
    "knn": "",
    "forest": "forest",
    "boosting": "boosting",
    "network": "network",
    "reduce": "forest",
}


@dataclass(frozen=True, kw_only=True)
class ModelFile(Origin):
    """A trained strategy and its origin; verified if it was read back with equal candidates."""

    model: StrategyModel
    title: str = ""
    fit: Mapping[str, Any] = field(default_factory=dict)  # figures of the evaluation
    timings: Mapping[str, Any] = field(default_factory=dict)


def write_model(stored: ModelFile, path: Path) -> None:
    """Write a model; the file appears completely or not at all.

    Raises:
        UsageError: The file cannot be written.
    """
    model = stored.model
    library, frame = model.library, model.library.frame
    with create_store(path) as file:
        texts = {"title": stored.title, "kind": model.kind, "program": frame.name}
        write_root(
            file,
            stored,
            FORMAT,
            FORMAT_VERSION,
            texts={"status": "feasible", **texts},
            numbers={},
            objects={
                "context": dict(model.context),
                "fit": dict(stored.fit),
                "timings": dict(stored.timings),
            },
        )
        group = file.create_group("library")
        write_datasets(group, _FRAME, vars(frame))
        write_datasets(group, _LIBRARY, vars(library), compressed=True)
        write_dataset(file, "scale", model.scale, _SCALE)
        if model.cluster is not None:
            write_dataset(file, "cluster", model.cluster, _CLUSTER)
        if model.classifier is not None:
            _write_classifier(file, model.classifier)


def mark_verified(stored: ModelFile, verified: bool) -> ModelFile:
    """Return the same file with the outcome of its verification."""
    return replace(stored, verified=verified)


def read_model(path: Path) -> ModelFile:
    """Read the model in a file; only numbers and texts are read, nothing in it is executed.

    Raises:
        PlanFileError: The file is missing, damaged, of another kind, has foreign members, or its
            numbers cannot be those of a trained strategy.
    """
    with open_store(path) as file:
        reader = Reader(path, file)
        try:
            stored = _read_model_file(reader)
            if reader.not_finite:
                names = ", ".join(reader.not_finite)
                raise reader.refuse(f"{names} holds numbers that are not finite")
            stored.model.require()
        except PlanFileError:
            raise
        except UsageError as error:
            raise PlanFileError(f"{path}: {error}") from error
        return stored


def _write_classifier(file: h5py.File, classifier: Forest | Network | Boosting) -> None:
    """Write the arrays of a classifier."""
    arrays: dict[str, Any] = dict(vars(classifier))
    if isinstance(classifier, Network):
        name = "network"
    else:
        arrays |= vars(classifier.trees)
        name = "forest" if isinstance(classifier, Forest) else "boosting"
        arrays["choice"] = arrays["first"]
    group = file.create_group(name)
    for key, layout in _CLASSIFIERS[name].items():
        write_dataset(group, key, arrays[key], layout, compressed=True)
    if isinstance(classifier, Forest):
        group.attrs["classes"] = classifier.classes


def _read_model_file(reader: Reader) -> ModelFile:
    """Read all members."""
    require_other(reader, FORMAT_VERSION, FORMAT, "a model of `climbplan fit-strategy`")
    kind_text = reader.text("", "kind")
    kind = next(
        (candidate_kind for candidate_kind in MODEL_KINDS if candidate_kind == kind_text), None
    )
    if kind is None:
        raise reader.refuse(f"kind {kind_text!r}, expected one of {', '.join(MODEL_KINDS)}")
    section = _OF_KIND[kind]
    _require_members(reader, kind, section)
    frame = ProgramSignature(
        reader.text("", "program"),
        reader.array("library/integer", _FRAME["integer"]),
        reader.array("library/options", _FRAME["options"]),
    )
    arrays: dict[str, Any] = reader.datasets("library", _LIBRARY)
    if (frame.options < 1).any():
        raise reader.refuse("library/options holds a choice without alternatives")
    context, figures = reader.mapping("context"), reader.mapping("fit")
    timings = reader.figures("timings")
    model = StrategyModel(
        kind=kind,
        library=Library.of(frame, **arrays),
        scale=reader.array("scale", _SCALE),
        classifier=_read_classifier(reader, section) if section else None,
        cluster=reader.array("cluster", _CLUSTER) if kind == "reduce" else None,
        context=context,
    )
    return ModelFile(
        **read_root(reader),
        model=model,
        title=reader.text("", "title"),
        fit=figures,
        timings=timings,
    )


def _require_members(reader: Reader, kind: str, classifier_group: str) -> None:
    """Check that a model has its own arrays and nothing else."""
    expected: dict[str, set[str]] = {
        "": {"library", "scale", *([classifier_group] if classifier_group else [])},
        "library": {*_LIBRARY, *_FRAME},
    }
    if kind == "reduce":
        expected[""].add("cluster")
    if classifier_group:
        expected[classifier_group] = set(_CLASSIFIERS[classifier_group])
    for holder, names in expected.items():
        group = reader.group(holder) if holder else reader.root
        unexpected = sorted(set(group) - names)
        if unexpected:
            where = f"{holder}/{unexpected[0]}" if holder else unexpected[0]
            raise reader.refuse(f"holds {where!r}, which no model of kind {kind!r} has")


def _read_classifier(reader: Reader, classifier_group: str) -> Forest | Network | Boosting:
    """Read the arrays of a classifier."""
    arrays = reader.datasets(classifier_group, _CLASSIFIERS[classifier_group])
    if classifier_group == "network":
        return Network(**arrays)
    trees = Trees(**{name: arrays.pop(name) for name in _TREES})
    ends = arrays["first"] if classifier_group == "forest" else arrays["choice"]
    expected = (
        len(trees.feature) + 1 if classifier_group == "forest" else arrays["level"].shape[1] + 1
    )
    if len(ends) != expected:
        raise reader.refuse(f"{classifier_group}: {len(ends)} ends of ranges, expected {expected}")
    if classifier_group == "forest":
        return Forest(trees, **arrays, classes=reader.integer("forest", "classes"))
    return Boosting(trees, first=arrays.pop("choice"), **arrays)
