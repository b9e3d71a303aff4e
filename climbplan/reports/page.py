"""The HTML page: one file that needs nothing else, and runs no script but its own."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from string import Template
from typing import Any

from climbplan.plans.checks.check import LIMITS
from climbplan.plans.climb_plan import ClimbPlan
from climbplan.reports import palette
from climbplan.reports.page_data import page_data

_PARTS = files("climbplan.reports").joinpath("page")
_SCRIPTS = ("scene.js", "charts.js", "main.js")

Rows = Iterable[tuple[str, str]]


def _escape(value: object) -> str:
    return html.escape(str(value), quote=True)


def _script_json(value: object) -> str:
    """JSON that cannot end the element it stands in."""
    return json.dumps(value, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _policy(scripts: Iterable[str]) -> str:
    """A content policy that allows these inline scripts, no others, and no network at all."""
    digests = (hashlib.sha256(text.encode()).digest() for text in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(d).decode()}'" for d in digests)
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
        detail = f"<small>{_escape(self.detail)}</small>" if self.detail else ""
        return f"<div><dt>{_escape(self.label)}</dt><dd>{_escape(self.value)}{detail}</dd></div>"


def _pairs(rows: Rows) -> str:
    return "".join(f"<tr><th>{_escape(k)}</th><td>{_escape(v)}</td></tr>" for k, v in rows)


def _millimetres(span: Mapping[str, float | None]) -> str:
    least, most = span["least"], span["most"]
    if least is None or most is None:
        return "unknown"
    return f"{1e3 * least:.1f} to {1e3 * most:.1f} mm"


def _factor(value: float | None) -> str:
    return "no load" if value is None else f"{value:.2f}"


def _cards(report: Mapping[str, Any]) -> Iterable[Card]:
    climb, safety, worst = report["climb"], report["safety"], report["worst_torque"]
    torque, friction, payload = safety["torque"], safety["friction"], report["load"]["payload"]
    minutes, seconds = divmod(round(climb["duration"]), 60)
    duration = f"in {minutes} min {seconds} s" if minutes else f"in {seconds} s"
    yield Card("Climb", f"{climb['height']:.2f} m up", f"{duration}, path {climb['path']:.2f} m")
    many = "" if climb["rounds"] == 1 else "s"
    gait = f"{climb['instants']} instants, {climb['limbs']} limbs"
    yield Card("Gait", f"{climb['rounds']} round{many}", gait)
    yield Card(
        "Least torque safety Sτ",
        _factor(torque["least"]),
        f"{torque['asked']:g} asked; {torque['limb']} {torque['joint']}, {torque['where']}",
    )
    yield Card(
        "Least friction safety Sμ",
        _factor(friction["least"]),
        f"{friction['asked']:g} asked; {friction['limb']}, {friction['where']}",
    )
    yield Card(
        "Highest joint torque",
        f"{worst['torque']:.1f} N m",
        f"limit {worst['max_torque']:g}; {worst['limb']} {worst['joint']}, {worst['where']}",
    )
    yield Card("Payload", "unknown" if payload is None else f"{payload:g} kg")
    yield Card("Body sag", _millimetres(report["sag"]), "below the planned pose")
    yield Card("Penetration", _millimetres(report["penetration"]), "of toe commands into the walls")
    yield Card("Cost", f"{report['objective']:.4g}", _bound(report))


def _bound(report: Mapping[str, Any]) -> str:
    text = "no bound" if report["bound"] is None else f"bound {report['bound']:.4g}"
    return text if report["gap"] is None else f"{text}, gap {100 * report['gap']:.2g} %"


def _shown(number: float | None) -> str:
    return "not finite" if number is None else f"{number:.2e}" if number else "0"


def _checks(report: Mapping[str, Any]) -> str:
    rows = []
    for check in sorted(report["verification"], key=lambda check: bool(check["passed"])):
        mark = "passed" if check["passed"] else "failed"
        known = LIMITS.get(check["name"])
        meaning = f"<small>{_escape(known.meaning)}</small>" if known is not None else ""
        unit = f" {check['unit']}" if check["unit"] else ""
        where = " · ".join(part for part in (check["margin"], check["worst_at"]) if part)
        rows.append(
            f'<tr class="{mark}"><td><span class="mark">{mark}</span></td>'
            f"<th>{_escape(check['name'])}{meaning}</th>"
            f"<td>{_escape(_shown(check['residual']) + unit)}</td>"
            f"<td>{_escape(_shown(check['limit']) + unit)}</td>"
            f"<td>{_escape(where)}</td></tr>"
        )
    return "".join(rows)


def _verdict(report: Mapping[str, Any]) -> str:
    """How the verification went, in a sentence."""
    checks = report["verification"]
    failed = [check["name"] for check in checks if not check["passed"]]
    if not failed:
        return _escape(f"All {len(checks)} checks passed.")
    return _escape(f"{len(failed)} of {len(checks)} checks failed: {', '.join(failed)}.")


def _plain(value: object) -> str:
    """A size or count of any shape as words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_plain(v)}" for k, v in value.items())
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(_plain(v) for v in value)
    return str(value)


