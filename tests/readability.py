"""How the package reads, in counts that can only fall: names, docstrings and shapes of functions.

`python tests/readability.py --update` lowers the recorded counts after an improvement.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "climbplan"
RECORD = Path(__file__).with_suffix(".json")
MAX_LINES = 60  # of a function
MAX_POSITIONAL = 6  # parameters of a function that may be given by position

# Words that do not say what a value is
VAGUE_NAMES = frozenset(
    """found at one own other others here there held kept known given made asked told wanted most
    least few many some part parts share room way ways beside aside word words thing things taken
    put got gone begun drawn moved turned bent settled met used use spent seen looked look looks
    shown rest bare plain onward fresh near""".split()  # noqa: SIM905
)
IRREGULAR_PARTICIPLES = frozenset(
    """told drawn kept held found shown cut begun grown gone borne bent built left met put seen
    spent taken known given made""".split()  # noqa: SIM905
)
# A docstring that begins with one of these is a fragment, not a sentence
FRAGMENT_OPENERS = frozenset(
    """what how where which whether why when who of as by from in with without to beside until
    between on about at than for""".split()  # noqa: SIM905
)
SUBJECT = re.compile(r"[a-z][a-z0-9 ,_-]*: \S")  # of a commit: "area: imperative"
MAX_SUBJECT = 72


def count_package(package: Path = PACKAGE) -> dict[str, int]:
    """Count what makes a package hard to read.

    Returns:
        `vague_names` of variables, parameters, functions and attributes; `participle_functions`,
        named by a participle alone; `fragment_docstrings`; `long_functions`; `wide_functions`;
        `shared_class_names`, which stand for more than one class.
    """
    counts: Counter[str] = Counter()
    classes: Counter[str] = Counter()
    for file in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                classes[node.name.strip("_")] += 1
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                counts.update(_count_function(node))
            counts["vague_names"] += sum(
                name.strip("_") in VAGUE_NAMES for name in _names_bound_by(node)
            )
    counts["shared_class_names"] = sum(count > 1 for count in classes.values())
    return dict(sorted(counts.items()))


def _count_function(node: ast.FunctionDef | ast.AsyncFunctionDef) -> Counter[str]:
    name = node.name.strip("_")
    is_property = any("property" in ast.unparse(item) for item in node.decorator_list)
    positional = [a for a in _positional(node) if a.arg not in ("self", "cls")]
    opening = (ast.get_docstring(node) or "").split()[:1]
    return Counter(
        participle_functions=not is_property
        and "_" not in name
        and (name.endswith("ed") or name in IRREGULAR_PARTICIPLES),
        fragment_docstrings=any(
            word.strip(".,:;`").lower() in FRAGMENT_OPENERS for word in opening
        ),
        long_functions=(node.end_lineno or 0) - node.lineno > MAX_LINES,
        wide_functions=len(positional) > MAX_POSITIONAL,
    )


def _names_bound_by(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        yield node.name
        yield from (a.arg for a in (*_positional(node), *node.args.kwonlyargs))
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        yield node.id
    elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        yield node.attr


def _positional(node: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.arg]:
    return [*node.args.posonlyargs, *node.args.args]


if __name__ == "__main__":
    counted = count_package()
    print(json.dumps(counted, indent=1))
    if "--update" in sys.argv:
        before = json.loads(RECORD.read_text()) if RECORD.exists() else counted
        lowest = {name: min(count, before.get(name, count)) for name, count in counted.items()}
        RECORD.write_text(json.dumps(lowest, indent=1) + "\n")
