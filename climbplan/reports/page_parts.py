"""What the HTML pages of all kinds of plan are made of."""

from __future__ import annotations

import base64
import hashlib
import html
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from climbplan.reports import palette

Rows = Iterable[tuple[str, str]]


def read_part(name: str) -> str:
    """The text of a file in page/."""
    return files("climbplan.reports").joinpath("page").joinpath(name).read_text(encoding="utf-8")


def escape(value: object) -> str:
    """Text as markup shows it."""
    return html.escape(str(value), quote=True)


def policy(scripts: Iterable[str]) -> str:
    """A content policy that allows these inline scripts, no others, and no network at all."""
    digests = (hashlib.sha256(text.encode()).digest() for text in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(d).decode()}'" for d in digests) or "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; "
        "img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'"
    )


@dataclass(frozen=True)
class Card:
    """One key figure: what it is, its value, and where or of what."""

    label: str
    value: str
    detail: str = ""

    def html(self) -> str:
        """The card as markup."""
        detail = f"<small>{escape(self.detail)}</small>" if self.detail else ""
        return f"<div><dt>{escape(self.label)}</dt><dd>{escape(self.value)}{detail}</dd></div>"


def pairs(rows: Rows) -> str:
    """Table rows of a name and a value."""
    return "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in rows)


def _shown(number: float | None) -> str:
    return "not finite" if number is None else f"{number:.2e}" if number else "0"


def check_rows(report: Mapping[str, Any], meanings: Mapping[str, str]) -> str:
    """Verification as table rows, failed ones first. meanings: of the checks, by name."""
    rows = []
    order = ("failed", "not judged", "passed")
    for check in sorted(report["verification"], key=lambda check: order.index(check["result"])):
        mark = check["result"]
        known = meanings.get(check["name"], "")
        meaning = f"<small>{escape(known)}</small>" if known else ""
        unit = f" {check['unit']}" if check["unit"] else ""
        where = " · ".join(part for part in (check["margin"], check["worst_at"]) if part)
        rows.append(
            f'<tr class="{mark.replace(" ", "-")}"><td><span class="mark">{mark}</span></td>'
            f"<th>{escape(check['name'])}{meaning}</th>"
            f"<td>{escape(_shown(check['residual']) + unit)}</td>"
            f"<td>{escape(_shown(check['limit']) + unit)}</td>"
            f"<td>{escape(where)}</td></tr>"
        )
    return "".join(rows)


def sequence_section(report: Mapping[str, Any]) -> str:
    """All contact sequences that a search found, as a table; nothing where there was none."""
    found = report.get("sequences")
    if not found:
        return ""

    def factor(value: float | None) -> str:
        return "no load" if value is None else f"{value:.2f}"

    rows = "".join(
        f"<tr><th>{escape(row['name'])}</th><td>{row['cost']:.5f}</td>"
        f"<td>{factor(row['safety_torque'])}</td><td>{factor(row['safety_friction'])}</td>"
        f"<td>{escape(row['outcome'])}</td></tr>"
        for row in found
    )
    return (
        "<h3>Contact sequences found</h3>"
        f"<p class='note'>{len(found)} of so many rounds; safety factors are the largest each "
        "allows on the poses searched.</p>"
        "<div class='scroll'><table><thead><tr><th>sequence</th><th>cost</th><th>Sτ</th>"
        f"<th>Sμ</th><th></th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def verdict(report: Mapping[str, Any]) -> str:
    """How the verification went, in a sentence."""
    checks = report["verification"]
    failed = [check["name"] for check in checks if not check["passed"]]
    told = [check["name"] for check in checks if check["passed"] and not check["judged"]]
    if not failed and told:
        judged = len(checks) - len(told)
        return escape(f"All {judged} checks passed that are judged; not judged: {', '.join(told)}.")
    if not failed:
        return escape(f"All {len(checks)} checks passed.")
    return escape(f"{len(failed)} of {len(checks)} checks failed: {', '.join(failed)}.")


def implausible_list(report: Mapping[str, Any]) -> str:
    """Data and deflections that no such robot has, above everything else."""
    words = "".join(f"<li>{escape(text)}</li>" for text in report.get("implausible", ()))
    if not words:
        return ""
    return (
        '<div class="notice implausible" role="alert"><b>Implausible: is the data meant so?</b>'
        f"<ul>{words}</ul></div>\n"
    )


def left_out_list(report: Mapping[str, Any]) -> str:
    """What the badge leaves out, and which margins are not kept."""
    return _listed("This leaves out:", report.get("leaves_out", ())) + _listed(
        "Fragile: not all margins could be kept.", report.get("fragile", ())
    )


def _listed(title: str, texts: Iterable[str]) -> str:
    words = "".join(f"<li>{escape(text)}</li>" for text in texts)
    if not words:
        return ""
    return f'<p class="left-out">{title}</p><ul class="left-out">{words}</ul>\n'


def plain_words(value: object) -> str:
    """A size or count of any shape as words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {plain_words(v)}" for k, v in value.items())
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(plain_words(v) for v in value)
    return str(value)


def figures(images: Mapping[str, bytes]) -> str:
    """Pictures as data, with their names as captions."""
    return "".join(
        f'<figure><img alt="{escape(name)}" src="data:image/png;base64,'
        f'{base64.b64encode(image).decode()}"></figure>'
        for name, image in images.items()
    )


def style() -> str:
    """The style sheet with the colours of the figures."""
    colors = {
        "failure": palette.FAILURE,
        "force": palette.FORCE,
        "surface": palette.SURFACE,
        "obstacle": palette.OBSTACLE,
    }
    own = "".join(f"--{name}:{color};" for name, color in colors.items())
    return f":root{{{own}}}\n" + read_part("style.css")
