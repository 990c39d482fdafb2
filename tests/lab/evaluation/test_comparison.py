"""The comparison on walks along a wall: every method answers, and right."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rholoc.evaluation.errors import PoseErrors
from rholoc.pictures.trajectories import save_figure
from rholoc_lab.evaluation.compare import RETRIEVAL, CompareOptions, Comparison, MethodResult, compare
from rholoc_lab.evaluation.lighting import compare_lights
from rholoc_lab.evaluation.splits import QuerySet
from rholoc_lab.pictures.comparison import plot_error_by_distance, plot_errors_from_above, plot_recall
from rholoc_lab.pictures.lighting import plot_lights


@pytest.fixture(scope="module")
def compared(made_once: Any, wall: Any) -> Comparison:
    return made_once("compared", lambda: _compared(wall))


def _compared(wall: Any) -> Comparison:
    near, far = wall.walk(9), wall.walk(9, away_m=2.2)
    sets = [QuerySet("near", near, np.array([1, 3, 5])), QuerySet("far", far, np.array([2, 6]))]
    return compare([wall.walk(14)], sets, CompareOptions(features="gray"))


@pytest.mark.slow
def test_all_methods_find_the_poses(compared: Comparison) -> None:
    names = [method.name for method in compared.splits[0].methods]
    assert names[:2] == ["ray", "tensor"]
    assert names[-1] == RETRIEVAL
    assert len(names) == len(set(names)) == 3 + 2 * 3 * 2
    for split, count in zip(compared.splits, (3, 2), strict=True):
        for method in split.methods:
            assert method.T_map_camera.shape == (count, 4, 4)
            assert method.errors.position_m.max() < 0.05, method.name
            assert np.degrees(method.errors.rotation_rad).max() < 1, method.name


@pytest.mark.slow
def test_figures_are_json_and_name_every_stage(compared: Comparison) -> None:
    figures = json.loads(json.dumps(compared.as_dict()))
    near = figures["queries"][0]
    assert (near["label"], near["frames"]) == ("near", 3)
    by_name = {method["method"]: method for method in near["methods"]}
    assert by_name["ray"]["recall"] == {"2cm_2deg": 1, "5cm_5deg": 1, "10cm_5deg": 1, "25cm_10deg": 1}
    assert set(by_name["cv2, place"]["median_ms"]) == {"match", "solve", "total"}
    assert set(by_name["poselib, distinct + density"]["median_ms"]) == {"match", "solve", "ascend", "total"}
    assert set(by_name[RETRIEVAL]["median_ms"]) == {"retrieve", "match", "solve", "total"}
    assert {"match", "seed", "verify", "total"} <= set(by_name["ray"]["median_ms"])
    assert by_name["tensor"]["map_bytes"] > by_name["ray"]["map_bytes"] == by_name["cv2, place"]["map_bytes"] > 0


@pytest.mark.slow
def test_the_farther_walk_is_farther_from_the_views(compared: Comparison) -> None:
    near, far = compared.splits
    assert near.view_distance.max() < 0.15
    assert far.view_distance == pytest.approx(np.full(2, 0.2), abs=0.1)
    assert far.view_distance.min() > 0.19


def test_failures_count_in_every_figure() -> None:
    T = np.full((4, 4, 4), np.nan)
    T[:2] = np.eye(4)
    errors = PoseErrors(np.array([0.01, 0.6, np.inf, np.inf]), np.array([0.0, 0.0, np.inf, np.inf]))
    timings: tuple[dict[str, float], ...] = ({"match": 1.0, "ascend": 2.0}, {"match": 3.0}, {"match": 3.0}, {})
    figures = MethodResult("ray", T, errors, timings, 10).figures()
    assert figures["recall"] == {"2cm_2deg": 0.25, "5cm_5deg": 0.25, "10cm_5deg": 0.25, "25cm_10deg": 0.25}
    assert (figures["no_pose"], figures["wrong_pose"]) == (2, 1)
    assert figures["median_cm"] is None
    assert figures["median_ms"] == {"match": 2.0, "ascend": 0.0, "total": 3.0}


@pytest.mark.slow
def test_plots_name_their_methods(compared: Comparison, tmp_path: Path) -> None:
    split = compared.splits[0]
    plots = [plot_recall(split), plot_error_by_distance(split), plot_errors_from_above(compared, split)]
    for number, figure in enumerate(plots):
        save_figure(figure, tmp_path / f"{number}.png")
        assert cv2.imread(str(tmp_path / f"{number}.png")) is not None
    legends = [{t.get_text() for t in axes.get_legend().get_texts()} for axes in plots[0].axes if axes.get_legend()]
    assert {"ray", "tensor", RETRIEVAL, "cv2, place"} <= legends[0]
    assert {"ray", "poselib, everywhere + density"} <= legends[1]
    assert legends[0] | legends[1] == {method.name for method in split.methods}


@pytest.mark.slow
def test_lights_are_compared_by_true_geometry(wall: Any, tmp_path: Path) -> None:
    warm = (0.5, 0.8, 1.0)
    maps = {"white": wall.walk(8), "warm": wall.walk(8, light=warm)}
    queries = {"white": wall.walk(2, 2.2), "warm": wall.walk(2, 2.2, light=warm)}
    pairs = compare_lights(maps, queries, wall.points_seen, ["gray"])
    assert [(pair.map_light, pair.query_light) for pair in pairs] == [
        ("white", "white"), ("white", "warm"), ("warm", "white"), ("warm", "warm")
    ]  # fmt: skip
    for pair in pairs:
        assert pair.queries == 2
        assert pair.recall == 1
        assert pair.median_cm is not None
        assert pair.median_cm < 3
        precision, repeatability = pair.redetection.precision, pair.redetection.repeatability
        assert precision is not None
        assert repeatability is not None
        assert 0.4 < precision <= 1
        assert 0.4 < repeatability <= 1
    same, changed = pairs[0].redetection, pairs[1].redetection
    assert same.right > changed.right
    figure = plot_lights(pairs)
    assert figure.axes[0].get_title() == "gray"
    assert [label.get_text() for label in figure.axes[-1].get_xticklabels()] == ["white", "warm"]
    save_figure(figure, tmp_path / "lights.png")
    assert cv2.imread(str(tmp_path / "lights.png")) is not None
