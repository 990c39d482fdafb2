"""Where a site's maps lie: by links, which may contradict each other, by shared points, by overlap."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rholoc.errors import InvalidInput, MappingFailed
from rholoc.geometry import FloatArray, Pose, Similarity, pose_distances, pose_matrix
from rholoc.mapping.edit.moving import move_map
from rholoc.mapping.sites.linking import find_link
from rholoc.mapping.sites.poses import pose_in_site, solve_site, with_link
from rholoc.maps import (
    FramePose,
    LinkOrigin,
    MapNames,
    MapWaypoint,
    NamedPoint,
    Site,
    SiteLink,
    SiteMap,
    without_memory,
)


def random_pose(rng: np.random.Generator) -> FloatArray:
    return pose_matrix(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-20, 20, 3))


def link(first: str, second: str, T_site: dict[str, FloatArray], rng: np.random.Generator | None = None) -> SiteLink:
    """The true link between two maps; with ``rng``, as wrong as its sigmas say."""
    T = np.linalg.inv(T_site[first]) @ T_site[second]
    if rng is not None:
        turn = Rotation.from_rotvec(np.deg2rad(0.5) * rng.normal(size=3)).as_matrix()
        T = T @ pose_matrix(turn, 0.05 * rng.normal(size=3))
    return SiteLink(first, second, FramePose.of(T))


def site_of(names: str, links: list[SiteLink], given: dict[str, FloatArray] | None = None) -> Site:
    poses = {name: FramePose.of(T) for name, T in (given or {}).items()}
    return Site(maps=tuple(SiteMap(name, given=poses.get(name)) for name in names), links=tuple(links))


def apart(site: Site, truth: dict[str, FloatArray]) -> tuple[float, float]:
    """The furthest that a map is from where it should be: m and degrees."""
    found = np.array([one.pose.matrix for one in site.maps if one.pose is not None])
    there = np.array([truth[one.map] for one in site.maps if one.pose is not None])
    off_m, off_rad = pose_distances(found, there)
    return float(off_m.max()), float(np.degrees(off_rad.max()))


@pytest.mark.parametrize("seed", range(3))
def test_poses_follow_from_links_whichever_way_they_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T = {name: random_pose(rng) for name in "abcd"} | {"a": np.eye(4)}
    solved = solve_site(site_of("abcd", [link("b", "a", T), link("b", "c", T), link("d", "c", T), link("a", "d", T)]))
    assert apart(solved, T) == pytest.approx((0, 0), abs=1e-5)
    assert solve_site(solved) == solved or apart(solve_site(solved), T) == pytest.approx((0, 0), abs=1e-5)


def test_a_given_pose_stays_and_the_others_follow_it() -> None:
    rng = np.random.default_rng(1)
    T = {name: random_pose(rng) for name in "abc"}
    solved = solve_site(site_of("abc", [link("a", "b", T), link("b", "c", T)], {"b": T["b"]}))
    assert apart(solved, T) == pytest.approx((0, 0), abs=1e-4)
    assert solved.maps[1].pose == solved.maps[1].given


def test_a_map_that_nothing_joins_to_the_others_has_no_pose() -> None:
    T = {name: random_pose(np.random.default_rng(2)) for name in "abcd"} | {"a": np.eye(4)}
    solved = solve_site(site_of("abcd", [link("a", "b", T), link("c", "d", T)]))
    assert [one.pose is not None for one in solved.maps] == [True, True, False, False]
    assert solved.maps[2].covariance is None
    assert solve_site(Site()) == Site()


def test_covariances_are_what_the_errors_of_links_come_to() -> None:
    rng = np.random.default_rng(3)
    T = {name: random_pose(rng) for name in "abc"} | {"a": np.eye(4)}
    errors, claimed = [], []
    for _ in range(60):
        links = [link("a", "b", T, rng), link("b", "c", T, rng), link("a", "c", T, rng)]
        placed = solve_site(site_of("abc", links)).maps[2]
        errors.append(placed.pose.matrix[:3, 3] - T["c"][:3, 3])
        claimed.append(np.array(placed.covariance)[:3, :3])
    mahalanobis = [
        error @ np.linalg.solve(covariance, error) for error, covariance in zip(errors, claimed, strict=True)
    ]
    assert 2.0 < np.mean(mahalanobis) < 4.5  # 3 in the mean


def test_a_placed_map_has_the_uncertainty_of_the_given_pose_that_it_follows() -> None:
    T = {"a": np.eye(4), "b": pose_matrix(np.eye(3), np.array([10.0, 0, 0]))}
    of_a = np.diag([0.1**2] * 3 + [np.radians(1.0) ** 2] * 3)
    site = site_of("ab", [replace(link("a", "b", T), sigma_m=0.02, sigma_deg=0.1)], {"a": T["a"]})
    known = replace(site.maps[0], covariance=tuple(map(tuple, of_a.tolist())))
    of_b = np.array(solve_site(replace(site, maps=(known, site.maps[1]))).maps[1].covariance)
    across_m2 = 0.1**2 + 0.02**2 + (10 * np.radians(1.0)) ** 2
    np.testing.assert_allclose(np.diag(of_b)[:3], [0.1**2 + 0.02**2, across_m2, across_m2], rtol=1e-3)
    np.testing.assert_allclose(np.diag(of_b)[3:], np.radians(1.0) ** 2 + np.radians(0.1) ** 2, rtol=1e-3)


def test_a_link_found_far_from_a_maps_origin_leaves_the_origin_as_uncertain_as_it_is(halves) -> None:
    rng = np.random.default_rng(4)
    T = {"west": np.eye(4), "east": pose_matrix(np.eye(3), np.array([2.0, 1.0, 0.0]))}
    first, second, _ = halves
    mahalanobis = []
    for _ in range(40):
        here = {f"p{k}": at for k, at in enumerate(np.array([30.0, 0, 0]) + rng.uniform(-1, 1, (5, 3)))}
        there = {name: T["east"][:3, 3] + at + rng.normal(0, 0.03, 3) for name, at in here.items()}
        found = find_link("west", with_points(first, there, True), "east", with_points(second, here, True))
        np.testing.assert_allclose(found.at, np.mean(list(here.values()), axis=0))
        placed = with_link(Site(maps=(SiteMap("west"), SiteMap("east"))), found).maps[1]
        assert placed.pose is not None
        off = placed.pose.matrix[:3, 3] - T["east"][:3, 3]
        mahalanobis.append(off @ np.linalg.solve(np.array(placed.covariance)[:3, :3], off))
    assert np.mean(mahalanobis) < 4.5  # 3 in the mean, or fewer: sigmas of links are careful


def test_links_that_contradict_each_other_are_refused_with_how_much_is_left_over() -> None:
    T = {name: pose_matrix(np.eye(3), np.array([4.0 * row, 0, 0])) for row, name in enumerate("abc")}
    wrong = SiteLink("a", "c", FramePose((9.5, 0.0, 0.0)))
    with pytest.raises(InvalidInput, match=r"around .*a.*→.* 1\.50 m and 0\.0° are left over"):
        solve_site(site_of("abc", [link("a", "b", T), link("b", "c", T), wrong]))
    unsure = replace(wrong, sigma_m=1.0)
    assert solve_site(site_of("abc", [link("a", "b", T), link("b", "c", T), unsure])).maps[2].pose is not None


def test_a_link_that_contradicts_given_poses_is_refused() -> None:
    T = {"a": np.eye(4), "b": pose_matrix(np.eye(3), np.array([4.0, 0, 0]))}
    with pytest.raises(InvalidInput, match="contradict"):
        solve_site(site_of("ab", [SiteLink("a", "b", FramePose((5.0, 0.0, 0.0)))], T))


@pytest.fixture(scope="module")
def halves(point_room):
    """Two maps of one room that overlap, the second in a frame of its own; and T_first_second."""
    walk = point_room.walk(80)
    first, second = point_room.map_of(walk[:45:2], "west"), point_room.map_of(walk[25:65:3], "east")
    turn = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    T = pose_matrix(turn, np.array([3.0, -2.0, 0.5]))
    inverse = np.linalg.inv(T)
    return first, move_map(second, Similarity(1.0, inverse[:3, :3], inverse[:3, 3])), T


def with_points(map_, points: dict[str, FloatArray], measured: bool):
    if measured:
        waypoints = tuple(MapWaypoint(name, tuple(at.tolist())) for name, at in points.items())
        return replace(map_, info=replace(map_.info, waypoints=waypoints))
    named = tuple(NamedPoint(name, tuple(at.tolist())) for name, at in points.items())
    return replace(map_, info=replace(map_.info, names=MapNames(points=named)))


def test_maps_that_overlap_are_linked(halves) -> None:
    first, second, T = halves
    found = find_link("west", first, "east", second)
    off_m, off_rad = pose_distances(found.pose.matrix[None], T[None])
    assert found.origin is LinkOrigin.OVERLAP
    assert off_m[0] < 0.03
    assert np.degrees(off_rad[0]) < 0.5
    placed = with_link(Site(maps=(SiteMap("west"), SiteMap("east"))), found)
    again = with_link(placed, found)
    assert len(again.links) == 1  # in place of the one that was found before
    assert again.maps[1].pose is not None


@pytest.mark.parametrize("measured", [True, False])
def test_maps_that_share_points_are_linked_by_them(halves, measured: bool) -> None:
    first, second, T = halves
    rng = np.random.default_rng(0)
    there = {name: rng.uniform(-3, 3, 3) for name in ("door", "desk", "lamp", "stove")}
    here = {name: (np.linalg.inv(T) @ [*at, 1])[:3] for name, at in there.items()}
    found = find_link("west", with_points(first, there, True), "east", with_points(second, here, measured))
    assert found.origin is LinkOrigin.WAYPOINTS
    off_m, off_rad = pose_distances(found.pose.matrix[None], T[None])
    assert off_m[0] < 1e-6
    assert off_rad[0] < 1e-6
    here["lamp"] = here["lamp"] + np.array([2.0, 0, 0])
    with pytest.raises(MappingFailed, match=r"disagree: \w+ by \d"):
        find_link("west", with_points(first, there, True), "east", with_points(second, here, measured))


def test_points_on_a_line_do_not_make_a_link(halves) -> None:
    first, second, T = halves
    there = {f"p{k}": np.array([k, 0.0, 1.0]) for k in range(4)}
    here = {name: (np.linalg.inv(T) @ [*at, 1])[:3] for name, at in there.items()}
    forgetful = without_memory(with_points(second, here, True))
    with pytest.raises(InvalidInput, match="does not keep what it was built from"):  # which the overlap needs
        find_link("west", with_points(first, there, True), "east", forgetful)


def test_a_map_without_a_scale_is_refused(halves) -> None:
    first, second, _ = halves
    with pytest.raises(InvalidInput, match="east has no metric scale"):
        find_link("west", first, "east", replace(second, info=replace(second.info, metric=False)))


def test_a_pose_goes_to_the_site_with_its_uncertainty() -> None:
    rng = np.random.default_rng(5)
    T_site_map, T_map_camera = random_pose(rng), random_pose(rng)
    A, B = rng.normal(size=(6, 6)), rng.normal(size=(6, 6))
    of_map, of_pose = 1e-8 * A @ A.T, 1e-8 * B @ B.T
    member = SiteMap("hall", pose=FramePose.of(T_site_map), covariance=tuple(map(tuple, of_map.tolist())))
    T, covariance = pose_in_site(member, T_map_camera, of_pose)
    assert np.allclose(T, T_site_map @ T_map_camera)
    assert covariance is not None

    def moved(T_before: FloatArray, motion: FloatArray) -> FloatArray:
        turn = Rotation.from_rotvec(motion[3:]).as_matrix()
        return pose_matrix(turn @ T_before[:3, :3], T_before[:3, 3] + motion[:3])

    drawn = []
    for one, other in zip(
        rng.multivariate_normal(np.zeros(6), of_map, 4000),
        rng.multivariate_normal(np.zeros(6), of_pose, 4000),
        strict=True,
    ):
        there = moved(T_site_map, one) @ moved(T_map_camera, other)
        turned = Rotation.from_matrix(there[:3, :3] @ T[:3, :3].T).as_rotvec()
        drawn.append([*(there[:3, 3] - T[:3, 3]), *turned])
    assert np.allclose(np.cov(np.array(drawn).T), covariance, atol=0.08 * np.abs(covariance).max())
    assert Pose(T).position.shape == (3,)
    assert pose_in_site(member, T_map_camera, None)[1] is None
