"""Who asks for poses now, and where requests failed, on a map's page."""

import cv2
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from rholoc.mapping.build.self_report import map_statistics
from rholoc_client import Client, Prior


@pytest.fixture(scope="module")
def shown(serve, picture_world):
    running = serve(live=True, keep_failures=True, keep_refused=5)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho(report=map_statistics(picture_world.map_)))
    return running


@pytest.mark.slow
def test_those_who_ask_are_in_the_room_and_in_the_table(desk_browser, shown, picture_world, opened, settled):
    client = Client(shown.url)
    with opened(desk_browser, shown.url, "maps/room") as page:
        button = settled(page).get_by_role("button", name="Live")
        button.click()
        live = page.locator("section", has=page.get_by_role("heading", name="Live"))
        expect(live).to_contain_text("Nobody asks for poses")
        client.localize("room", picture_world.png())
        row = live.locator("tbody tr")
        expect(row).to_contain_text("127.0.0.1")
        expect(row.locator(".badge")).to_contain_text("%")
        expect(page.locator(".scene-robot")).to_have_text("127.0.0.1")
        blank = cv2.imencode(".png", np.full_like(picture_world.image, 128))[1].tobytes()
        client.localize("room", blank, prior=Prior(position=(1.0, 2.0, 1.5), heading=(1.0, 0.0, 0.0)))
        expect(row.locator(".badge")).to_have_text("none")
        expect(page.locator(".scene-robot")).to_have_count(0)  # nobody knows where it is
        assert Axe().run(page).violations_count == 0
        button.click()
        expect(live).to_be_hidden()
        expect(page.locator(".scene-robot")).to_have_count(0)
        page.reload()
        expect(settled(page).locator("main")).to_contain_text("without a pose: 1")


def test_a_refused_picture_that_resembles_nothing_says_so(desk_browser, shown, picture_world, opened, settled):
    flat = cv2.imencode(".png", np.full_like(picture_world.image, 128))[1].tobytes()
    Client(shown.url).localize("room", flat)
    with opened(desk_browser, shown.url, "maps/room/refusals") as page:
        card = settled(page).get_by_role("list", name="Refused pictures").locator(".card").first
        card.get_by_role("button", name="Compare with the map").click()
        expect(card).to_contain_text("No view of the map resembles it.")


@pytest.mark.slow
def test_nothing_of_it_is_there_unless_switched_on(desk_browser, service, picture_world, opened, settled):
    content = picture_world.rho(report=map_statistics(picture_world.map_))  # with its coverage: nobody waits for it
    (service.settings.maps_dir / "plain.rho").write_bytes(content)
    with opened(desk_browser, service.url, "maps/plain") as page:
        expect(settled(page).get_by_role("button", name="Live")).to_have_count(0)
        expect(page.locator("main")).not_to_contain_text("In the last day")
