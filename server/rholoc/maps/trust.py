"""Whether a map is to be trusted, by what it reports of the trajectories that it was built on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rholoc.maps.map import MapInfo


@dataclass(frozen=True)
class Trust:
    """Whether a map's frame poses passed every check.

    Attributes:
        trusted: None where the map does not say: it came as a table, or its report is not ours.
        reasons: which checks failed, one line each; why the poses are trusted, where they are.
    """

    trusted: bool | None
    reasons: tuple[str, ...]

    @property
    def reason(self) -> str:
        """All reasons in one line."""
        return " ".join(self.reasons)


def trust_of(info: MapInfo) -> Trust:
    """What a map's report says; the report came with the file, and may say anything."""
    reports = [report for report in _list(info.report.get("trajectories")) if isinstance(report, dict)]
    learned = [report for report in _list(info.report.get("learned")) if isinstance(report, dict)]
    said = [report for report in (*reports, *learned) if isinstance(report.get("trusted"), bool)]
    if not any(isinstance(report.get("trusted"), bool) for report in reports):
        return Trust(None, ("The map does not say how its frame poses were checked.",))
    trusted = all(report["trusted"] for report in said)
    whys = [str(report.get("why", "")) for report in said if report["trusted"] is trusted]
    return Trust(trusted, tuple(dict.fromkeys(why for why in whys if why)))


def expected_error_m(info: MapInfo) -> float | None:
    """How far a map's poses are expected to be from the truth (root mean square, metres); None where not known."""
    return reported_metres(info, "expected_error", "rms_m")


def reported_metres(info: MapInfo, section: str, name: str) -> float | None:
    """A length of a metric map's report; the report came with the file, and may say anything."""
    figures = info.report.get(section)
    value = figures.get(name) if isinstance(figures, dict) else None
    if not info.metric or isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []
