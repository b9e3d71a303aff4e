"""The reference to a trained strategy that specs of several kinds share."""

from __future__ import annotations

from pydantic import Field

from climbplan.schema.base import SpecModel


class ModelFileSpec(SpecModel):
    """A trained strategy."""

    file: str = Field(
        min_length=1,
        description="model file of `fit-strategy`; relative to the spec",
    )
