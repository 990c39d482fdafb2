"""What the service really sends about a map: the examples of the OpenAPI document."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from rholoc.geometry import Camera
from rholoc.maps import Correction, CorrectionKind, MapNames, MapWaypoint, NamedArea, NamedPoint, Source
from rholoc.reports import (
    Advice,
    AdviceKind,
    CoachingReport,
    CoverageReport,
    ExpectedError,
    HeldOutReport,
    MapReport,
    TrajectoryReport,
    WalkFigures,
)

SOURCE = Source(
    name="walk-1",
    id="8f1d3a5c7b9e0246",
    camera=Camera(640, 480, 525.5, 525.5, 320.0, 240.0),
    frames=900,
    posed=118,
    views=60,
    held_out=11,
    poses="visual-inertial",
)

WAYPOINT = MapWaypoint("W1", (0.0, 0.0, 1.5), residual_m=0.01)

NAMES = MapNames(
    points=(NamedPoint("charger", (0.2, 3.1, 0.0)),),
    areas=(NamedArea("kitchen", ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (0.0, 3.0))),),
)

CORRECTION = Correction(
    version=2,
    kind=CorrectionKind.ORIGIN,
    created="2026-01-06T09:30:00+00:00",
    scale=1.0,
    rotation=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    translation=(-1.2, -0.4, 0.0),
)

REPORT = MapReport(
    features=5120,
    descriptors=6200,
    views=60,
    views_per_feature_median=6.0,
    features_per_view_median=640.0,
    landmark_sigma_median_m=0.006,
    landmark_sigma_p90_m=0.017,
    coverage=CoverageReport(
        share_sufficient=0.75,
        positions_sufficient=1.0,
        median=118.0,
        sufficient=60,
        origin=(-0.25, 0.0, 1.5),
        axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        step=0.25,
        pitch_deg=-3.0,
        headings_deg=(0.0, 90.0, 180.0, 270.0),
        cells=((0, 0), (1, 0)),
        counts=((204, 118, 40, 131), (210, 122, 31, 98)),
    ),
    held_out=HeldOutReport(
        frames=3,
        localized=2,
        median_m=0.006,
        p90_m=0.007,
        median_deg=0.11,
        recall_5cm_5deg=0.6667,
        recall_10cm_5deg=0.6667,
        errors_m=(0.00512, 0.00688, None),
        errors_deg=(0.0981, 0.1219, None),
        confidences=(0.9981, 0.9974, 0.2102),
    ),
    expected_error=ExpectedError(rms_m=0.014, worst_m=0.021, worst_time_s=17.2, views_m=(0.011, 0.021, None)),
    trajectories=(
        TrajectoryReport(
            method="visual-inertial",
            frames=118,
            trusted=True,
            why="Two reconstructions agree.",
            up="The accelerometer measured gravity to 0.3°.",
            scale="The waypoints fix the scale.",
            keyframes=120,
            landmarks=9120,
            reprojection_error_px=0.61,
            waypoints_tilt_deg=0.4,
            waypoint_times_s={"W1": 1.2, "W2": 9.8, "E": 29.1},
            waypoint_residuals_m={"W1": 0.01, "W2": 0.02, "E": 0.01},
        ),
    ),
    coaching=(
        CoachingReport(
            recording="walk-1",
            figures=WalkFigures(turn_deg_s=61.0, brightness=112.0, bare_share=0.02, pauses=3, waypoints=3),
            advice=(
                Advice(
                    AdviceKind.TOO_FAST,
                    "Turn slower: a tenth of the walk was above 61°/s; above 50 pictures blur.",
                    figure=61.0,
                    limit=50.0,
                ),
            ),
        ),
    ),
)


def sent(value: object) -> Any:
    """A dataclass as it is serialized in a response."""
    return TypeAdapter(type(value)).dump_python(value, mode="json")
