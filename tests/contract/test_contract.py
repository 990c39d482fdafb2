"""What earlier versions made is read, and what they offered is still there; see CONTRIBUTING.md."""

import json
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import cv2
import keep
import numpy as np
import pytest
from offers import broken_promises, present_offers

from rholoc import Localizer, Query, load_map
from rholoc.features import get_extractor
from rholoc.jobs import JobQueue, JobState, UploadStore
from rholoc.library.cameras import CameraLibrary
from rholoc.library.queries import QueryStore
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import CAMERAS, KEYS, SITES, Stores
from rholoc.service.access.audit import AuditLog
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.service.operate.backup import restore
from rholoc.storage.holdings_table import Holdings, Kind

VERSIONS = sorted(keep.KEPT.iterdir())


@pytest.fixture(params=VERSIONS, ids=lambda folder: folder.name)
def kept(request: pytest.FixtureRequest) -> Path:
    """The folder with what a version made and offered."""
    return request.param


@pytest.fixture
def server(kept: Path, tmp_path: Path) -> Path:
    """A copy of the folders that a version's server left behind."""
    shutil.copytree(kept / "server", tmp_path / "server")
    connection = sqlite3.connect(tmp_path / "server" / "data" / "jobs.sqlite")
    connection.executescript((kept / keep.DUMP).read_text(encoding="utf-8"))
    connection.close()
    return tmp_path / "server"


@pytest.fixture(params=["alone", "shared"])
def stores(server: Path, request: pytest.FixtureRequest) -> Iterator[Stores]:
    """The stores of a server on these folders, or on the storage beside them."""
    url = (server / "storage").as_uri() if request.param == "shared" else None
    stores = Stores(server / "maps", server / "data", storage_url=url)
    stores.open()
    yield stores
    stores.close()


@pytest.mark.parametrize("kind", ["routes", "commands", "settings", "python"])
def test_what_was_offered_is_still_there(kept: Path, kind: str) -> None:
    before = json.loads((kept / keep.OFFERS).read_text(encoding="utf-8"))
    assert broken_promises(before[kind], present_offers()[kind]) == []


def test_a_map_localizes_as_it_did(kept: Path) -> None:
    answer = json.loads((kept / keep.ANSWER).read_text(encoding="utf-8"))
    map_ = load_map(kept / "server" / "maps" / f"{keep.MAP}.rho")
    assert (map_.info.id, len(map_)) == (answer["id"], answer["landmarks"])
    assert map_.info.report.coverage is not None
    picture = cv2.imread(str(kept / keep.QUERY))
    query = Query.of_picture(picture, get_extractor(map_.info.features), map_.info.camera)
    pose = Localizer(map_).localize(query).pose
    np.testing.assert_allclose(pose.T_map_camera, answer["T_map_camera"], rtol=0, atol=0.02)


def test_a_server_has_its_maps_cameras_sites_and_keys(stores: Stores, kept: Path) -> None:
    wanted = [keep.TINY] if stores.are_shared else [keep.MAP, keep.TINY]
    assert stores.library.readable() == wanted
    assert list(stores.library.versions(keep.TINY)) == [1]
    assert len(stores.library.get(keep.TINY)) > 0
    stores.library.restore(keep.TINY)
    assert CameraLibrary(stores.documents(CAMERAS)).get(keep.CAMERA_NAME) == keep.CAMERA
    assert SiteLibrary(stores.documents(SITES)).get(keep.SITE_NAME) == keep.SITE
    secret = (kept / f"{'shared-' if stores.are_shared else ''}{keep.SECRET_FILE}").read_text(encoding="utf-8")
    key = KeyStore(stores.documents(KEYS)).find(secret)
    assert (key.name, key.scope) == (keep.KEY_NAME, Scope.MAP)


def test_a_server_has_its_jobs_recordings_uploads_and_queries(server: Path) -> None:
    stores = Stores(server / "maps", server / "data")
    queue = JobQueue(stores.recordings)
    queued, published = queue.list()
    assert (queued.state, published.state) == (JobState.QUEUED, JobState.PUBLISHED)
    assert published.warnings == ("It is only a test.",)
    assert stores.recordings.path(published.recording).read_bytes() == keep.VIDEO
    assert list(stores.recordings.notes(published.recording)) == [".waypoints.csv"]
    uploads = UploadStore(stores.recordings, queue, 1e10)
    (upload,) = uploads.unfinished()
    ended = uploads.append(upload, len(keep.VIDEO), keep.VIDEO)
    assert ended.job is not None
    assert stores.recordings.path(upload).read_bytes() == 2 * keep.VIDEO
    (query,) = QueryStore(stores.objects).load("a" * 32)
    assert query.confidence == 0.97
    assert [one.who for one in AuditLog(stores.engine).changes(10)] == [keep.KEY_NAME]
    assert [one.kind for one in Holdings(stores.engine).of([keep.KEY_NAME])] == [Kind.MAP]
    stores.close()


def test_a_backup_is_restored(kept: Path, tmp_path: Path) -> None:
    stores = Stores(tmp_path / "maps", tmp_path / "data")
    restore(kept / keep.BACKUP, stores)
    assert stores.library.readable() == [keep.TINY]
    assert CameraLibrary(tmp_path / "maps").names() == [keep.CAMERA_NAME]
    stores.close()


def test_a_broken_promise_is_noticed() -> None:
    before = {"takes": {"a": True, "b": False}, "in_order": ["a"], "gives": ["x"]}
    more = {"takes": {"a": False, "b": False, "c": False}, "in_order": ["a", "c"], "gives": ["x", "y"]}
    assert broken_promises({"f": before}, {"f": more, "g": before}) == []
    assert broken_promises({"f": before}, {}) == ["f is gone"]
    less = {"takes": {"b": True, "d": True}, "in_order": ["b"], "gives": []}
    assert len(broken_promises({"f": before}, {"f": less})) == 5
