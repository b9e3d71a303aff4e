"""Small LIMMS scenes for tests, as text with changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from climbplan.limms.scene.limms_scene import ModuleScene, build_scene
from climbplan.limms.schema.loading import LoadedLimms, load_limms

SPECS = Path(__file__).parents[2] / "specs"


def changed(folder: Path, name: str, **values: Any) -> Path:
    """A copy of a shipped spec with dotted keys set (`box__mass=7`)."""
    content = yaml.safe_load((SPECS / f"{name}.yaml").read_text(encoding="utf-8"))
    for key, value in values.items():
        holder = content
        *parts, last = key.split("__")
        for part in parts:
            holder = holder[int(part)] if part.isdigit() else holder[part]
        holder[last] = value
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def loaded(name: str, *overrides: str) -> LoadedLimms:
    """A shipped spec."""
    return load_limms(SPECS / f"{name}.yaml", overrides)


def scene(name: str, *overrides: str) -> ModuleScene:
    """The scene of a shipped spec."""
    return build_scene(loaded(name, *overrides))
