"""The JavaScript client against a real service: the same answers as Python's, and pages of other sites."""

import json
import shutil
import subprocess
from pathlib import Path

import httpx
import pytest

from rholoc_client import Client

MODULE = Path(__file__).parents[2] / "client" / "js" / "index.js"
SITE = "https://app.example"
PROGRAM = """
import { readFile } from "node:fs/promises";
const [, , module, url, picture] = process.argv;
const { Client } = await import(module);
const rholoc = new Client(url);
const answer = await rholoc.localize("room", await readFile(picture), { camera: {} });
const several = await rholoc.localize(["room", "loose"], await readFile(picture));
const names = (await rholoc.maps()).map(({ name }) => name);
const room = await rholoc.map("room");
let refused;
try {
  await rholoc.localize("attic", await readFile(picture));
} catch (error) {
  refused = [error.code, error.status, error.hint !== ""];
}
const film = new Blob(["\\0\\0\\0\\x18ftypisom", new Uint8Array(3_000_000)]);
const job = await rholoc.upload(film, { map: "hall", name: "walk.mp4" });
const { state } = await rholoc.job(job);
console.log(JSON.stringify({ answer, several, names, room, refused, state }));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="Node.js is not installed")
def test_answers_are_those_of_the_python_client(service, picture_world, tmp_path):
    picture, program = tmp_path / "frame.png", tmp_path / "ask.mjs"
    picture.write_bytes(picture_world.png())
    program.write_text(PROGRAM)
    command = ["node", str(program), MODULE.as_uri(), service.url, str(picture)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert said.returncode == 0, said.stderr
    found = json.loads(said.stdout)
    with Client(service.url) as client:
        known = client.localize("room", picture)
    assert found["answer"]["localized"]
    assert found["answer"]["pose"]["position"] == pytest.approx(known.pose.position, abs=1e-4)
    assert found["several"]["map"] in ("room", "loose")
    assert found["names"] == ["loose", "room"]
    assert found["room"]["name"] == "room"
    assert found["refused"] == ["unknown_map", 404, True]
    assert found["state"] in ("queued", "running", "failed")


def test_pages_of_listed_sites_may_ask_and_no_others(serve, picture_world):
    running = serve(origins=f"{SITE},http://localhost:3000")
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    asked = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization,content-type"}
    cross = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}
    with httpx.Client(base_url=running.url) as http:
        for origin in (SITE, "http://localhost:3000"):
            allowed = http.options("/v1/maps/room/localize", headers={"Origin": origin, **asked, **cross})
            assert (allowed.status_code, allowed.headers["access-control-allow-origin"]) == (200, origin)
            answer = http.post(
                "/v1/maps/room/localize",
                content=picture_world.png(),
                headers={"Origin": origin, "Content-Type": "image/png", **cross},
            )
            assert answer.json()["localized"]
            assert answer.headers["access-control-allow-origin"] == origin
            missing = http.get("/v1/maps/attic", headers={"Origin": origin, **cross})
            assert (missing.status_code, missing.headers["access-control-allow-origin"]) == (404, origin)
        for origin in ("https://elsewhere.example", f"{SITE}.evil.example", "null"):
            refused = http.get("/v1/maps", headers={"Origin": origin, **cross})
            assert (refused.status_code, refused.json()["code"]) == (403, "cross_site")
            assert "access-control-allow-origin" not in refused.headers
            assert (
                "access-control-allow-origin"
                not in http.options("/v1/maps/room/localize", headers={"Origin": origin, **asked, **cross}).headers
            )


def test_without_a_list_nothing_is_said_of_other_sites(service):
    answer = httpx.get(f"{service.url}/v1/maps", headers={"Origin": SITE, "Sec-Fetch-Site": "cross-site"})
    assert answer.status_code == 403
    assert "access-control-allow-origin" not in answer.headers
