"""Recordings in the console: what they are, their waypoints corrected, mapped again; and lists in groups."""

from dataclasses import replace
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from rholoc.library.recording_notes import notes_of
from rholoc.library.recordings import RecordingStore
from rholoc.maps import Cloud, MapLabels, Room, map_to_bytes
from rholoc.recordings import MemoryFrames, Recording, Waypoint
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy

PLACES = [(0.0, 0.0, 1.5), (2.0, 0.0, 1.5), (2.0, 3.5, 1.5)]


@pytest.fixture(scope="module")
def stored(serve, picture_world):
    """A service with two maps of one site, and a recording that a job has read; and its id."""
    running = serve()
    for name, floor in (("hall", "0"), ("attic", "3")):
        assert httpx.put(f"{running.url}/v1/maps/{name}", content=picture_world.rho()).is_success
        labels = {"kind": "labels", "site": "plant 2", "floor": floor, "tags": ["old"]}
        assert httpx.post(f"{running.url}/v1/maps/{name}/corrections", json=labels).is_success
    assert httpx.put(f"{running.url}/v1/maps/shed", content=picture_world.rho()).is_success
    video = {"file": ("walk.mp4", b"\0\0\0\x18ftypmp42" + b"\0" * 5000)}
    recording = httpx.post(f"{running.url}/v1/recordings", files=video, data={"map": "hall"}).json()["recording"]
    frames = MemoryFrames([cv2.resize(picture_world.image, (160, 120))] * 75, 1.0)
    own = tuple(Waypoint(f"W{i}", 20.0 * i, place) for i, place in enumerate(PLACES))
    walk = Recording(frames, "walk", Path("walk"), waypoints=own)
    RecordingStore(running.settings.data_dir).note(recording, notes_of(walk))
    return running, recording


def test_waypoints_are_corrected_and_the_recording_is_mapped_again(desk_browser, stored, opened, settled):
    running, recording = stored
    with opened(desk_browser, running.url, "recordings") as page:
        row = settled(page).locator("tbody tr", has_text="walk.mp4")
        expect(row).to_contain_text("1 min 14 s")
        expect(row.get_by_role("img", name="A picture of the recording")).to_be_visible()
        row.get_by_role("link", name="walk.mp4").click()
        card = settled(page).get_by_role("region", name="Waypoints")
        expect(card).to_contain_text("As they came with the recording.")
        second = card.get_by_role("row").nth(2)
        second.get_by_label("y").fill("0.25")
        card.get_by_role("button", name="Add a waypoint").click()
        last = card.get_by_role("row").last
        for label, value in (
            ("Name", "E"),
            ("x", "1"),
            ("y", "4"),
            ("z", "1.5"),
            ("Time, s", "61.5"),
            ("Within, m", "0.1"),
        ):
            last.get_by_label(label, exact=True).fill(value)
        card.get_by_role("button", name="Save waypoints").click()
        expect(card).to_contain_text("These were typed here")
        given = httpx.get(f"{running.url}/v1/recordings/{recording}").json()["waypoints"]
        assert given[1] == {"name": "W1", "position": [2.0, 0.25, 1.5], "time_s": 20.0, "sigma_m": 0.02}
        assert given[3] == {"name": "E", "position": [1.0, 4.0, 1.5], "time_s": 61.5, "sigma_m": 0.1}
        card.get_by_role("button", name="Take back").click()
        expect(card).to_contain_text("As they came with the recording.")
        expect(card.get_by_role("row")).to_have_count(4)
        page.get_by_label("Name of the map").fill("hall-again")
        page.get_by_label("Only these frames").fill("10:60")
        page.get_by_role("button", name="Map it", exact=True).click()
        expect(page.get_by_role("heading", name="Map hall-again")).to_be_visible()
        newest = httpx.get(f"{running.url}/v1/jobs").json()["jobs"][0]
        assert (newest["map"], newest["recording"]) == ("hall-again", recording)


def test_waypoints_that_cannot_be_are_refused_with_the_reason(desk_browser, stored, opened, settled):
    running, recording = stored
    with opened(desk_browser, running.url, f"recordings/{recording}", failures=1) as page:
        card = settled(page).get_by_role("region", name="Waypoints")
        card.get_by_role("row").nth(1).get_by_label("Time, s").fill("99")
        card.get_by_role("button", name="Save waypoints").click()
        expect(page.get_by_text("outside the recording's 0.000 to 74.000 s")).to_be_visible()
        assert httpx.get(f"{running.url}/v1/recordings/{recording}").json()["corrected"] is False


