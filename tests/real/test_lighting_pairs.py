"""Extractors on real pairs of lights: which of them keeps what it saw."""

from pathlib import Path

import pytest

from rholoc_lab.evaluation.lighting_pairs import compare_lighting_pairs

pytestmark = pytest.mark.real


@pytest.mark.slow
def test_colour_wins_where_the_light_changes_colour_and_grey_where_it_dims(real_data: Path) -> None:
    found = compare_lighting_pairs(real_data / "lighting_pairs")
    precision = {
        (p.scene, p.features): p.registered.precision for p in found if p.registered and p.registered.precision
    }
    # a warm spot against cool light
    assert precision["djembe", "lab"] > precision["djembe", "lab3"] > 1.4 * precision["djembe", "gray"]
    assert precision["djembe", "lab"] > precision["djembe", "sift"]
    # the lamp on and off
    assert precision["piano", "gray"] > precision["piano", "lab"]
    assert precision["piano", "sift"] > 1.2 * max(precision["piano", name] for name in ("gray", "rgb", "lab", "lab3"))
    # art has only the stereo pair
    assert all((p.registered is None) == (p.scene == "art") for p in found)
    assert all(p.stereo_precision is not None and 0.2 < p.stereo_precision < 0.6 for p in found)
