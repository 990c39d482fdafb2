"""Report on a map."""

from dataclasses import dataclass

from rholoc.reports.trajectory import TrajectoryReport
from rholoc.reports.walk import CoachingReport


@dataclass(frozen=True)
class CoverageReport:
    """Number of landmarks in view of a camera, by position and heading.

    Attributes:
        share_sufficient: the share of positions and headings that see enough landmarks to localize.
        positions_sufficient: the share of positions where some heading does.
        median: landmarks in view, over positions and headings.
        sufficient: how many landmarks are enough.
        origin: (3,) the position of cell (0, 0), metres, map frame.
        axes: (2, 3) unit vectors of a cell's first and second index.
        step: between cells, metres.
        pitch_deg: how far the camera looks above the plane.
        headings_deg: (H,) from the first axis towards the second.
        cells: (C, 2) numbers of the cells.
        counts: (C, H) landmarks in view.
    """

    share_sufficient: float
    positions_sufficient: float
    median: float
    sufficient: int
    origin: tuple[float, ...]
    axes: tuple[tuple[float, ...], ...]
    step: float
    pitch_deg: float
    headings_deg: tuple[float, ...]
    cells: tuple[tuple[int, ...], ...]
    counts: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class HeldOutReport:
    """Frames that were held out while the map was built, localized in it: how consistent it is.

    Compared with the trajectory's own poses, so an error of the trajectory as a whole is not seen.

    Attributes:
        frames: how many.
        localized: how many of them got a pose.
        median_m, p90_m, median_deg: of the differences; None where no frame got a pose.
        recall_5cm_5deg, recall_10cm_5deg: the share of all frames within both limits.
        errors_m, errors_deg: of each frame; None where it got no pose.
        confidences: 0..1, of each frame.
    """

    frames: int
    localized: int
    median_m: float | None
    p90_m: float | None
    median_deg: float | None = None
    recall_5cm_5deg: float | None = None
    recall_10cm_5deg: float | None = None
    errors_m: tuple[float | None, ...] | None = None
    errors_deg: tuple[float | None, ...] | None = None
    confidences: tuple[float, ...] | None = None


@dataclass(frozen=True)
class ExpectedError:
    """Expected error of the map's views.

    Attributes:
        rms_m: of all views whose uncertainty is known, root mean square, metres.
        worst_m: of the worst.
        worst_time_s: the time of that view.
        views_m: of each view in order; None where it is not known.
    """

    rms_m: float
    worst_m: float | None = None
    worst_time_s: float | None = None
    views_m: tuple[float | None, ...] | None = None


@dataclass(frozen=True)
class QueriesReport:
    """What a map learned from answered queries.

    Attributes:
        kept: how many were kept for it.
        sure: how many of them it was sure of when it was asked anew.
        contradicted: how many of those it did not believe at first: others do not see what they rest on.
        askers: how many asked them.
        occasions: on how many occasions.
        features_forgotten: how many features many of them should have seen and did not.
        held_back: how many it did not learn from, but was asked before and after.
        recall_before, recall_after: the share of those, whole and by halves, that were found within 5 cm and 5°.
        median_before_m, median_after_m: of the errors of those found; None where none was.
    """

    kept: int
    sure: int
    askers: int
    occasions: int
    features_forgotten: int
    held_back: int
    recall_before: float
    recall_after: float
    median_before_m: float | None
    median_after_m: float | None
    contradicted: int = 0


@dataclass(frozen=True)
class LearningReport:
    """One version of a map: what it learned or forgot. Members that do not apply are None.

    Attributes:
        version: of the map.
        source: the id of the recording that was learned.
        merged: the id of the map that was merged.
        forgotten: the id of the recording that was forgotten.
        frames_tried: frames that were looked for in the map.
        frames_found: how many of them were found.
        residual_median_m, residual_median_deg: of the frames found against the aligned trajectory or map.
        scale: of the alignment.
        trusted: whether the recording's own trajectory passed every check.
        why: one line on that.
        views: how many views the recording added.
        features_seen_again: features of the map that it shows.
        features_in_both: features that both maps had.
        features_new: features that it added.
        coaching: about the recording.
        queries: what it learned from, where that was queries.
    """

    version: int
    source: str | None = None
    merged: str | None = None
    forgotten: str | None = None
    frames_tried: int | None = None
    frames_found: int | None = None
    residual_median_m: float | None = None
    residual_median_deg: float | None = None
    scale: float | None = None
    trusted: bool | None = None
    why: str | None = None
    views: int | None = None
    features_seen_again: int | None = None
    features_in_both: int | None = None
    features_new: int | None = None
    coaching: CoachingReport | None = None
    queries: QueriesReport | None = None


@dataclass(frozen=True)
class MapReport:
    """What a map found out about itself. Figures are None for maps that were not built from recordings.

    Attributes:
        features, descriptors, views: how many there are.
        views_per_feature_median: in how many views a feature was seen.
        features_per_view_median: how many features a view saw.
        landmark_sigma_median_m, landmark_sigma_p90_m: of the landmarks' standard deviations, RMS over the axes.
        coverage: where the map works.
        held_out: how consistent it is.
        expected_error: how far it expects to be off.
        trajectories: of the recordings that it was built from.
        coaching: about the same recordings.
        learned: what it has learned or forgotten since, by version.
    """

    features: int | None = None
    descriptors: int | None = None
    views: int | None = None
    views_per_feature_median: float | None = None
    features_per_view_median: float | None = None
    landmark_sigma_median_m: float | None = None
    landmark_sigma_p90_m: float | None = None
    coverage: CoverageReport | None = None
    held_out: HeldOutReport | None = None
    expected_error: ExpectedError | None = None
    trajectories: tuple[TrajectoryReport, ...] = ()
    coaching: tuple[CoachingReport, ...] = ()
    learned: tuple[LearningReport, ...] = ()
