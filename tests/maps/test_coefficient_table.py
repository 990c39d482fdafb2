"""Table 5: maps as CSV and back."""

from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from rholoc.density import TensorDensities
from rholoc.density.tensor import fit_tensors
from rholoc.errors import InvalidMap, UnknownMap
from rholoc.features import get_extractor
from rholoc.localization import Dof, Localizer, Query
from rholoc.maps import DensityKind, Map, read_coefficient_table, write_coefficient_table
from rholoc_lab.paper.equations import polynomial_values, squared_ray_distance
from synthetic_map import synthetic_map

_COLUMNS = (
    ("landmarks", "channels"),
    ("landmarks", "positions"),
    ("landmarks", "covariances"),
    ("descriptors", "values"),
    ("descriptors", "features"),
    ("views", "times"),
)


def _tensor_map(map_: Map, degree: int = 2) -> Map:
    """The map with a density of every feature from the first view's side, and of some from another."""
    rng = np.random.default_rng(3)
    owners = np.sort(np.concatenate([np.arange(len(map_)), rng.choice(len(map_), len(map_) // 4, replace=False)]))
    places = (map_.views.positions[0] + rng.normal(0, 0.05, (len(owners), 3))).astype(np.float32).astype(float)
    landmarks = map_.landmarks.positions[owners].astype(float)
    radii = np.full(len(owners), 1.5)
    fitted = replace(fit_tensors(landmarks, places, radii, degree), features=owners)
    return replace(map_, info=replace(map_.info, density=DensityKind.TENSOR), densities=fitted)


@pytest.fixture(scope="module")
def small_tensor_map() -> Map:
    return _tensor_map(synthetic_map(features=11))


@pytest.fixture(scope="module", params=["tensor", "ray"])
def small_map(request: pytest.FixtureRequest, room_map: Map, small_tensor_map: Map) -> Map:
    return small_tensor_map if request.param == "tensor" else room_map


@pytest.fixture(scope="module")
def small_table(small_map: Map, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The map's coefficient table."""
    path = tmp_path_factory.mktemp("table") / "room.csv"
    write_coefficient_table(_first(small_map, 11), path)
    return path.read_text()


def _first(map_: Map, count: int) -> Map:
    """The map with every so many features left out, ``count`` of them kept."""
    kept = np.linspace(0, len(map_) - 1, count).astype(int)
    views = len(map_.views)  # each of them saw every feature
    return replace(
        map_,
        landmarks=replace(
            map_.landmarks,
            channels=map_.landmarks.channels[kept],
            positions=map_.landmarks.positions[kept],
            covariances=map_.landmarks.covariances[kept],
        ),
        descriptors=replace(
            map_.descriptors, values=map_.descriptors.values[kept], features=np.arange(count, dtype=np.int32)
        ),
        observations=replace(
            map_.observations,
            views=np.repeat(np.arange(views, dtype=np.int32), count),
            features=np.tile(np.arange(count, dtype=np.int32), views),
        ),
    )


def _seen(map_: Map) -> list[set[int]]:
    return [
        set(map_.observations.features[a:b].tolist())
        for a, b in zip(map_.view_offsets[:-1], map_.view_offsets[1:], strict=True)
    ]


def test_a_map_reads_back_as_it_was(small_map: Map, tmp_path: Path):
    path = tmp_path / "room.csv"
    write_coefficient_table(small_map, path)
    again = read_coefficient_table(path)
    for name, column in _COLUMNS:
        back, written = (getattr(getattr(one, name), column) for one in (again, small_map))
        np.testing.assert_array_equal(back, written, err_msg=column)
    assert _seen(again) == _seen(small_map)
    for name in ("density", "features", "metric", "upright", "camera"):
        assert getattr(again.info, name) == getattr(small_map.info, name)
    np.testing.assert_allclose(again.views.T_map_camera, small_map.views.T_map_camera, rtol=0, atol=3e-7)
    assert type(again.densities) is type(small_map.densities)
    for mine, written in zip(astuple(again.densities), astuple(small_map.densities), strict=True):
        np.testing.assert_array_equal(mine, written)


def test_a_tensor_maps_rows_are_table_5s(small_tensor_map: Map, tmp_path: Path):
    path = tmp_path / "room.csv"
    write_coefficient_table(small_tensor_map, path)
    header, *rows = [line.split(",") for line in path.read_text().splitlines()]
    assert header[:2] == ["descriptor", "a_0_0_0_0_0_0_0_0"]
    assert header[6561] == "a_2_2_2_2_2_2_2_2"
    densities = small_tensor_map.densities
    assert isinstance(densities, TensorDensities)
    channel, descriptor = small_tensor_map.landmarks.channels[0], small_tensor_map.descriptors.values[0]
    assert rows[0][0] == f"{channel:02x}" + bytes(descriptor).hex()
    written = np.array(rows[0][1:6562], dtype=np.float32)
    np.testing.assert_array_equal(written, densities.all_coefficients(np.array([0]))[0])
    assert {row[header.index("feature")] for row in rows} == {str(f) for f in range(len(small_tensor_map))}
    assert len({(row[header.index("feature")], row[header.index("place_x")]) for row in rows}) == len(densities)


def test_a_ray_maps_coefficients_are_its_density(room_map: Map, tmp_path: Path):
    path = tmp_path / "room.csv"
    write_coefficient_table(room_map, path)
    header, *rows = [line.split(",") for line in path.read_text().splitlines()]
    assert header[1:730:728] == ["a_0_0_0_0_0_0", "a_2_2_2_2_2_2"]
    row = rows[7]
    feature, tolerance = int(row[header.index("feature")]), np.float32(row[header.index("tolerance")]).item()
    bearing, position = np.array([0.6, 0.0, 0.8]), np.array([0.3, -0.2, 1.4])
    value, _ = polynomial_values(np.array([row[1:730]], dtype=float), 2, np.r_[bearing, position])
    squared = squared_ray_distance(room_map.landmarks.positions[feature].astype(float), bearing, position)
    assert value[0] == pytest.approx(1 - squared / tolerance**2, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("kind", list(DensityKind))
def test_a_map_read_back_localizes_to_the_same_pose(picture_world, kind: DensityKind, tmp_path: Path):
    map_ = _first(picture_world.map_, 250)
    map_ = _tensor_map(map_) if kind is DensityKind.TENSOR else map_
    write_coefficient_table(map_, tmp_path / "picture.csv")
    again = read_coefficient_table(tmp_path / "picture.csv")
    features = get_extractor("gray").extract(picture_world.image)
    query = Query(features, picture_world.camera, Dof.FREE)
    before, after = Localizer(map_).localize(query), Localizer(again).localize(query)
    np.testing.assert_allclose(after.pose.T_map_camera, before.pose.T_map_camera, atol=1e-6)
    assert np.linalg.norm(before.pose.position - picture_world.pose.position) < 0.01


def _cells(path: Path) -> list[list[str]]:
    return [line.split(",") for line in path.read_text().splitlines()]


def _column(name: str, change: Callable[[str], str]) -> Callable[[list[list[str]]], None]:
    def edit(cells: list[list[str]]) -> None:
        at = cells[0].index(name)
        cells[3][at] = change(cells[3][at])

    return edit


def _coefficient(value: str) -> Callable[[list[list[str]]], None]:
    def edit(cells: list[list[str]]) -> None:
        cells[3][1] = value

    return edit


def _drop_column(cells: list[list[str]]) -> None:
    for row in cells:
        del row[5]


def _add_column(cells: list[list[str]]) -> None:
    for row in cells:
        row.insert(-1, "1")
    cells[0][-2] = "mood"


def _other_degree(cells: list[list[str]]) -> None:
    last = max(i for i, name in enumerate(cells[0]) if name.startswith("a_"))
    cells[0][last] = cells[0][last].replace("2", "5")


def _repeat(cells: list[list[str]]) -> None:
    cells.insert(2, cells[1].copy())
    for i, row in enumerate(cells[1:], start=1):
        row[-1] = f"{i}/{len(cells) - 1}"


def _swap_columns(cells: list[list[str]]) -> None:
    for row in cells:
        row[1], row[2] = row[2], row[1]


def _drop_row(cells: list[list[str]]) -> None:
    del cells[3]


def _cut_last_rows(cells: list[list[str]]) -> None:
    del cells[-2:]


def _cut_within_a_row(cells: list[list[str]]) -> None:
    del cells[-1][40:]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (_drop_column, "has no a_"),
        (_add_column, "has the unexpected mood"),
        (_other_degree, "has coefficients of degree 5"),
        (_swap_columns, "out of order"),
        (_repeat, "row 2 repeats a descriptor"),
        (_drop_row, "rows are missing"),
        (_cut_last_rows, "cut off"),
        (_cut_within_a_row, "values under"),
        (_coefficient("nan"), "'nan' in a_0_0_0_0_0_0.*not a finite number"),
        (_coefficient("many"), "'many' in a_0"),
        (_column("landmark_y", lambda _: "inf"), "'inf' in landmark_y"),
        (_column("descriptor", lambda text: text[:-3]), "descriptor"),
        (_column("descriptor", lambda text: text[:-2]), "bytes"),
        (_column("feature", lambda _: "-1"), "feature '-1'"),
        (_column("extractor", lambda _: "eyes"), "another map"),
        (_column("seen_from", lambda _: "1 2 3"), "contradicts|view"),
    ],
)
def test_a_damaged_table_is_refused_with_what_is_wrong(small_table: str, tmp_path: Path, damage, says: str):
    path = tmp_path / "room.csv"
    path.write_text(small_table)
    cells = _cells(path)
    damage(cells)
    path.write_text("\n".join(",".join(row) for row in cells) + "\n")
    with pytest.raises(InvalidMap, match=says) as error:
        read_coefficient_table(path)
    assert "\n" not in error.value.message
    assert error.value.hint


def test_a_table_cut_off_anywhere_is_refused(room_map: Map, tmp_path: Path):
    path = tmp_path / "room.csv"
    write_coefficient_table(room_map, path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for length in [0, 1, len(whole) - 2, *rng.integers(2, len(whole) - 2, 20).tolist()]:
        path.write_bytes(whole[:length])
        with pytest.raises(InvalidMap):
            read_coefficient_table(path)


def test_foreign_files_are_refused(tmp_path: Path):
    path = tmp_path / "other.csv"
    for content in (b"\xff\xfe\x00", b"x,y\n1,2\n", b"descriptor,a_,feature\n", b"descriptor,a_2_2\n"):
        path.write_bytes(content)
        with pytest.raises(InvalidMap):
            read_coefficient_table(path)
    with pytest.raises(UnknownMap):
        read_coefficient_table(tmp_path / "nowhere.csv")


def test_a_ray_coefficient_that_contradicts_its_landmark_is_refused(room_map: Map, tmp_path: Path):
    path = tmp_path / "room.csv"
    write_coefficient_table(room_map, path)
    cells = _cells(path)
    cells[4][1] = str(float(cells[4][1]) + 0.01)
    path.write_text("\n".join(",".join(row) for row in cells) + "\n")
    with pytest.raises(InvalidMap, match=r"row 4 .*contradict its landmark"):
        read_coefficient_table(path)


def test_a_failed_export_leaves_what_was_there(room_map: Map, tmp_path: Path):
    path = tmp_path / "room.csv"
    path.write_text("precious")
    bare = replace(
        room_map,
        descriptors=replace(
            room_map.descriptors,
            values=room_map.descriptors.values[:0],
            features=room_map.descriptors.features[:0],
        ),
    )
    with pytest.raises(InvalidMap, match="no descriptor"):
        write_coefficient_table(bare, path)
    assert path.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("degree", [1, 3])
def test_other_degrees_read_back_too(make_map, degree: int, tmp_path: Path):
    map_ = _tensor_map(make_map(features=6, views=3), degree)
    write_coefficient_table(map_, tmp_path / "small.csv")
    again = read_coefficient_table(tmp_path / "small.csv")
    assert isinstance(again.densities, TensorDensities)
    assert isinstance(map_.densities, TensorDensities)
    np.testing.assert_array_equal(again.densities.coefficients, map_.densities.coefficients)
    assert again.densities.degree == degree


def test_a_tensor_row_can_be_evaluated_by_its_description_alone(small_tensor_map: Map, tmp_path: Path):
    """The recipe of maps/README.md, in an upright camera's own words."""
    path = tmp_path / "room.csv"
    write_coefficient_table(small_tensor_map, path)
    header, *rows = [line.split(",") for line in path.read_text().splitlines()]
    for row in rows[:20]:
        value = dict(zip(header, row, strict=True))
        c, m = (np.array([float(value[f"{name}_{axis}"]) for axis in "xyz"]) for name in ("place", "landmark"))
        radius, distance = float(value["radius"]), float(np.linalg.norm(m - c))
        e = (m - c) / distance
        left = np.cross([0, 0, 1.0], e)
        left /= np.linalg.norm(left)
        frame = np.array([(e - left) / np.sqrt(2), (e + left) / np.sqrt(2), np.cross(e, left)])
        x, h = c + radius * np.array([0.2, -0.3, 0.1]), frame @ (e + 0.2 * left)
        h /= np.linalg.norm(h)
        right = np.array([h[1], -h[0], 0]) / np.hypot(h[0], h[1])
        down = np.cross(h, right)
        seen = np.array([right, down, h]) @ frame @ (m - x)
        u, v = seen[:2] / seen[2]
        diagonal = np.array([1, 1, 0]) / np.sqrt(2)
        offset = 0.03
        s = np.r_[u + offset, v, (x - c) / radius, (h - diagonal) / np.sin(np.deg2rad(50))]
        density, _ = polynomial_values(np.array([row[1:6562]], dtype=float), 2, s)
        expected = 1 - (offset * seen[2] / (distance * 60 / 525)) ** 2
        assert density[0] == pytest.approx(expected, abs=0.04)
