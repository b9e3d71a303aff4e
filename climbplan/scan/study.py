"""A scan on its own: what is found in it, without a robot or a way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.scan.cleaning import areas
from climbplan.scan.fitting import FoundRegion, found_regions
from climbplan.scan.raw import RawScan, ScanError
from climbplan.scan.reading import read_scan
from climbplan.schema.kinds import validate
from climbplan.schema.overrides import apply_overrides
from climbplan.schema.terrain.scan import ScanSpec
from climbplan.schema.yaml_source import parse_yaml, write_yaml


@dataclass(frozen=True)
class FittedScan:
    """A scan and its contact regions, largest first."""

    scan: ScanSpec
    raw: RawScan
    regions: tuple[FoundRegion, ...]

    @property
    def area(self) -> float:
        """Of the raw surface [m^2]."""
        return float(areas(self.raw).sum())

    @property
    def found_area(self) -> float:
        """Of all regions; on curved surfaces they overlap [m^2]."""
        return sum(region.area for region in self.regions)

    @property
    def headline(self) -> str:
        """What was found, in a line."""
        return (
            f"{len(self.raw.triangles)} triangles of {self.area:.3g} m^2, "
            f"{len(self.regions)} contact regions of {self.found_area:.3g} m^2 within "
            f"{1e3 * self.scan.flatness:g} mm"
        )


def scan_of(file: Path, settings: Sequence[str]) -> ScanSpec:
    """The keys of `terrain.scan` for a file, with some set; raises SpecError."""
    text = write_yaml({"file": str(file)})
    document = apply_overrides(parse_yaml(text, str(file)), list(settings))
    scan, findings = validate(document, ScanSpec)
    if scan is None or findings:
        raise SpecError(str(file), document.mistakes(findings))
    return scan


def fit(scan: ScanSpec, report: Callable[[float], None]) -> FittedScan:
    """Read a scan and find its regions; raises ScanError.

    report: called with the share that is done.
    """
    report(0.0)
    raw = read_scan(scan, Path())
    report(0.2)
    regions = found_regions(raw, scan)
    report(1.0)
    if not regions:
        raise ScanError(
            f"{scan.file}: no contact region in it, expected flat places at least "
            f"{1e3 * scan.min_size:g} mm wide within {1e3 * scan.flatness:g} mm; larger ones of "
            "either: --set flatness=..., --set least_size=..."
        )
    return FittedScan(scan, raw, regions)
