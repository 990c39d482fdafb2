"""Keep what this version makes and offers, for the tests of later ones.

``PYTHONPATH=tests python tests/contract/keep.py`` writes ``kept/VERSION``, and refuses if there is one.
"""

import json
import shutil
import sqlite3
import sys
import tempfile
from pathlib import Path

import cv2
from offers import present_offers

from kept_queries import a_query
from rholoc import Localizer, Query, __version__, build_map, load_map, read_recording, save_map
from rholoc.features import get_extractor
from rholoc.geometry import Camera
from rholoc.jobs import JobOptions, JobQueue, UploadStore
from rholoc.jobs.leases import Leases
from rholoc.library.cameras import CameraLibrary, CameraProfile
from rholoc.library.queries import QueryStore
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import CAMERAS, KEYS, SITES, Stores
from rholoc.mapping import BuildOptions
from rholoc.maps import FramePose, Site, SiteMap
from rholoc.service.access.audit import AuditLog, Change
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.operate.backup import back_up
from rholoc.simulation import simulate_recording
from rholoc.storage.holdings_table import Holding, Holdings, Kind
from synthetic_map import synthetic_map

KEPT = Path(__file__).with_name("kept")
SECRET_FILE, DUMP, ANSWER, QUERY, OFFERS, BACKUP = (
    "secret.txt",
    "database.sql",
    "answer.json",
    "query.jpg",
    "offers.json",
    "backup.tar",
)
MAP, TINY, CAMERA_NAME, SITE_NAME, KEY_NAME = "room", "tiny", "phone", "home", "robot"
VIDEO = b"\0\0\0\x18ftypmp42 a walk"
CAMERA = CameraProfile(Camera(640, 480, 520.0, 521.0, 319.5, 239.5, (0.1, -0.2, 0.0, 0.0)), {"rms_px": 0.2})
SITE = Site(maps=(SiteMap(MAP, floor="1", given=FramePose(), pose=FramePose()), SiteMap(TINY)))
_FRAME = 10


def keep(folder: Path) -> None:
    """Write all that is kept of this version into a folder."""
    server = folder / "server"
    _keep_walk(server / "maps" / f"{MAP}.rho", folder)
    _keep_server(server, folder)
    offers = json.dumps(present_offers(), indent=0, ensure_ascii=False)
    (folder / OFFERS).write_text(f"{offers}\n", encoding="utf-8")


def _keep_walk(map_file: Path, folder: Path) -> None:
    """A map of a simulated walk, one of its pictures, and where this version localizes it."""
    with tempfile.TemporaryDirectory() as walk:
        map_file.parent.mkdir(parents=True)
        simulate_recording(Path(walk), seconds=3.5, fps=6.0, seed=3)
        save_map(build_map([read_recording(walk)], BuildOptions(features="gray")), map_file)
        image = next(iter(read_recording(walk).frames.images([_FRAME])))
    cv2.imwrite(str(folder / QUERY), image, [cv2.IMWRITE_JPEG_QUALITY, 80])
    map_ = load_map(map_file)
    picture, features = cv2.imread(str(folder / QUERY)), get_extractor(map_.info.features)
    answer = Localizer(map_).localize(Query.of_picture(picture, features, map_.info.camera))
    kept = {"landmarks": len(map_), "id": map_.info.id, "T_map_camera": answer.pose.T_map_camera.tolist()}
    (folder / ANSWER).write_text(json.dumps(kept), encoding="utf-8")


def _keep_server(server: Path, folder: Path) -> None:
    """The folders of a server and its database, and the storage that it shares with others."""
    maps_dir, data_dir = server / "maps", server / "data"
    alone = Stores(maps_dir, data_dir)
    shared = Stores(maps_dir, data_dir, storage_url=(server / "storage").resolve().as_uri())
    for stores in (alone, shared):
        stores.open()
        stores.library.put(TINY, synthetic_map())
        stores.library.put(TINY, synthetic_map(seed=2))
        CameraLibrary(stores.documents(CAMERAS)).put(CAMERA_NAME, CAMERA)
        SiteLibrary(stores.documents(SITES)).put(SITE_NAME, SITE)
        secret = KeyStore(stores.documents(KEYS)).create(KEY_NAME, Scope.MAP)
        (folder / f"{'shared-' if stores.are_shared else ''}{SECRET_FILE}").write_text(secret, encoding="utf-8")
    _keep_jobs(alone)
    back_up(folder / BACKUP, shared)
    for stores in (alone, shared):
        stores.close()
    database = data_dir / "jobs.sqlite"
    connection = sqlite3.connect(database)
    (folder / DUMP).write_text("\n".join(connection.iterdump()) + "\n", encoding="utf-8")
    connection.close()
    for file in data_dir.glob("jobs.sqlite*"):
        file.unlink()
    shutil.rmtree(data_dir / "copies")


def _keep_jobs(stores: Stores) -> None:
    """A published and a queued job, an unfinished upload, a kept query, a noted change and a key's holding."""
    queue, leases = JobQueue(stores.recordings), Leases(stores.engine)
    entry = stores.recordings.create([("walk.mp4", [VIDEO])])
    stores.recordings.note(entry.id, {".waypoints.csv": b"name,time,x,y,z\nW1,0.5,1,2,1.5\n"})
    queue.submit(entry.id, MAP)
    claim = leases.take("a worker")
    leases.publish(claim.lease, ("It is only a test.",))
    queue.submit(entry.id, TINY, JobOptions(pictures=True))
    uploads = UploadStore(stores.recordings, queue, 1e10)
    upload = uploads.create("more.mp4", 2 * len(VIDEO), MAP, JobOptions())
    uploads.append(upload.id, 0, VIDEO)
    QueryStore(stores.objects).add("a" * 32, a_query())
    AuditLog(stores.engine).note(Change(1e9, KEY_NAME, "DELETE", f"/v1/maps/{MAP}", 204, "", "request"))
    Holdings(stores.engine).hold(Holding(Kind.MAP, MAP, KEY_NAME))


if __name__ == "__main__":
    target = KEPT / __version__
    if target.exists():
        sys.exit(f"{target} exists: what a release made and offered does not change. Was the version counted up?")
    keep(target)
