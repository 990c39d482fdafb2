"""Cameras and keys that several processes share; named cameras beside the maps."""

from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import OperationalError

from rholoc.errors import Conflict, InvalidCamera, InvalidInput, InvalidName, NotFound, UnknownCamera
from rholoc.geometry import Camera
from rholoc.library.cameras import CameraLibrary, CameraProfile
from rholoc.library.maps import MapLibrary
from rholoc.library.sites import SiteLibrary
from rholoc.library.stores import CAMERAS, KEYS, SITES
from rholoc.localization import MapFinder
from rholoc.maps import Site, SiteMap
from rholoc.recordings import read_camera_json
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


_OTHER_CAMERA = Camera(1920, 1080, 1510.2, 1509.8, 959.5, 539.5, (0.08, -0.17, 0.0, 0.0, 0.09))


@pytest.fixture
def cameras(tmp_path: Path) -> CameraLibrary:
    return CameraLibrary(tmp_path / "maps")


def test_a_camera_comes_back_as_it_was_put(cameras: CameraLibrary) -> None:
    assert cameras.names() == []
    profile = CameraProfile(_OTHER_CAMERA, {"rms_px": 0.21, "sigmas_px": {"fx": 0.8}})
    cameras.put("pixel-7", profile)
    cameras.put("axis.door", CameraProfile(Camera(640, 480, 500, 500, 320, 240)))
    assert cameras.names() == ["axis.door", "pixel-7"]
    assert cameras.get("pixel-7") == profile
    cameras.put("pixel-7", CameraProfile(_OTHER_CAMERA))
    assert cameras.get("pixel-7").calibration == {}
    cameras.delete("pixel-7")
    assert cameras.names() == ["axis.door"]


def test_the_files_serve_as_a_recordings_camera_json(cameras: CameraLibrary, tmp_path: Path) -> None:
    cameras.put("pixel-7", CameraProfile(_OTHER_CAMERA, {"rms_px": 0.21}))
    assert read_camera_json(tmp_path / "maps" / "cameras" / "pixel-7.json").camera == _OTHER_CAMERA


def test_cameras_are_not_maps(cameras: CameraLibrary, tmp_path: Path) -> None:
    cameras.put("pixel-7", CameraProfile(_OTHER_CAMERA))
    assert MapLibrary(tmp_path / "maps").names() == []


@pytest.mark.parametrize("name", ["", "..", "a/b", "../maps/x", "-x", ".x", "x" * 65, "a\n", "é"])
def test_what_is_no_name_is_refused(cameras: CameraLibrary, name: str) -> None:
    for act in (cameras.get, cameras.delete, lambda name: cameras.put(name, CameraProfile(_OTHER_CAMERA))):
        with pytest.raises(InvalidName, match="is not a valid camera name"):
            act(name)


def test_an_unknown_camera_is_reported_with_those_there_are(cameras: CameraLibrary) -> None:
    with pytest.raises(UnknownCamera, match=r"no camera pixel-7.*none yet"):
        cameras.get("pixel-7")
    cameras.put("axis", CameraProfile(_OTHER_CAMERA))
    for act in (cameras.get, cameras.delete, cameras.named_in):
        with pytest.raises(UnknownCamera, match="There are: axis"):
            act("pixel-7")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"width": 640}', "\x00", '{"width": "a"}', "[" * 100_000])
def test_a_broken_file_is_reported(cameras: CameraLibrary, text: str, tmp_path: Path) -> None:
    cameras.put("axis", CameraProfile(_OTHER_CAMERA))
    (tmp_path / "maps" / "cameras" / "axis.json").write_text(text)
    with pytest.raises(InvalidCamera, match="axis is broken"):
        cameras.get("axis")


def test_intrinsics_and_names_are_told_apart(cameras: CameraLibrary) -> None:
    cameras.put("axis", CameraProfile(_OTHER_CAMERA))
    assert cameras.named_in("axis") == _OTHER_CAMERA
    assert cameras.named_in("500,500,320,240") == "500,500,320,240"
    assert cameras.named_in(None) is None


@pytest.mark.parametrize("value", [float("nan"), {1, 2}])
def test_a_calibration_that_is_not_json_is_refused(cameras: CameraLibrary, value: object) -> None:
    with pytest.raises(InvalidInput, match="plain JSON"):
        cameras.put("axis", CameraProfile(_OTHER_CAMERA, {"rms_px": value}))
    assert cameras.names() == []


def test_a_camera_that_cannot_be_stored_replaces_nothing(cameras: CameraLibrary, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "cameras").write_text("a file stands where the folder would")
    with pytest.raises(InvalidInput, match="cannot be created"):
        cameras.put("axis", CameraProfile(_OTHER_CAMERA))
