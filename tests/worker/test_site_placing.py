"""Maps of a site placed by a job: found once, kept while workers die."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import Mock

import pytest

from fake_pipeline import tiny_map
from house import DOORS, IN_SITE, PAIRS, placed, put_house, put_rooms
from rholoc.errors import Cancelled, Conflict, MappingFailed, UnknownSite
from rholoc.jobs import JobKind, JobState
from rholoc.library.maps import MapLibrary
from rholoc.library.sites import SiteLibrary
from rholoc.mapping.sites.poses import solve_site
from rholoc.maps import FramePose, Site, SiteMap
from rholoc.progress import Stage, silent
from rholoc.worker.site_placing import store_links, write_links

if TYPE_CHECKING:
    from job_site import Site as Workplace
from rholoc.library.stores import SITES
from waiting import until


@pytest.fixture
def maps(tmp_path: Path) -> MapLibrary:
    """Three rooms, the middle one of which shares points with each of the others."""
    return put_rooms(MapLibrary(tmp_path / "maps"))


@pytest.fixture
def sites(tmp_path: Path) -> SiteLibrary:
    """A house of these rooms, with nothing known of where they lie."""
    return put_house(SiteLibrary(tmp_path / "maps"))


@pytest.fixture
def links(tmp_path: Path) -> Path:
    return tmp_path / "links.json"


def said(heard: list[str]):
    """A listener that notes each message once."""

    def listen(stage: Stage, fraction: float, message: str = "") -> None:
        assert stage is Stage.LINKS
        assert 0 <= fraction <= 1
        heard.append(message)

    return listen


def test_maps_are_placed_by_what_pairs_of_them_share(maps: MapLibrary, sites: SiteLibrary, links: Path) -> None:
    heard: list[str] = []
    write_links(links.parent / "maps", "house", links, said(heard))
    assert heard == PAIRS
    assert sites.get("house").version == 1
    assert store_links(links, "house", sites, maps) == ()
    assert placed(sites.get("house")) == {name: pytest.approx(at, abs=1e-6) for name, at in IN_SITE.items()}
    assert store_links(links, "house", sites, maps) == ()
    assert sites.get("house").version == 2, "what is stored already changes nothing"


def test_a_search_that_was_broken_off_goes_on_from_there(
    maps: MapLibrary, sites: SiteLibrary, links: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[str] = []

    def until_the_last(stage: Stage, fraction: float, message: str = "") -> None:
        heard.append(message)
        if message == PAIRS[-1]:
            raise Cancelled("The job was cancelled.")

    with pytest.raises(Cancelled):
        write_links(links.parent / "maps", "house", links, until_the_last)
    assert not links.exists()
    find = Mock(side_effect=MappingFailed("They do not overlap."))
    monkeypatch.setattr("rholoc.mapping.sites.link_search.find_link", find)
    write_links(links.parent / "maps", "house", links, silent)
    assert [(call.args[0], call.args[2]) for call in find.call_args_list] == [("kitchen", "study")]
    assert store_links(links, "house", sites, maps) == (
        "Nothing joins study to the others.",
        "hall and study: The first map does not keep what it was built from.",
        "kitchen and study: They do not overlap.",
    )


def test_what_changed_meanwhile_is_left_alone(maps: MapLibrary, sites: SiteLibrary, links: Path) -> None:
    write_links(links.parent / "maps", "house", links, silent)
    study = tiny_map(waypoints=DOORS["study"])
    maps.put("study", study)
    moved = replace(sites.get("house"), maps=tuple(SiteMap(name, floor="1") for name in DOORS))
    sites.put("house", moved)
    problems = store_links(links, "house", sites, maps)
    assert problems[:2] == (
        "kitchen or study has changed since the search for a link.",
        "Nothing joins study to the others.",
    )
    after = sites.get("house")
    assert set(placed(after)) == {"hall", "kitchen"}
    assert [one.floor for one in after.maps] == ["1"] * 3, "what others changed stays"
    sites.put("house", solve_site(Site(maps=(SiteMap("study"),))))
    assert store_links(links, "house", sites, maps) == ()
    assert sites.get("house").links == ()
    sites.delete("house")
    with pytest.raises(UnknownSite):
        store_links(links, "house", sites, maps)


def test_maps_with_given_poses_are_not_searched(maps: MapLibrary, sites: SiteLibrary, links: Path) -> None:
    given = tuple(SiteMap(name, given=FramePose(at)) for name, at in IN_SITE.items())
    sites.put("house", Site(maps=given))
    heard: list[str] = []
    write_links(links.parent / "maps", "house", links, said(heard))
    assert heard == []


def test_maps_that_are_gone_or_share_nothing_are_named(maps: MapLibrary, sites: SiteLibrary, links: Path) -> None:
    maps.delete("kitchen")
    write_links(links.parent / "maps", "house", links, silent)
    assert store_links(links, "house", sites, maps)[0] == "Nothing joins kitchen, study to the others."


def test_one_job_at_a_time_places_a_site_and_none_counts_as_learning(site: Workplace) -> None:
    job = site.queue.submit_placing("house")
    assert (job.kind, job.site, job.map_name, job.recording, job.trusted) == (JobKind.PLACE, "house", "", "", None)
    with pytest.raises(Conflict, match=job.id):
        site.queue.submit_placing("house")
    assert site.queue.learning("house") is None
    assert site.queue.learning("") is None
    walk = site.submit(map_name="house")
    assert site.queue.learning("house") is None, "of a map of that name"
    site.queue.cancel(walk.id)
    assert site.queue.submit_placing("other").site == "other"
    site.queue.cancel(job.id)
    assert site.queue.retry(job.id).kind is JobKind.PLACE


@pytest.mark.slow
def test_a_site_is_placed_though_the_worker_dies_in_the_middle(site: Workplace) -> None:
    """Which is killed while it looks at the last pair: the next worker looks at no other."""
    put_rooms(site.library)
    sites = put_house(SiteLibrary(site.maps_dir))
    site.control.hold(PAIRS[-1])
    worker = site.start_worker()
    job = site.queue.submit_placing("house")
    site.wait_at(PAIRS[-1])
    os.kill(worker.pid, signal.SIGKILL)
    site.control.let_go(PAIRS[-1])
    assert site.queue.get(job.id).state is not JobState.PUBLISHED
    site.start_worker()
    done = site.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, done.attempts, done.warnings, done.trusted) == (JobState.PUBLISHED, 2, (), None)
    assert set(placed(sites.get("house"))) == set(DOORS)
    assert sites.get("house").version == 2


@pytest.mark.slow
def test_another_machine_places_the_site_of_one_that_died(campus: Workplace) -> None:
    put_rooms(campus.library)
    sites = put_house(SiteLibrary(campus.stores.documents(SITES)))
    campus.control.hold(PAIRS[-1])
    worker = campus.start_worker()
    job = campus.queue.submit_placing("house")
    campus.wait_at(PAIRS[-1])
    os.kill(worker.pid, signal.SIGKILL)
    campus.control.let_go(PAIRS[-1])
    campus.start_worker()
    done = campus.wait_for(job, JobState.PUBLISHED, JobState.FAILED)
    assert (done.state, done.attempts, done.error_message) == (JobState.PUBLISHED, 2, None)
    until(lambda: set(placed(sites.get("house"))) == set(DOORS))
