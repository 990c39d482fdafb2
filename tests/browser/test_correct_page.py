"""A map made right on its page: drawn with the pointer, typed, undone."""

import json

import cv2
import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from rholoc.maps import save_map


@pytest.fixture
def hall(service, point_room):
    save_map(point_room.map_of(point_room.walk(30), "walk"), service.settings.maps_dir / "hall.rho")
    return lambda: httpx.get(f"{service.url}/v1/maps/hall").json()


def choose(page, text):
    page.get_by_label("What is to be corrected?").select_option(label=text)


def drag(page, start, end):
    """From one place of the map's picture to another, in shares of its size."""
    box = page.locator(".plan-view").bounding_box()
    (x0, y0), (x1, y1) = ((box["x"] + u * box["width"], box["y"] + v * box["height"]) for u, v in (start, end))
    page.mouse.move(x0, y0)
    page.mouse.down()
    page.mouse.move((x0 + x1) / 2, (y0 + y1) / 2)
    page.mouse.move(x1, y1)
    page.mouse.up()


def apply(page):
    page.get_by_role("button", name="Apply").click()
    expect(page.get_by_text("The version before can be restored")).to_be_visible()
    page.evaluate("document.querySelector('.toast').remove()")


@pytest.mark.slow
def test_a_frame_is_dragged_a_distance_measured_and_all_of_it_undone(desk_browser, service, hall, opened, settled):
    with opened(desk_browser, service.url, "maps/hall/correct") as page:
        settled(page)
        for field, value in zip("xyz", ("1.5", "-0.5", "0.2"), strict=True):
            page.get_by_label(field, exact=True).fill(value)
        apply(page)
        np.testing.assert_allclose(hall()["corrections"][-1]["translation"], [-1.5, 0.5, -0.2])
        choose(page, "Axis along a wall")
        drag(page, (0.4, 0.5), (0.4, 0.2))  # straight up: what was y is x now
        apply(page)
        np.testing.assert_allclose(hall()["corrections"][-1]["rotation"][0], [0, 1, 0], atol=0.02)
        choose(page, "Distance")
        drag(page, (0.4, 0.5), (0.6, 0.5))
        said = page.locator("form [role=status]").inner_text()
        page.get_by_label("True length, m").fill("3")
        apply(page)
        before = float(said.split()[0]) / (100 if " cm" in said else 1)
        assert hall()["corrections"][-1]["scale"] == pytest.approx(3 / before, rel=0.02)
        versions = page.locator("section", has_text="Versions")
        expect(versions).to_contain_text("Now: version 4, scale")
        versions.locator("li", has_text="Version 1, of").get_by_role("button", name="Restore").click()
        expect(versions).to_contain_text("Now: version 1")
        assert hall()["corrections"] == []


@pytest.mark.slow
def test_a_region_a_piece_of_the_walk_and_names(desk_browser, service, hall, opened, settled):
    with opened(desk_browser, service.url, "maps/hall/correct") as page:
        settled(page)
        before = hall()
        choose(page, "Crop or delete a region")
        drag(page, (0.5, 0.02), (0.98, 0.98))
        expect(page.locator("form [role=status]")).to_contain_text("landmarks inside")
        inside = int(page.locator("form [role=status]").inner_text().split()[0])
        assert 0 < inside < before["landmarks"]
        apply(page)
        assert hall()["landmarks"] == before["landmarks"] - inside
        choose(page, "Delete a piece of the walk")
        page.get_by_label("First picture").fill("21")
        page.get_by_label("Last picture").fill("30")
        apply(page)
        assert hall()["views"] == 20
        choose(page, "Name an area")
        drag(page, (0.3, 0.3), (0.6, 0.6))
        page.get_by_label("Name", exact=True).fill("kitchen")
        apply(page)
        assert [area["name"] for area in hall()["names"]["areas"]] == ["kitchen"]
        choose(page, "Name a point")
        page.locator(".plan-view").click(position={"x": 200, "y": 200})
        page.get_by_label("Name", exact=True).fill("door")
        page.get_by_label("Kind").fill("way out")
        page.get_by_label("More: name=value, …").fill("width_m=0.9, owner=Ada, open=true")
        apply(page)
        door = hall()["names"]["points"][0]
        assert (door["position"][2], door["kind"]) == (0, "way out")
        assert door["fields"] == {"width_m": 0.9, "owner": "Ada", "open": True}
        expect(page.locator("section li", has_text="door")).to_contain_text(
            "way out, open: true, owner: Ada, width_m: 0.9"
        )
        page.locator("section li", has_text="kitchen").get_by_role("button", name="Delete").click()
        expect(page.locator("section li", has_text="kitchen")).to_have_count(0)
        assert hall()["names"]["areas"] == []
        assert Axe().run(page).violations_count == 0
        page.goto(f"{service.url}/#/maps/hall")
        expect(settled(page).locator(".scene-labels")).to_contain_text("door")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["picture", "geojson"])
