"""Fitted envelopes as HDF5 files, format `climbplan/envelopes`.

envelopes/<method>/lower, upper (N, 6)   toe [P] and force [weights] of each limb
envelopes/<method>  attributes `validation` and `conditions` (JSON) of all envelopes of the method
                    and `seconds`; with several, they are named <method>-1, <method>-2 and so on
fitness (G, 3)  mean, spread, best of each generation
Root attributes limb_names (JSON), position_scale [m], training_fingerprint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from climbplan.climb.envelopes.run import EnvelopeRun, FittedEnvelopes
from climbplan.climb.schema.envelopes_loading import LoadedEnvelopes
from climbplan.learning.envelope_box import Envelope
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_json
from climbplan.store.root_attributes import Origin, write_root

FORMAT = "climbplan/envelopes"
FORMAT_VERSION = 1
_BOX = DatasetLayout(("N", 6), "P, weight", "world")
_FITNESS = DatasetLayout(("G", 3))


@dataclass(frozen=True)
class StoredEnvelopes:
    """What planners read from a file."""

    limb_names: tuple[str, ...]
    position_scale: float  # P [m]
    envelopes: dict[str, Envelope]  # by method; several of one are `<method>-1` and so on
    fingerprint: str = ""  # sha256 of the training terrains and labels
    spec_text: str = ""  # that `fit-envelopes` was given
    validation: dict[str, Mapping[str, Any]] = field(default_factory=dict)  # by the same names
    conditions: dict[str, Mapping[str, Any]] = field(default_factory=dict)


def write_envelopes(run: EnvelopeRun, loaded: LoadedEnvelopes, path: Path) -> None:
    """Write all envelopes of a run; the file appears whole or not at all."""
    with create_store(path) as file:
        # There is nothing to verify: envelopes are fitted.
        origin = Origin(
            name=loaded.name,
            spec_text=loaded.text,
            spec_sha256=loaded.sha256,
            seed=loaded.spec.seed,
        )
        write_root(
            file,
            origin,
            FORMAT,
            FORMAT_VERSION,
            texts={"status": "feasible", "training_fingerprint": run.fingerprint},
            numbers={"position_scale": run.position_scale},
            objects={
                "timings": run.timings,
                "limb_names": list(run.limb_names),
                "drawn": count_drawn(run),
            },
        )
        write_dataset(file, "fitness", run.fitness, _FITNESS)
        for fitted in run.fitted:
            for name, envelope in name_envelopes(fitted).items():
                group = file.create_group(f"envelopes/{name}")
                write_dataset(group, "lower", envelope.lower, _BOX)
                write_dataset(group, "upper", envelope.upper, _BOX)
                write_json(group, "validation", asdict(fitted.validation))
                write_json(group, "conditions", asdict(fitted.conditions))
                group.attrs["seconds"] = fitted.seconds


def name_envelopes(fitted: FittedEnvelopes) -> dict[str, Envelope]:
    """Return envelopes of a method by the names they have in files."""
    several = len(fitted.envelopes) > 1
    return {
        f"{fitted.method}-{k + 1}" if several else fitted.method: envelope
        for k, envelope in enumerate(fitted.envelopes)
    }


def count_drawn(run: EnvelopeRun) -> dict[str, dict[str, int]]:
    """Return how many terrains were drawn, and what became of those without a row."""
    return {
        name: {"drawn": rows.drawn, "trivial": rows.trivial, "undecided": rows.undecided}
        for name, rows in (("training", run.training), ("held_out", run.held_out))
    }


def read_envelopes(path: Path) -> StoredEnvelopes:
    """Return the envelopes of a file; raises PlanFileError for another format or malformed data."""
    with open_store(path) as file:
        reader = Reader(path, file)
        if not reader.has_attribute("", "format") or reader.text("", "format") != FORMAT:
            raise reader.refuse(f"not a file of envelopes ({FORMAT})")
        names = reader.json("", "limb_names")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise reader.refuse("attribute limb_names is not a list of names")
        envelopes = {}
        measured: dict[str, dict[str, Mapping[str, Any]]] = {"validation": {}, "conditions": {}}
        for group in reader.members("envelopes"):
            method = group.rpartition("/")[2]
            lower = reader.array(f"{group}/lower", _BOX)
            upper = reader.array(f"{group}/upper", _BOX)
            if len(lower) != len(names) or (lower > upper).any():
                raise reader.refuse(f"envelope {method!r} does not fit {len(names)} limbs")
            envelopes[method] = Envelope(lower, upper)
            for name, table in measured.items():
                value = reader.json(group, name)
                if not isinstance(value, dict):
                    raise reader.refuse(f"{group}: attribute {name} is not a JSON object")
                table[method] = value
        return StoredEnvelopes(
            tuple(names),
            reader.number("", "position_scale"),
            envelopes,
            reader.text("", "training_fingerprint"),
            reader.text("", "spec"),
            **measured,
        )
