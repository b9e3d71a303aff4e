"""Tell keys that a spec states from those that its defaults fill in.

A proof that no plan exists may rest on what the user asked for only. Robot, terrain and task mean
what the documentation says, written out or not, but for what a task leaves to the planner. Bounds
and factors of the planner's own rooms (`posture`, `force`, `trajectory`, ...) bind a proof only
where the spec has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel


def is_stated(spec: object, key: str) -> bool:
    """Return whether the spec itself (or a `--set`) gives a key.

    Args:
        spec: A spec model.
        key: Dotted key, such as `posture.steps.com_max`; lists count as a whole.

    Raises:
        KeyError: No spec of this kind has the key.
    """
    holder: Any = spec
    for name in key.split("."):
        if isinstance(holder, Mapping):
            if name not in holder:
                return False
            holder = holder[name]
            continue
        if not isinstance(holder, BaseModel) or name not in type(holder).model_fields:
            raise KeyError(key)
        if name not in holder.model_fields_set:
            return False
        holder = getattr(holder, name)
        if holder is None:
            return False
    return True