def test_a_map_is_laid_over_a_floor_plan(kind, desk_browser, service, hall, opened, settled, tmp_path):
    if kind == "picture":
        path = tmp_path / "plan.png"
        cv2.imwrite(str(path), cv2.rectangle(np.full((300, 400, 3), 200, np.uint8), (20, 20), (380, 280), 0, 4))
    else:
        path = tmp_path / "plan.geojson"
        ring = [[8.0, 50.0], [8.0001, 50.0], [8.0001, 50.0001], [8.0, 50.0001], [8.0, 50.0]]
        path.write_text(json.dumps({"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [ring]}}))
    with opened(desk_browser, service.url, "maps/hall/correct") as page:
        settled(page)
        choose(page, "Floor plan")
        page.get_by_label("Picture or GeoJSON").set_input_files(path)
        if kind == "picture":
            page.get_by_label("Width of the plan, m").fill("20")
        page.get_by_label("The map takes the plan's scale").check()
        plan = page.get_by_role("img", name="Floor plan")
        expect(plan).to_be_visible()
        box = plan.bounding_box()
        for u in (0.25, 0.75):
            page.locator(".plan-view").click(position={"x": 100 + 400 * (u - 0.25), "y": 200})
            plan.click(position={"x": u * box["width"], "y": 0.5 * box["height"]})
        expect(page.locator("form [role=status]")).to_contain_text("A to B")
        apply(page)
        done = hall()["corrections"][-1]
        assert done["kind"] == "floor-plan"
        laid = hall()["corrections"][-2]
        assert laid["kind"] == "plan"
        assert laid["residual_m"] == pytest.approx(0, abs=1e-6)
        kept = hall()["plan"]
        assert kept["media_type"] == ("image/png" if kind == "picture" else "application/geo+json")
        assert kept["m_per_unit"] == pytest.approx(20 / 400 if kind == "picture" else 1)
        # it lies on the floor of the room, and at the next visit under the map
        page.goto(f"{service.url}/#/maps/hall")
        room = settled(page).locator("canvas.scene-canvas")
        toggle = page.get_by_role("button", name="Floor plan")
        expect(toggle).to_have_attribute("aria-pressed", "true")
        page.wait_for_timeout(300)
        on_floor = room.screenshot()
        toggle.click()
        page.wait_for_timeout(300)
        assert room.screenshot() != on_floor
        page.goto(f"{service.url}/#/maps/hall/correct")
        settled(page)
        drawn = page.locator(".plan-view")
        page.wait_for_timeout(300)
        with_plan = drawn.screenshot()
        page.get_by_role("button", name="Remove the plan").click()
        expect(page.get_by_role("button", name="Remove the plan")).to_have_count(0)
        page.wait_for_timeout(300)
        assert hall()["plan"] is None
        assert drawn.screenshot() != with_plan


def test_names_leave_and_come_as_geojson(desk_browser, service, hall, opened, settled, tmp_path):
    named = {"kind": "names", "points": [{"name": "dock", "kind": "charger", "position": [1, 2, 0]}]}
    httpx.post(f"{service.url}/v1/maps/hall/corrections", json=named).raise_for_status()
    with opened(desk_browser, service.url, "maps/hall/correct") as page:
        settled(page)
        with page.expect_download() as saving:
            page.get_by_role("button", name="Save names as GeoJSON").click()
        saved = json.loads(saving.value.path().read_text())
        assert [one["properties"] for one in saved["features"]] == [{"name": "dock", "kind": "charger"}]
        saved["features"][0]["properties"]["name"] = "berth"
        (tmp_path / "names.geojson").write_text(json.dumps(saved))
        page.get_by_text("Open a file").click()
        page.locator("details input[type=file]").set_input_files(tmp_path / "names.geojson")
        page.get_by_role("button", name="Open", exact=True).click()
        expect(page.locator("section li", has_text="berth")).to_be_visible()
        assert [one["name"] for one in hall()["names"]["points"]] == ["berth"]


@pytest.mark.slow
def test_what_the_server_refuses_is_said(desk_browser, service, hall, opened, settled, tmp_path):
    with opened(desk_browser, service.url, "maps/hall/correct", failures=1) as page:
        settled(page)
        httpx.post(f"{service.url}/v1/maps/hall/corrections", json={"kind": "origin", "at": [1, 0, 0]})
        page.get_by_label("x", exact=True).fill("2")
        page.get_by_role("button", name="Apply").click()
        expect(page.locator(".toast.bad")).to_contain_text("now at version 2")
        choose(page, "Floor plan")
        (tmp_path / "plan.json").write_text("[1, 2")
        page.get_by_label("Picture or GeoJSON").set_input_files(tmp_path / "plan.json")
        expect(page.locator(".toast.bad")).to_contain_text("not JSON")
