"""The top view shows what it is given."""

from pathlib import Path

import cv2
import numpy as np

from rholoc.geometry import Pose
from rholoc.maps.walks import walk_numbers
from rholoc.pictures.style import draw_views, figure_of
from rholoc.pictures.trajectories import plot_top_view, save_figure


def walk(n: int = 50) -> np.ndarray:
    angles = np.linspace(0, np.pi, n)
    return np.stack(
        [
            Pose.from_heading(np.array([np.cos(a), np.sin(a), 1.5]), np.array([-np.sin(a), np.cos(a), 0])).T_map_camera
            for a in angles
        ]
    )


def test_a_top_view_names_what_it_shows_and_keeps_its_proportions(tmp_path: Path) -> None:
    truth = walk()
    estimated = truth.copy()
    estimated[10:15] = np.nan
    landmarks = np.random.default_rng(0).uniform(-2, 2, (300, 3))
    figure = plot_top_view(estimated, truth, landmarks, [("W1", np.array([1.0, 0.0, 1.5]))], title="A walk")
    axes = figure.axes[0]
    legend = axes.get_legend()
    labels = " ".join(text.get_text() for text in legend.get_texts())
    for expected in ("true path", "estimated, 45 frames", "no pose, 5 frames", "300 landmarks", "waypoints"):
        assert expected in labels
    assert "W1" in [text.get_text() for text in axes.texts]
    assert axes.get_aspect() == 1
    save_figure(figure, tmp_path / "view.png")
    image = cv2.imread(str(tmp_path / "view.png"))
    assert image.std() > 5


def test_a_path_alone_can_be_drawn_and_so_can_one_without_any_pose(tmp_path: Path) -> None:
    save_figure(plot_top_view(walk()), tmp_path / "path.png")
    save_figure(plot_top_view(np.full((3, 4, 4), np.nan), walk(3)), tmp_path / "lost.png")
    save_figure(plot_top_view(np.full((3, 4, 4), np.nan)), tmp_path / "nothing.png")
    assert all((tmp_path / name).stat().st_size > 0 for name in ("path.png", "lost.png", "nothing.png"))


def test_the_same_plot_is_the_same_file(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        save_figure(plot_top_view(walk()), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_views_in_no_order_are_points_not_a_path() -> None:
    """The path of a shuffled set crossed the map from picture to picture."""
    places = walk()[:, :3, 3]
    shuffled = np.random.default_rng(0).permutation(places)
    for some, marks in ((places, ["None", "o"]), (shuffled, ["."])):
        axes = figure_of(None, 60).subplots()
        draw_views(axes, some[:, :2], walk_numbers(some, np.zeros(len(some))), 1.0, 3)
        assert [line.get_marker() for line in axes.lines] == marks
