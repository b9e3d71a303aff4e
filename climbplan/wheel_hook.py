"""Build a wheel that carries machine code, by a hook of Hatchling.

    HATCH_BUILD_HOOKS_ENABLE=true pip wheel --no-deps .

The hook runs the examples that use each group of compiled functions, which takes some minutes, and
adds what was compiled to the wheel. Such a wheel serves one version of Python on one platform.
Without the variable a wheel has no machine code, and serves all of them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

RUNS = {  # commands on examples that use each group of compiled functions, by output directory
    "own": "solve cart_pole.yaml --problem cart_pole.py:problem",
    "own_quadratic": "solve tipped_box.yaml --problem tipped_box.py:problem",
    "climb": "plan-climb climb_tube.yaml",
    "climb_in_scan": "plan-climb climb_rough_chimney.yaml",
    "statics": "simulate {outputs}/climb --worlds 1 --engine statics",
    "climb_of_urdf": "plan-climb climb_walker.yaml",
    "walk": "plan-mpc mpc_forward.yaml",
    "walk_after_push": "plan-mpc mpc_recovery.yaml",
    "walk_on_stones": "plan-mpc mpc_stones.yaml",
    "walk_of_urdf": "plan-mpc mpc_telescope.yaml",
    "modules": "plan-limms limms_walk.yaml",
    "book": "solve-bookshelf bookshelf_scene.yaml",
    "book_exact": "solve-bookshelf bookshelf_scene.yaml --method exact",
}


class PrecompilingHook(BuildHookInterface[Any]):
    """Adds machine code to a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Run the examples and name the files that they leave.

        Raises:
            RuntimeError: An example fails.
        """
        if version == "editable":
            return
        self._directory = tempfile.TemporaryDirectory()
        place = Path(self._directory.name)
        for output, command in RUNS.items():
            self.app.display_info(f"compiling for: climbplan {command}")
            self._run([*command.format(outputs=place).split(), "-o", str(place / output)])
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["force_include"][str(place / "machine_code")] = "climbplan/machine_code"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what is in the wheel now."""
        if version != "editable":
            self._directory.cleanup()

    def _run(self, arguments: list[str]) -> None:
        """Run a command, whose compiled functions are stored."""
        # An isolated build finds its packages by the variable
        search_path = [self.root, *filter(None, [os.environ.get("PYTHONPATH")])]
        completed = subprocess.run(
            [sys.executable, "-m", "climbplan", *arguments],
            cwd=Path(self.root) / "specs",
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(search_path),
                "CLIMBPLAN_PRECOMPILE_DIR": str(Path(self._directory.name) / "machine_code"),
            },
            stderr=subprocess.PIPE,
            text=True,
        )
        if completed.returncode:
            self._directory.cleanup()
            raise RuntimeError(f"{' '.join(arguments)} failed:\n{completed.stderr}")