def _figures(images: Mapping[str, bytes]) -> str:
    """Pictures as data, with their names as captions."""
    return "".join(
        f'<figure><img alt="{_escape(name)}" src="data:image/png;base64,'
        f'{base64.b64encode(image).decode()}"></figure>'
        for name, image in images.items()
    )


def _style() -> str:
    colors = {
        "failure": palette.FAILURE,
        "force": palette.FORCE,
        "surface": palette.SURFACE,
        "obstacle": palette.OBSTACLE,
    }
    own = "".join(f"--{name}:{color};" for name, color in colors.items())
    return f":root{{{own}}}\n" + _PARTS.joinpath("style.css").read_text(encoding="utf-8")


def build_page(plan: ClimbPlan, report: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """The page as text.

    report: as `report_dict` gives it. images: PNG files by name that the page shows as they are.
    """
    library = plotly_script()
    script = "\n".join(_PARTS.joinpath(name).read_text(encoding="utf-8") for name in _SCRIPTS)
    title = report["title"] or report["name"]
    warnings = "".join(f"<li>{_escape(text)}</li>" for text in report["warnings"])
    counts = [(stage, _plain(size)) for stage, size in report["sizes"].items()]
    timings = [(stage, f"{_plain(seconds)} s") for stage, seconds in report["timings"].items()]
    about = [
        ("Robot", report["robot"]["name"]),
        ("Created", report["created"]),
        ("climbplan", report["climbplan_version"]),
        ("Seed", report["seed"]),
        ("Spec SHA-256", report["spec_sha256"]),
    ]
    template = Template(_PARTS.joinpath("page.html").read_text(encoding="utf-8"))
    return template.substitute(
        policy=_policy([library, script]),
        style=_style(),
        title=_escape(title),
        name=_escape(report["name"]),
        robot=_escape(report["robot"]["name"]),
        status=_escape(report["status"]),
        badge="verified" if report["verified"] else "not verified",
        badge_class="good" if report["verified"] else "bad",
        cards="".join(card.html() for card in _cards(report)),
        warnings=f'<ul class="warnings">{warnings}</ul>' if warnings else "",
        checks=_checks(report),
        verdict=_verdict(report),
        figures=_figures(images),
        study="" if plan.study is not None else "hidden",
        timings=_pairs(timings),
        sizes=_pairs(counts),
        solvers=_pairs(report["solvers"].items()),
        about=_pairs((k, str(v)) for k, v in about),
        spec=_escape(plan.spec_text),
        data=_script_json(page_data(plan)),
        library=library,
        script=script,
    )


def plotly_script() -> str:
    """The charts' library from the installed plotly package."""
    path = files("plotly").joinpath("package_data").joinpath("plotly.min.js")
    text = path.read_text(encoding="utf-8")
    if "</script" in text.lower() or "<!--" in text:
        raise ValueError("plotly.min.js cannot be written into a page as it is")
    return text
