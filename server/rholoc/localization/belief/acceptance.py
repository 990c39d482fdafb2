"""Withhold poses whose place is too doubtful, or that are less exact than the query demands."""

from dataclasses import replace

from rholoc.localization.diagnosis import too_inexact
from rholoc.localization.index.map_error import worst_sigma
from rholoc.localization.types import MAX_ALTERNATIVES, MIN_WEIGHT, Alternative, Localization, Query, Reason


def gated(answer: Localization, min_recognized: float, query: Query) -> Localization:
    """Withhold the pose if the place is too doubtful, or the pose less exact than the query demands.

    Args:
        answer: an answer with or without a pose; one without is returned unchanged.
        min_recognized: minimum probability of the right place.
        query: its ``max_sigma_m`` and ``max_sigma_rad`` bound the standard deviations along the worst axes.

    Returns:
        The answer, or one that is not localized, with reason NOT_RECOGNIZED (the pose becomes its first alternative) or
        TOO_INEXACT (with a diagnosis).
    """
    if answer.pose is None or answer.covariance is None:
        return answer
    refused = replace(answer, localized=False, pose=None, covariance=None, expected_error_m=None)
    if answer.recognized < min_recognized:
        withheld = Alternative(answer.recognized, answer.pose, answer.covariance, answer.inlier_features)
        poses = (withheld, *answer.alternatives) if withheld.weight >= MIN_WEIGHT else answer.alternatives
        return replace(refused, reason=Reason.NOT_RECOGNIZED, alternatives=poses[:MAX_ALTERNATIVES])
    sigma_m, sigma_rad = worst_sigma(answer.covariance[:3, :3]), worst_sigma(answer.covariance[3:, 3:])
    if sigma_m <= query.max_sigma_m and sigma_rad <= query.max_sigma_rad:
        return answer
    diagnosis = too_inexact(sigma_m, sigma_rad, query.max_sigma_m, query.max_sigma_rad)
    return replace(refused, reason=Reason.TOO_INEXACT, diagnosis=diagnosis)
