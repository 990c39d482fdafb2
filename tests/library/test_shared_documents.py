"""Cameras and keys that several processes share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import OperationalError

from rholoc.errors import Conflict, NotFound, UnknownCamera
from rholoc.geometry import Camera
from rholoc.library import CameraLibrary, CameraProfile, SiteLibrary
from rholoc.library.stores import CAMERAS, KEYS, SITES
from rholoc.localization import MapFinder
from rholoc.maps import Site, SiteMap
from rholoc.service.access.keys import KeyStore, Scope
from rholoc.storage import replica
from waiting import until

_CAMERA = CameraProfile(Camera(640, 480, 500.0, 500.0, 320.0, 240.0), {"rms_px": 0.2})


def test_cameras_are_shared(open_storage: Any, tmp_path: Path) -> None:
    one, other = open_storage(), open_storage()
    here, there = (CameraLibrary(shared.documents(CAMERAS)) for shared in (one, other))
    here.put("phone", _CAMERA)
    here.put("axis", _CAMERA)
    other.refresh()
    assert there.names() == ["axis", "phone"]
    assert there.get("phone") == _CAMERA
    there.delete("phone")
    one.refresh()
    assert here.names() == ["axis"]
    with pytest.raises(UnknownCamera):
        here.get("phone")
    there.put("phone", _CAMERA)
    one.refresh()
    assert here.get("phone") == _CAMERA, "a name may come back"


def test_keys_are_shared_and_only_their_hashes_are_kept(open_storage: Any, tmp_path: Path) -> None:
    one, other = open_storage(), open_storage()
    here, there = (KeyStore(shared.documents(KEYS)) for shared in (one, other))
    secret = here.create("robot", Scope.LOCALIZE)
    other.refresh()
    found = there.find(secret)
    assert found is not None
    assert (found.name, found.scope) == ("robot", Scope.LOCALIZE)
    assert not any(secret.encode() in path.read_bytes() for path in (tmp_path / "data").glob("jobs.sqlite*"))
    there.revoke("robot")
    one.refresh()
    here.refresh()
    assert here.find(secret) is None
    with pytest.raises(NotFound):
        here.revoke("robot")


def test_sites_are_shared(open_storage: Any, tmp_path: Path) -> None:
    one, other = open_storage(), open_storage()
    here, there = (SiteLibrary(shared.documents(SITES)) for shared in (one, other))
    here.put("campus", Site(maps=(SiteMap("hall"),)))
    other.refresh()
    assert there.get("campus").maps == (SiteMap("hall"),)
    assert there.put("campus", Site(), replaces=1).version == 2
    one.refresh()
    assert here.get("campus").maps == ()
    here.put("campus", Site(maps=(SiteMap("kitchen"),)), replaces=2)
    with pytest.raises(Conflict, match="version 3"):
        there.put("campus", Site(), replaces=2)  # which has not heard of the third
    assert there.get("campus").maps == (SiteMap("kitchen"),)


def test_each_server_indexes_the_maps_that_others_publish(open_storage: Any, tmp_path: Path, picture_world) -> None:
    one, other = open_storage(), open_storage()
    finder = MapFinder(other.library, tmp_path / "views.sqlite")
    finder.refresh()
    assert finder.counts() == {"present": 0, "indexed": 0}
    one.library.put("hall", picture_world.map_)
    other.refresh()
    finder.refresh()
    assert finder.counts() == {"present": 1, "indexed": 1}
    one.library.delete("hall")
    other.refresh()
    finder.refresh()
    assert finder.counts() == {"present": 0, "indexed": 0}


@pytest.mark.slow
def test_postgres_tells_of_changes(
    open_storage: Any, tmp_path: Path, postgres: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also after it was started again: meanwhile it is asked, as it is where a database tells nothing."""
    url = postgres.create_database("tells_of_changes")
    one, other = open_storage(url), open_storage(url, follow=True)
    here, there = (CameraLibrary(shared.documents(CAMERAS)) for shared in (one, other))
    listening = sa.text("SELECT count(*) FROM pg_stat_activity WHERE query LIKE 'LISTEN%'")

    def is_listening() -> bool:
        try:
            with one.engine.connect() as connection:
                return connection.execute(listening).scalar() == 1
        except OperationalError:
            return False

    monkeypatch.setattr(replica, "FOLLOW_EVERY_S", 3600.0)
    until(is_listening)
    here.put("phone", _CAMERA)
    until(lambda: there.names() == ["phone"])
    monkeypatch.setattr(replica, "FOLLOW_EVERY_S", 0.1)
    here.put("axis", _CAMERA)  # wakes the follower, which then asks often
    postgres.stop()
    postgres.start()
    until(is_listening)
    here.delete("phone")
    until(lambda: there.names() == ["axis"])
