"""Sites and keys in the console: rooms on one plan, a link for visitors, keys limited and revoked."""

from __future__ import annotations

from dataclasses import replace

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from rholoc.maps import Cloud, MapLabels, Room, map_to_bytes
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy


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
