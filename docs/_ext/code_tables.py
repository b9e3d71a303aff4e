"""Pages made from the package's own tables: names, checks, methods, solvers, exit codes."""

from __future__ import annotations

import inspect

from markdown_table import wrapped_table
from name_declarations import declare

import climbplan
from climbplan import errors
from climbplan.bookshelf.check.plan_checks import LIMITS as SHELF
from climbplan.bookshelf.check.plan_checks import MEANINGS
from climbplan.datasets.check.verification import MEANINGS as DATASETS
from climbplan.deprecation import RENAMED_CHECKS, RENAMED_METHODS
from climbplan.limms.check.limits import LIMITS as MODULES
from climbplan.limms.check.limits import MASS_LIMITS
from climbplan.schema.renamed_keys import RENAMED_KEYS
from climbplan.solvers.registry import BACKENDS
from climbplan.verification.check import CLIMB_LIMITS
from climbplan.walking.check.checker import LEG_LIMITS, LOOP_LIMITS, SCANNED_LIMITS
from climbplan.walking.check.checker import LIMITS as WALK
from climbplan.walking.check.plan_checks import LIMITS as WALK_PLAN

RETURNED = (
    "climbplan.verification.verification.Verification",
    "climbplan.verification.check.Check",
    "climbplan.api.plan.Simulation",
    "climbplan.api.limit_trials.LimitResult",
    "climbplan.api.limit_trials.Trial",
    "climbplan.api.limit_trials.Margin",
    "climbplan.program.residuals.CheckReport",
)


def api_page() -> str:
    """Every public name, what those return, and what they raise, by autodoc."""
    values = {name: getattr(climbplan, name) for name in climbplan.__all__}
    functions = [name for name, value in values.items() if not inspect.isclass(value)]
    specs = [name for name in values if name.endswith("Spec")]
    classes = [name for name in values if name not in functions and name not in specs]
    raised = [
        name
        for name, value in vars(errors).items()
        if inspect.isclass(value) and issubclass(value, errors.ClimbplanError)
    ]
    lines = ["# Python", "", "`import climbplan` has these names, loaded at first use.", ""]
    lines += ["## Functions", "", "```{eval-rst}"]
    lines += [f".. autofunction:: climbplan.{name}" for name in functions]
    lines += ["```", "", "## Classes", "", "```{eval-rst}"]
    for name in classes:
        hidden = "()" if name == "Plan" else ""  # made by `plan` and `read`
        lines += [f".. autoclass:: climbplan.{name}{hidden}", "   :members:", ""]
    lines += ["```", "", "## Specs", ""]
    lines += ["Models of what `load` reads, with the same keys ([reference](../keys.md)).", ""]
    lines += ["```{eval-rst}"]
    for name in specs:
        lines += [f".. autoclass:: climbplan.{name}(**keys)", ""]
    lines += ["```", "", "## Returned", "", "```{eval-rst}"]
    for path in RETURNED:
        lines += [f".. autoclass:: {path}()", "   :members:", ""]
    lines += ["```", "", "## Raised", "", "```{eval-rst}"]
    for name in raised:
        lines += [f".. autoexception:: climbplan.errors.{name}()", ""]
    return "\n".join([*lines, "```", ""])


def checks_page() -> str:
    """Every check by name, with what it lets pass."""
    kinds = {
        "Climbs and transitions": CLIMB_LIMITS,
        "Walks": {**WALK_PLAN, **WALK, **LEG_LIMITS, **SCANNED_LIMITS, **LOOP_LIMITS},
        "Modules": {**MODULES, **MASS_LIMITS},
        "Bookshelf": SHELF,
    }
    lines = [
        "# Checks",
        "",
        "`climbplan verify` recomputes these constraints. Reports, `report.json` and",
        "`Plan.verify().checks` use the same names; `Plan.verify().check(name)` returns one. The",
        "limit is the largest residual that passes.",
        "Which checks apply depends on the spec; [plan files](guides/store.md) explains badges and",
        "levels.",
        "",
    ]
    for kind, limits in kinds.items():
        rows = [
            (declare("check", name), limit.meaning, f"{limit.value:g} {limit.unit}".strip())
            for name, limit in limits.items()
        ]
        head = ("check", "what holds", "passes up to")
        lines += [f"## {kind}", "", wrapped_table("stacked checks", head, rows)]
    of_books = [(declare("check", name), meaning) for name, meaning in MEANINGS.items()]
    of_datasets = [(f"`{name}`", text) for name, text in DATASETS.items()]
    lines += [
        "And of each placement, to 0.01 mm in the formulation `contact`:",
        "",
        wrapped_table("stacked checks", ("check", "what holds"), of_books),
        "## Datasets",
        "",
        wrapped_table("stacked checks", ("check", "what holds"), of_datasets),
        "[Old names](renamed.md) of checks are listed on a page of their own.",
        "",
    ]
    return "\n".join(lines)


def renamed_page() -> str:
    """Old names of keys, methods and checks, with the new ones."""
    lines = [
        "# Old names",
        "",
        "Old names work where a user gives one, with a warning that has the new one: keys and",
        "methods in specs, `--set`, `--method` and Python; checks in `Verification.check` and in",
        "`CheckReport[...]`. Plan files that hold old names are read and verified as before.",
        "",
    ]
    for kind, keys in RENAMED_KEYS.items():
        rows = [
            (f"`{old}`", f"`{'.'.join([*old.split('.')[:-1], new])}`") for old, new in keys.items()
        ]
        lines += [f"## Keys of `kind: {kind}`", "", wrapped_table("stacked", ("old", "new"), rows)]
    methods = [
        (f"`{kind}`", f"`{old}`", f"`{new}`")
        for kind, names in RENAMED_METHODS.items()
        for old, new in names.items()
    ]
    lines += ["## Methods", "", wrapped_table("stacked", ("kind", "old", "new"), methods)]
    checks = [(f"`{old}`", f"`{new}`") for old, new in RENAMED_CHECKS.items()]
    lines += ["## Checks", "", wrapped_table("stacked", ("old", "new"), checks)]
    return "\n".join(lines)


def solvers_page() -> str:
    """Every solver backend with what it can hold."""
    rows = [
        (
            declare("solver", backend.name),
            ", ".join(sorted(backend.accepts)) or "linear rows, quadratic costs",
            "bounds" if backend.proves else "local",
            backend.purpose,
            f"`{backend.install}`",
        )
        for backend in BACKENDS.values()
    ]
    head = ("solver", "holds beside linear rows", "gives", "used for", "install")
    return "\n".join(
        [
            "# Solvers",
            "",
            "Solvers of stated programs (`climbplan.solvers.registry.BACKENDS`). `climbplan",
            "doctor` says which of them are installed. An instance that a solver cannot hold has",
            "to be reformulated first; methods do that.",
            "",
            wrapped_table("stacked solvers", head, rows),
        ]
    )
