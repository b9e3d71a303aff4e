"""Study of a scan alone: its contact regions, without a robot or a path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from climbplan.errors import SpecError
from climbplan.scan.cleaning import compute_areas
from climbplan.scan.contact_regions import FoundRegion, find_contact_regions
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
        """The area of the raw surface [m^2]."""
        return float(compute_areas(self.raw).sum())

    @property
    def found_area(self) -> float:
        """The area of all regions, which overlap on curved surfaces [m^2]."""
        return sum(region.area for region in self.regions)

    @property
    def headline(self) -> str:
        """A one-line summary of the result."""
        return (
            f"{len(self.raw.triangles)} triangles of {self.area:.3g} m^2, "
            f"{len(self.regions)} contact regions of {self.found_area:.3g} m^2 within "
            f"{1e3 * self.scan.flatness:g} mm"
        )


def build_scan_spec(file: Path, settings: Sequence[str]) -> ScanSpec:
    """Build the keys of `terrain.scan` for a file, with some set.

    Args:
        file: The scan.
        settings: Overrides, KEY=VALUE.

    Raises:
        SpecError: A setting is wrong.
    """
    text = write_yaml({"file": str(file)})
    document = apply_overrides(parse_yaml(text, str(file)), list(settings))
    scan, findings = validate(document, ScanSpec)
    if scan is None or findings:
        raise SpecError(str(file), document.mistakes(findings))
    return scan


def fit(scan: ScanSpec, report: Callable[[float], None]) -> FittedScan:
    """Read a scan and find its regions.

    Args:
        scan: Its keys.
        report: Called with the fraction that is done.

    Raises:
        ScanError: There is no contact region.
    """
    report(0.0)
    raw = read_scan(scan, Path())
    report(0.2)
    regions = find_contact_regions(raw, scan)
    report(1.0)
    if not regions:
        raise ScanError(
            f"{scan.file}: no contact region in it, expected flat places at least "
            f"{1e3 * scan.min_size:g} mm wide within {1e3 * scan.flatness:g} mm; larger ones of "
            "either: --set flatness=..., --set least_size=..."
        )
    return FittedScan(scan, raw, regions)