@pytest.mark.slow
def test_maps_are_labelled_searched_and_grouped(desk_browser, stored, opened, settled):
    running, _ = stored
    with opened(desk_browser, running.url, "maps/shed") as page:
        page.get_by_role("button", name="Site, floor, tags").click()
        dialog = page.get_by_role("dialog")
        dialog.get_by_label("Site").fill("yard")
        dialog.get_by_label("Tags").fill("wood, old ,")
        dialog.get_by_role("button", name="Save").click()
        expect(page.locator("main")).to_contain_text("wood, old")
        page.goto(f"{running.url}/#/maps")
        settled(page).get_by_label("Group").select_option(label="by site")
        shown = page.get_by_role("list", name="Maps").get_by_role("heading")
        expect(shown).to_have_text(["plant 2", "attic", "hall", "yard", "shed"])
        page.get_by_label("Group").select_option(label="by floor")
        expect(shown).to_have_text(["plant 2, 0", "hall", "plant 2, 3", "attic", "yard", "shed"])
        page.get_by_label("Search").fill("old plant")
        page.get_by_label("Group").select_option(label="by tag")
        expect(shown).to_have_text(["old", "attic", "hall"])
        assert np.all([one.is_visible() for one in page.locator("li.map-card canvas").all()])


@pytest.fixture(scope="module")
def campus(serve, picture_world):
    """A service with keys, and two maps of which one has a room."""
    running = serve(keys=KeyPolicy.ALWAYS)
    store = KeyStore(running.settings.data_dir)
    boss = store.create("boss", Scope.ADMIN)
    corners = Cloud(
        np.array([[-2, -4, 0], [8, -4, 0], [8, 10, 0], [-2, 10, 0]], np.float32),
        np.full((4, 3), 180, np.uint8),
        np.zeros(4, np.int32),
    )
    room = Room(corners, np.array([[0, 1, 2, 3]], np.int32))
    labels = MapLabels("campus", "1", ())
    hall = replace(picture_world.map_, room=room, info=replace(picture_world.map_.info, labels=labels))
    for name, map_ in (("hall", hall), ("wing", picture_world.map_)):
        header = {"Authorization": f"Bearer {boss}"}
        assert httpx.put(f"{running.url}/v1/maps/{name}", content=map_to_bytes(map_), headers=header).status_code == 201
    return running.url, boss, store


@pytest.mark.slow
def test_a_site_is_made_and_shown_and_shared(desk_browser, campus):
    url, boss, store = campus
    page = desk_browser.new_page(locale="en-US")
    page.goto(f"{url}/#/key/{boss}/sites")
    expect(page.get_by_role("heading", name="No sites yet")).to_be_visible()
    page.get_by_role("button", name="New site").click()
    page.get_by_label("Name").fill("campus")
    page.get_by_label("hall", exact=True).check()
    expect(page.get_by_label("Floor of hall")).to_have_value("1")
    page.get_by_label("wing", exact=True).check()
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="Floor 1")).to_be_visible()
    expect(page.get_by_role("heading", name="Without a place")).to_be_visible()
    expect(page.get_by_role("link", name="wing")).to_be_visible()
    floor = page.locator("section.card")
    expect(floor).to_contain_text("Expected error")
    page.wait_for_function("document.querySelector('.floor-plan').width > 300")
    floor.get_by_role("link", name="Name points").click()
    expect(page.get_by_label("What is to be corrected?")).to_have_value("point")
    page.go_back()
    page.get_by_role("button", name="Link for visitors").click()
    page.get_by_role("button", name="Make the link").click()
    link = page.get_by_label("Link", exact=True).input_value()
    assert link.startswith(f"{url}/here/campus#/key/rho_")
    store.refresh()
    key = store.find(link.split("/key/")[1].split("/")[0])
    assert (key.scope, key.site) == (Scope.VISIT, "campus")
    page.close()


def test_keys_are_handed_on_limited_and_revoked(desk_browser, campus):
    url, boss, store = campus
    page = desk_browser.new_page(locale="en-US")
    page.goto(f"{url}/#/key/{boss}/keys")
    page.get_by_role("button", name="New key").click()
    page.get_by_label("For whom or what").fill("robot-7")
    page.get_by_label("It may").select_option("localize")
    page.get_by_role("button", name="Make the key").click()
    secret = page.get_by_label("Key", exact=True).input_value()
    store.refresh()
    key = store.find(secret)
    assert (key.name, key.scope) == ("handed-robot-7", Scope.LOCALIZE)
    page.get_by_role("button", name="Done").click()
    card = page.locator(".card", has=page.get_by_role("heading", name=key.name))
    card.get_by_role("button", name="Limits").click()
    page.get_by_label("Requests a second").fill("5")
    page.get_by_role("button", name="Save").click()
    expect(card).to_contain_text("Requests a second: 5")
    assert store.named(key.name).limits.requests_per_s == 5
    card.get_by_role("button", name="Revoke").click()
    page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
    expect(card).to_have_count(0)
    assert key.name not in {one.name for one in store.keys()}  # noqa: SIM118
    page.close()
