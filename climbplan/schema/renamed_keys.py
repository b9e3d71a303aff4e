"""Old names of spec keys and methods: they keep their meaning, with a warning for each.

A document is rewritten to the new names as soon as its YAML is parsed, so that models, messages
and comparisons of specs know the new names only. Its text is left as its user wrote it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from typing import Any

from climbplan.deprecation import RENAMED_METHODS
from climbplan.schema.document import Document, Finding, KeyPath, format_key_path

_TERRAIN = {"terrain.scan.least_size": "min_size"}
_POSTURE = {
    "steps.shift_max": "com_shift_max",
    "intermediate_reach": "check_reach_during_round",
    "least_load": "min_load",
}
_CLIMBING = {
    **_TERRAIN,
    "force.least_pressure": "min_normal_force",
    "force.least_depth": "min_penetration",
    "force.sag": "deflection_compensation",
    "force.stiffness_left": "min_stiffness_ratio",
    "margins.pressure": "normal_force",
    "solver.force": "force_solver",
    "trajectory.lift": "swing_clearance",
}
RENAMED_KEYS: Mapping[str, Mapping[str, str]] = {
    "bookshelf": {
        "meaning": "formulation",
        "shelf.book_gap_mm": "max_book_gap_mm",
        "shelf.published.distance_mm": "distance_tolerance_mm",
        "shelf.published.left_wall_mm": "left_wall_tolerance_mm",
        "shelf.published.sine": "sine_tolerance",
        "shelf.wall_gap_mm": "max_wall_gap_mm",
        "solver.candidates": "max_candidates",
        "solver.library.foreign": "allow_other_shelves",
        "solver.refinements": "max_refinements",
    },
    "climb": {
        **_CLIMBING,
        **{f"posture.{old}": new for old, new in _POSTURE.items()},
        "solver.mixed": "mip_solver",
        "solver.posture": "posture_solver",
    },
    "dataset": {
        "problem.attempts": "max_attempts",
        "problem.drop.attempts": "max_attempts",
        "problem.drop.room_mm": "frame_width_mm",
        "problem.drop.tilt": "max_tilt",
        "problem.drop.upright_kept": "upright_acceptance",
        "problem.share_feasible": "feasible_fraction",
        "problem.solver.nodes": "node_limit",
        "problem.start.sideways": "lateral",
        "problem.start.spin": "angular_velocity",
        "problem.world": "randomisation",
        "shard": "shard_size",
    },
    "transition": {
        **_CLIMBING,
        **{f"climb.posture.{old}": new for old, new in _POSTURE.items()},
        "posture.steps.shift_max": "com_shift_max",
        "search.aside": "lateral_offset",
        "search.least_load": "min_load",
        "search.most": "max_sequences",
        "search.tried": "max_planned",
        "task.supporting": "min_supporting_limbs",
    },
    "mpc": {
        "loop.candidates": "max_candidates",
        "loop.compensate": "compensate_delay",
        "loop.dropped": "dropout_probability",
        "loop.effort": "max_qp_iterations",
        "loop.enough": "min_feasible_candidates",
        "loop.legs": "leg_model",
        "loop.noise.spin": "angular_velocity",
        "loop.letting_go": "lift_unreachable_stance_feet",
        "loop.replan": "replan_trigger",
        "loop.sensors.toe_rate": "foot_velocity_std",
        "solver.arm_pieces": "moment_arm_partitions",
        "solver.attitude_box.spin": "angular_velocity",
        "solver.form": "formulation",
        "solver.guess": "initial_gait",
        "solver.qps": "max_qp_solves",
        "solver.regions_beside": "neighbour_region_fraction",
        "solver.tube": "attitude_box",
        "solver.warm": "initial_solution",
        "task.least_contacts": "min_contacts",
        "task.lift": "swing_clearance",
        "task.step": "dt",
        "task.whole_stance": "workspace_over_stance",
    },
    "limms": {
        "modules.*.stand": "position",
        "parked": "static_boxes",
        "solver.admm.form": "formulation",
        "solver.admm.growth": "weight_growth",
        "solver.most_steps": "max_steps",
        "solver.programs": "max_nlp_solves",
    },
}
"""By kind of spec: dotted path of an old key (`*` for any entry of a list), and its new name."""

METHOD_KEYS: Mapping[str, tuple[str, ...]] = {
    "mpc": ("solver.method", "solver.initial_solution"),
    "program": ("solver.method", "solver.fallback"),
}
"""By kind of spec: keys whose value is the name of a method; `solver.method` of the others."""


def rename_methods(document: Document) -> None:
    """Give methods in the values of a document their new names, in place.

    Every renamed value is appended to `document.renamed_values`.
    """
    for root, kind in list(_specs_within(document.value, ())):
        renamed = RENAMED_METHODS.get(kind, {})
        for key in METHOD_KEYS.get(kind, ("solver.method",)):
            for path in list(_match_paths(document.value, root, key)):
                holder = document.value
                for segment in path[:-1]:
                    holder = holder[segment]
                old = holder[path[-1]]
                if isinstance(old, str) and old in renamed:
                    holder[path[-1]] = renamed[old]
                    document.renamed_values.append((path, old, renamed[old]))


def rename_keys(document: Document) -> None:
    """Give the keys of a parsed document their new names, in place.

    Specs inside a spec (mappings with a `kind` of their own) are renamed, too. Every renamed key
    is appended to `document.renamed`. A key that stands under both names becomes a finding.
    """
    for root, kind in list(_specs_within(document.value, ())):
        for pattern, new in RENAMED_KEYS.get(kind, {}).items():
            for path in list(_match_paths(document.value, root, pattern)):
                _rename(document, path, new)


def renamed_override(document: Document, key: str) -> str:
    """Return the dotted key of an override under its new name; keys without one as they are."""
    segments = key.split(".")
    for root, kind in _specs_within(document.value, ()):
        start = len(root)
        if tuple(segments[:start]) != tuple(str(segment) for segment in root):
            continue
        for pattern, new in RENAMED_KEYS.get(kind, {}).items():
            old = pattern.split(".")
            matched = segments[start : start + len(old)]
            if len(matched) == len(old) and all(
                p in ("*", s) for p, s in zip(old, matched, strict=True)
            ):
                end = start + len(old)
                return ".".join([*segments[: end - 1], new, *segments[end:]])
    return key


def warn_of_renamed(document: Document) -> None:
    """Warn once of every old name of a key or method in a document or in its overrides."""
    messages = [
        (path, f"the key `{old}` is now `{format_key_path(path)}`")
        for old, path in document.renamed
    ]
    messages += [
        (path, f"the method `{old}` of `{format_key_path(path)}` is now `{new}`")
        for path, old, new in document.renamed_values
    ]
    for path, message in messages:
        option = document.options.get(path)
        line = document.lines.get(path)
        place = option or (f"{document.source}, line {line}" if line else document.source)
        warnings.warn(f"{place}: {message}", FutureWarning, stacklevel=2)
    document.renamed.clear()
    document.renamed_values.clear()


def _specs_within(value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, str]]:
    """Yield where a document and the specs inside it start, with the kind of each."""
    if not isinstance(value, dict):
        return
    if isinstance(value.get("kind"), str):
        yield path, value["kind"]
    for key, entry in value.items():
        if isinstance(entry, dict) and isinstance(key, str):
            yield from _specs_within(entry, (*path, key))


def _match_paths(value: Any, root: KeyPath, pattern: str) -> Iterator[KeyPath]:
    """Yield the paths of a document that a pattern stands for."""
    for segment in root:
        value = value[segment]
    places: list[tuple[KeyPath, Any]] = [(root, value)]
    for name in pattern.split("."):
        below: list[tuple[KeyPath, Any]] = []
        for path, entry in places:
            if name == "*" and isinstance(entry, list):
                below += [((*path, i), item) for i, item in enumerate(entry)]
            elif isinstance(entry, dict) and name in entry:
                below.append(((*path, name), entry[name]))
        places = below
    yield from (path for path, _ in places)


def _rename(document: Document, path: KeyPath, new: str) -> None:
    holder = document.value
    for segment in path[:-1]:
        holder = holder[segment]
    old, renamed = path[-1], (*path[:-1], new)
    if new in holder:
        new_key = format_key_path(renamed)
        message = f"the old name of `{new_key}`, which is there, too: expected one of them"
        document.findings.append(Finding(path, message))
        return
    entries = [(new if key == old else key, entry) for key, entry in holder.items()]
    holder.clear()
    holder.update(entries)  # in their old order

    def rename_place(place: KeyPath) -> KeyPath:
        return (*renamed, *place[len(path) :]) if place[: len(path)] == path else place

    document.lines = {rename_place(place): line for place, line in document.lines.items()}
    document.options = {rename_place(place): option for place, option in document.options.items()}
    document.renamed.append((format_key_path(path), renamed))
