"""Links with a key that expires: a map that is shown to somebody, a walk that goes on with the phone."""

import re

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from rholoc.mapping.build.self_report import map_statistics
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.settings import KeyPolicy

AS_OVER_HTTPS = """Object.defineProperty(window, "isSecureContext", {value: true});
    Object.defineProperty(navigator, "mediaDevices", {value: {getUserMedia() {}}});"""


@pytest.fixture(scope="module")
def locked(serve, picture_world):
    running = serve(keys=KeyPolicy.ALWAYS)
    content = picture_world.rho(report=map_statistics(picture_world.map_))
    (running.settings.maps_dir / "room.rho").write_bytes(content)
    return running


@pytest.fixture(scope="module")
def store(locked):
    return KeyStore(locked.settings.data_dir)


@pytest.mark.slow
def test_a_shared_link_shows_the_map_without_another_key(desk_browser, locked, store, opened, settled):
    mine = store.create("mine", Scope.MAP)
    with opened(desk_browser, locked.url, f"key/{mine}/maps/room") as page:
        assert page.evaluate("location.hash") == "#/maps/room"  # the key does not stay in the address
        settled(page).get_by_role("button", name="Share").click()
        page.get_by_label("Valid for").select_option(label="7 days")
        page.get_by_role("button", name="Make the link").click()
        expect(page.get_by_role("img", name="QR code of the link")).to_be_visible()
        link = page.get_by_label("Link", exact=True).input_value()
        assert Axe().run(page).violations_count == 0
    secret = re.fullmatch(rf"{locked.url}/#/key/(\S+)/maps/room", link)[1]
    store.refresh()  # as servers do every moment
    key = store.find(secret)
    assert key.scope is Scope.READ
    assert key.expires - key.created == pytest.approx(7 * 86400)
    with opened(desk_browser, locked.url, link.split("/#/")[1]) as page:
        expect(settled(page).locator("h1")).to_have_text("room")
        assert page.evaluate("localStorage.length") == 0  # it is this window's alone
        page.reload()
        expect(settled(page).locator("h1")).to_have_text("room")


def test_the_recorder_goes_on_with_a_phone(fake_camera, locked, store, opened):
    mine = store.create("desk", Scope.ADMIN)
    browser = fake_camera([], fps=30)
    at = locked.url.replace("127.0.0.1", "rholoc.test")  # a name that another device could know
    with browser.new_context(viewport={"width": 1280, "height": 850}) as context:
        page = context.new_page()
        page.add_init_script(AS_OVER_HTTPS)
        page.goto(f"{at}/record#/key/{mine}/next/room/1.0,2.0,90")
        expect(page.get_by_role("heading", name="Go on with a phone")).to_be_visible()
        with page.expect_request("**/v1/qr") as asked:
            page.get_by_role("button", name="Show a QR code").click()
        expect(page.get_by_role("img", name="QR code of the link")).to_be_visible()
        link = asked.value.post_data_json["text"]
    secret, rest = re.fullmatch(rf"{at}/record#/key/(rho_[\w-]+)(/.*)", link).groups()
    assert rest == "/next/room/1.0,2.0,90"
    store.refresh()
    assert store.find(secret).scope is Scope.MAP
    assert httpx.get(f"{locked.url}/v1/maps", headers={"Authorization": f"Bearer {secret}"}).is_success
    with browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True) as context:
        page = context.new_page()
        page.goto(link)
        expect(page.get_by_text("For the map room")).to_be_visible()
        assert page.evaluate("localStorage.getItem('rholoc-api-key')") == secret  # for the upload, after a reload
        expect(page.get_by_role("heading", name="Go on with a phone")).to_have_count(0)
    browser.close()
