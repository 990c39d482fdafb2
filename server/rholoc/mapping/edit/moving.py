"""Move a map to another frame: every answer moves by exactly the transform."""

from dataclasses import replace

import numpy as np

from rholoc.density import FORMS
from rholoc.errors import InvalidInput
from rholoc.geometry import FloatArray, Similarity, poses_from_rows, rows_from_poses
from rholoc.mapping.build.view_covariance import storable_covariances
from rholoc.maps import Map, MapInfo, MapNames, moved_patches, validate_map
from rholoc.reports import HeldOutReport, LearningReport, MapReport, TrajectoryReport

_FARTHEST_M = 10_000.0  # from the origin: single precision still resolves a millimetre there


def move_map(map_: Map, similarity: Similarity) -> Map:
    """The map in the frame after a similarity: landmarks, views, measured ranges, cloud, room, densities, places and
    reported lengths.

    Nothing is estimated again, and the version stays. The caller updates the report's coverage.

    Raises:
        InvalidInput: a part of the map would be more than 10 km from the origin.
    """
    positions = similarity.points(map_.landmarks.positions.astype(np.float64)).astype(np.float32)
    T_map_camera = similarity.poses(map_.views.T_map_camera)
    cloud = map_.cloud.moved(similarity)
    room = map_.room.moved(similarity)
    _check_near(positions, T_map_camera[:, :3, 3], cloud.positions, room.vertices.positions)
    covariances, R = map_.landmarks.covariances.astype(np.float64), similarity.rotation
    turned = similarity.scale**2 * R @ covariances @ R.T
    densities = FORMS[map_.info.density].from_arrays(map_.densities.moved(similarity).arrays(), positions)
    info, of_views = _moved_info(map_.info, similarity), map_.views.covariances
    second, ranges_m = map_.views.second_positions, map_.observations.ranges_m
    moved = replace(
        map_,
        info=info,
        plan=b"" if info.plan is None else map_.plan,
        landmarks=replace(
            map_.landmarks,
            positions=positions,
            covariances=((turned + turned.transpose(0, 2, 1)) / 2).astype(np.float32),
            patches=moved_patches(map_.landmarks.patches, similarity),
        ),
        views=replace(
            map_.views,
            T_map_camera=poses_from_rows(rows_from_poses(T_map_camera).astype(np.float32)),  # as files keep them
            covariances=None
            if of_views is None
            else storable_covariances(similarity.covariances(of_views.astype(np.float64))),
            second_positions=None if second is None else similarity.points(second).astype(np.float32),
        ),
        observations=replace(
            map_.observations,
            ranges_m=None if ranges_m is None else (similarity.scale * ranges_m).astype(np.float32),
        ),
        cloud=cloud,
        room=room,
        densities=densities,
    )
    validate_map(moved)
    return moved


def moved_names(names: MapNames, similarity: Similarity) -> MapNames:
    """Points and areas in the frame after a similarity, their names unchanged; corners of areas are taken at z = 0."""
    return MapNames(
        tuple(replace(point, position=_moved(point.position, similarity)) for point in names.points),
        tuple(
            replace(area, outline=tuple(_moved((*corner, 0.0), similarity)[:2] for corner in area.outline))
            for area in names.areas
        ),
    )


def _check_near(*positions: FloatArray) -> None:
    """Raise InvalidInput if a coordinate of any of the positions (N, 3) is beyond ±10 km."""
    if any(len(one) and np.abs(one).max() > _FARTHEST_M for one in positions):
        raise InvalidInput(
            f"Some of the map would lie more than {_FARTHEST_M / 1000:g} km from the origin.",
            "Choose an origin nearby: far from it, positions are not exact to a millimetre.",
        )


def _moved(position: tuple[float, float, float], similarity: Similarity) -> tuple[float, float, float]:
    """A position in the frame after a similarity."""
    x, y, z = similarity.points(np.array([position], dtype=np.float64))[0].tolist()
    return x, y, z


def _moved_info(info: MapInfo, similarity: Similarity) -> MapInfo:
    """The description with waypoints, names, floor plan, pose on Earth and reported lengths after a similarity."""
    scale = similarity.scale
    waypoints = tuple(
        replace(waypoint, position=_moved(waypoint.position, similarity), residual_m=_times(waypoint.residual_m, scale))
        for waypoint in info.waypoints
    )
    names = moved_names(info.names, similarity)
    plan = None if info.plan is None else info.plan.moved(similarity)
    earth = None if info.earth is None else info.earth.moved(similarity)
    return replace(
        info, waypoints=waypoints, names=names, plan=plan, earth=earth, report=_scaled_report(info.report, scale)
    )


def _scaled_report(report: MapReport, scale: float) -> MapReport:
    """A report with the lengths in ``held_out``, ``trajectories`` and ``learned`` multiplied by ``scale``, and recalls
    counted anew. The map's statistics are left as they are.
    """
    if scale == 1.0:
        return report
    return replace(
        report,
        held_out=None if report.held_out is None else _scaled_held_out(report.held_out, scale),
        trajectories=tuple(_scaled_trajectory(one, scale) for one in report.trajectories),
        learned=tuple(_scaled_lesson(one, scale) for one in report.learned),
    )


def _scaled_lesson(report: LearningReport, scale: float) -> LearningReport:
    """The report with its lengths multiplied by ``scale``."""
    queries = report.queries and replace(
        report.queries,
        median_before_m=_times(report.queries.median_before_m, scale),
        median_after_m=_times(report.queries.median_after_m, scale),
    )
    return replace(report, residual_median_m=_times(report.residual_median_m, scale), queries=queries)


def _scaled_held_out(report: HeldOutReport, scale: float) -> HeldOutReport:
    """The report with its distances multiplied by ``scale``, and the recalls counted anew."""
    errors_m = None if report.errors_m is None else tuple(_times(error, scale) for error in report.errors_m)
    return replace(
        report,
        median_m=_times(report.median_m, scale),
        p90_m=_times(report.p90_m, scale),
        errors_m=errors_m,
        recall_5cm_5deg=_recall(report, errors_m, 0.05),
        recall_10cm_5deg=_recall(report, errors_m, 0.10),
    )


def _recall(report: HeldOutReport, errors_m: tuple[float | None, ...] | None, within_m: float) -> float | None:
    """Share of held-out frames within ``within_m`` and 5°; None if their errors are not known."""
    if errors_m is None or report.errors_deg is None or not report.frames:
        return None
    pairs = zip(errors_m, report.errors_deg, strict=False)
    return sum(m is not None and deg is not None and m < within_m and deg < 5 for m, deg in pairs) / report.frames


def _scaled_trajectory(report: TrajectoryReport, scale: float) -> TrajectoryReport:
    """The report with its lengths multiplied by ``scale``."""
    residuals, inertial = report.waypoint_residuals_m, report.inertial
    if inertial is not None:
        inertial = replace(inertial, rms_m=_times(inertial.rms_m, scale), worst_m=_times(inertial.worst_m, scale))
    return replace(
        report,
        waypoint_residuals_m=residuals and {name: _times(value, scale) for name, value in residuals.items()},
        expected_error_m=_times(report.expected_error_m, scale),
        inertial=inertial,
    )


def _times(value: float | None, scale: float) -> float | None:
    """``value`` × ``scale``; None for None."""
    return None if value is None else value * scale
