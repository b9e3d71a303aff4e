"""Shipped scenes: the seven of the chapter, others, and hardware that holds modules with masses."""

from __future__ import annotations

from pathlib import Path

from benchmarks.limms.published import TABLE
from climbplan.limms.schema.loading import LoadedLimms, limms_of
from climbplan.schema.examples import read_example
from climbplan.schema.source import SourceText
from climbplan.schema.yaml_source import parse_yaml

SEVEN = (*TABLE, "limms_relatch", "limms_walk")
OTHERS = ("limms_swap", "limms_turned")
MASSES = "masses"
"""Name of the comparison: scenes with masses on hardware that holds them."""
WITH_MASS = {  # assignments to the spec; the two that are not here are held by no hardware
    "limms_throw": ("robot=limms_quick_strong",),
    "limms_lift_light": ("robot=limms_strong",),
    "limms_lift_heavy": ("robot=limms_carrier", "task={allow: [quadruped]}"),
    "limms_double_arm": ("robot=limms_carrier",),
    "limms_walk": ("robot=limms_carrier",),
    "limms_turned": ("robot=limms_quick_strong",),
}


def shipped_scene(name: str) -> LoadedLimms:
    """A shipped spec by its name."""
    text = read_example(name)
    return limms_of(parse_yaml(text, name), SourceText(name, name, Path.cwd(), text))
