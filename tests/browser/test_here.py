"""A visitor's page in Chromium: the fake camera shows a place of a site, and the page says where it is and the way."""

import re
from dataclasses import replace

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect

from rholoc.maps import Cloud, MapNames, NamedPoint, Room, map_to_bytes
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy

AHEAD_M, LEFT_M = 5.0, 3.0


@pytest.fixture(scope="module")
def site(serve, picture_world):
    """A site of one map, whose second walk leads 5 m ahead of the picture and then 3 m to the left."""
    running = serve(keys=KeyPolicy.ALWAYS)
    store = KeyStore(running.settings.data_dir)
    boss = {"Authorization": f"Bearer {store.create('boss', Scope.ADMIN)}"}
    pose, map_ = picture_world.pose, picture_world.map_
    ahead = pose.heading * [1, 1, 0]
    left = np.array([-ahead[1], ahead[0], 0.0])
    corner = pose.position + AHEAD_M * ahead
    floor = pose.position[2] - 1.5 + np.zeros(4)
    square = np.column_stack([[-2, 8, 8, -2], [-4, -4, 10, 10], floor]).astype(np.float32)
    room = Room(
        Cloud(square, np.full((4, 3), 180, np.uint8), np.zeros(4, np.int32)), np.array([[0, 1, 2, 3]], np.int32)
    )
    views = map_.views
    path = [pose.position + share * AHEAD_M * ahead for share in np.linspace(0, 1, 10)]
    path += [corner + share * LEFT_M * left for share in np.linspace(0, 1, 6)]
    T = np.repeat(views.T_map_camera[:1], len(path), axis=0)
    T[:, :3, 3] = path
    walked = replace(
        views,
        times=np.concatenate([views.times, 100.0 + np.arange(len(path))]),
        T_map_camera=np.concatenate([views.T_map_camera, T.astype(np.float32)]),
    )
    names = MapNames((NamedPoint("exit", tuple((corner + LEFT_M * left).tolist())),), ())
    told = replace(map_, room=room, views=walked, info=replace(map_.info, names=names))
    assert httpx.put(f"{running.url}/v1/maps/hall", content=map_to_bytes(told), headers=boss).status_code == 201
    wanted = {"maps": [{"map": "hall", "floor": "1", "pose": {}}]}
    assert httpx.put(f"{running.url}/v1/sites/campus", json=wanted, headers=boss).status_code == 201
    return running.url, store.create("visitor", Scope.VISIT, site="campus")


def test_a_visitor_is_shown_and_led(fake_camera, site, picture_world):
    url, key = site
    browser = fake_camera([picture_world.image])
    page = browser.new_page(viewport={"width": 390, "height": 844}, locale="en-US")
    sent = []
    page.on("request", lambda request: sent.append(request.url) if "localize" in request.url else None)
    page.goto(f"{url}/here/campus#/key/{key}/")
    page.get_by_role("button", name="Show me where I am").click()
    said = page.locator(".here-said")
    expect(said).to_have_text(re.compile(r"You are here, give or take [\d.]+ m\."))
    page.get_by_label("Lead me to").select_option(label="exit")
    expect(said).to_have_text(re.compile("^[45] m, then left$"))  # corners are cut
    expect(page.locator(".here-arrow")).to_be_visible()
    sent.clear()
    page.wait_for_timeout(3000)
    assert 1 <= len(sent) <= 4
    browser.close()


@pytest.mark.slow
def test_a_visitor_is_told_what_is_not_known(fake_camera, site):
    url, key = site
    browser = fake_camera([np.full((480, 640, 3), 40, np.uint8)])
    page = browser.new_page(locale="de-DE")
    page.goto(f"{url}/here/campus#/key/{key}/")
    page.get_by_role("button", name="Zeigen, wo ich bin").click()
    expect(page.locator(".here-said")).not_to_have_text("Die Kamera einmal umherblicken lassen.")
    expect(page.locator(".here-arrow")).to_be_hidden()
    browser.close()
