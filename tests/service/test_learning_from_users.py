"""Maps that learn from their users, over HTTP: what is kept of whose queries, and how it is learned and deleted."""

from datetime import UTC, datetime

import httpx
import numpy as np
import pytest

from kept_queries import LATELY_S, keep_queries
from rholoc.features import get_extractor
from rholoc.jobs import JobKind
from rholoc.jobs.leases import Leases
from rholoc.jobs.table import JobTable
from rholoc.library.maps import MapLibrary
from rholoc.mapping.learn import from_queries
from rholoc.maps import load_map, save_map
from rholoc.service.access.keys import HANDED_PREFIX, KeyStore, Scope
from rholoc.service.frames.kept import learning
from rholoc.service.housekeeping import learn_tonight
from rholoc.service.settings import KeyPolicy
from waiting import until

PNG = {"Content-Type": "image/png"}


@pytest.fixture(autouse=True)
def _the_picture_is_sure(monkeypatch):
    """Four views of one picture make no map to be quite sure in."""
    monkeypatch.setattr(learning, "TEACHES_FROM", 0.7)


def ask(service, world, **headers):
    answer = httpx.post(
        f"{service.url}/v1/maps/room/localize", content=world.png(), headers={**PNG, **headers}, timeout=60
    )
    assert answer.json()["localized"], answer.text
    return answer.json()


def settled(service):
    """Everything that was answered so far is kept, or was found not to be wanted."""
    learner = service.app.state.rholoc.frames.learner
    until(lambda: learner.idle)
    return service.app.state.rholoc.learning.store


@pytest.fixture
def listening(serve, picture_world):
    """A service that keeps queries."""
    running = serve(learn=True)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    return running


def test_nothing_is_kept_by_default(service, picture_world):
    ask(service, picture_world)
    assert settled(service).kept(picture_world.map_.info.id).queries == 0
    said = httpx.get(f"{service.url}/v1/maps/room/learning").json()
    assert (said["learns"], said["queries"], said["last"]) == (False, 0, None)


def test_a_sure_answer_keeps_its_features_and_no_picture(listening, picture_world):
    answer = ask(listening, picture_world)
    store, map_id = settled(listening), picture_world.map_.info.id
    (kept,) = store.load(map_id)
    np.testing.assert_allclose(kept.T_map_camera, answer["pose"]["T_map_camera"])
    expected = get_extractor("gray").extract(picture_world.image)
    np.testing.assert_array_equal(kept.features.descriptors, expected.descriptors)
    np.testing.assert_array_equal(kept.features.pixels, expected.pixels)
    (file,) = (listening.settings.data_dir / "queries" / map_id).iterdir()
    assert file.stat().st_size < 100 * len(expected) + 4096  # a picture would not fit
    ask(listening, picture_world)  # at once, from the same place
    assert settled(listening).kept(map_id).queries == 1
    said = httpx.get(f"{listening.url}/v1/maps/room/learning").json()
    assert (said["learns"], said["queries"], said["askers"], said["fewest"]) == (True, 1, 1, 30)


def test_queries_that_are_not_kept_are_answered_all_the_same(listening, picture_world, monkeypatch):
    def fail(*_):
        raise OSError("the disk is gone")

    with monkeypatch.context() as full:
        full.setattr(listening.app.state.rholoc.learning.store, "add", fail)
        assert ask(listening, picture_world)["localized"]
        assert settled(listening)
    assert ask(listening, picture_world)["localized"]
    assert settled(listening).kept(picture_world.map_.info.id).queries == 1


def test_blank_pictures_and_guessed_cameras_teach_nothing(listening, picture_world):
    httpx.post(
        f"{listening.url}/v1/maps/room/localize?intrinsics=unknown",
        content=picture_world.png(),
        headers=PNG,
        timeout=60,
    )
    assert settled(listening).kept(picture_world.map_.info.id).queries == 0


@pytest.mark.parametrize("handed_teach", [False, True])
def test_barred_and_handed_keys_teach_nothing(serve, picture_world, handed_teach):
    running = serve(
        learn=True, learn_not_from="robot-7, robot-8", learn_from_handed=handed_teach, keys=KeyPolicy.ALWAYS
    )
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    keys, map_id = KeyStore(running.settings.data_dir), picture_world.map_.info.id
    found = {}
    for name in ("robot-7", "robot-8", f"{HANDED_PREFIX}1", "robot-9"):
        secret = keys.create(name, Scope.LOCALIZE)
        ask(running, picture_world, Authorization=f"Bearer {secret}")
        found[name] = settled(running).delete(map_id)
    assert found == {"robot-7": 0, "robot-8": 0, f"{HANDED_PREFIX}1": int(handed_teach), "robot-9": 1}


def test_what_one_asked_is_deleted_by_the_name_of_its_key(serve, picture_world):
    running = serve(learn=True, keys=KeyPolicy.ALWAYS)
    (running.settings.maps_dir / "room.rho").write_bytes(picture_world.rho())
    keys = KeyStore(running.settings.data_dir)
    for name in ("robot-1", "robot-2"):
        ask(running, picture_world, Authorization=f"Bearer {keys.create(name, Scope.LOCALIZE)}")
    kept = settled(running).kept(picture_world.map_.info.id)
    assert (kept.queries, kept.askers) == (2, 2)
    names = [path.name for path in (running.settings.data_dir / "queries" / picture_world.map_.info.id).iterdir()]
    assert not any("robot" in name for name in names)
    admin = {"Authorization": f"Bearer {keys.create('operator', Scope.MAP)}"}
    with httpx.Client(base_url=running.url, headers=admin, timeout=60) as http:
        assert http.delete("/v1/maps/room/learning?asker=robot-1").json() == {"deleted": 1}
        assert http.delete("/v1/maps/room/learning?asker=nobody").json() == {"deleted": 0}
        assert http.delete("/v1/maps/room/learning").json() == {"deleted": 1}


def test_a_map_takes_what_is_kept_for_it_with_it(listening, picture_world):
    ask(listening, picture_world)
    assert settled(listening).kept(picture_world.map_.info.id).queries == 1
    assert httpx.delete(f"{listening.url}/v1/maps/room").status_code == 204
    assert settled(listening).kept(picture_world.map_.info.id).queries == 0


@pytest.fixture(scope="module")
def asked_often(serve, point_room, picture_world):
    """A service without a worker whose map ``west`` was asked often; and ``old``, which remembers nothing."""
    running = serve(learn=True)
    map_ = point_room.map_of(point_room.walk(80)[:45:2], "west")
    save_map(map_, running.settings.maps_dir / "west.rho")
    (running.settings.maps_dir / "old.rho").write_bytes(picture_world.rho())
    keep_queries(running.settings.data_dir, map_, point_room, LATELY_S)
    return running


def test_a_map_learns_by_a_job_one_at_a_time(asked_often):
    answer = httpx.post(f"{asked_often.url}/v1/maps/west/learn")
    assert answer.status_code == 202, answer.text
    job = answer.json()
    assert (job["recording"], job["map"], job["state"]) == ("", "west", "queued")
    assert answer.headers["Location"] == f"/v1/jobs/{job['id']}"
    assert httpx.get(f"{asked_often.url}/v1/maps/west/learning").json()["job"] == job["id"]
    assert httpx.get(f"{asked_often.url}/v1/maps/west/learning").json()["latest"] is None
    again = httpx.post(f"{asked_often.url}/v1/maps/west/learn")
    assert (again.status_code, again.json()["code"]) == (409, "conflict")
    assert httpx.delete(f"{asked_often.url}/v1/jobs/{job['id']}").json()["state"] == "cancelled"
    assert httpx.post(f"{asked_often.url}/v1/jobs/{job['id']}/retry").json()["state"] == "queued"
    assert httpx.delete(f"{asked_often.url}/v1/jobs/{job['id']}").json()["state"] == "cancelled"


@pytest.mark.parametrize(("name", "status", "code"), [("old", 422, "invalid_input"), ("attic", 404, "unknown_map")])
def test_maps_that_cannot_learn_are_refused(asked_often, name, status, code):
    answer = httpx.post(f"{asked_often.url}/v1/maps/{name}/learn")
    assert (answer.status_code, answer.json()["code"]) == (status, code)


def test_a_map_that_was_hardly_asked_is_refused_in_plain_words(serve, point_room):
    running = serve(learn=True)
    save_map(point_room.map_of(point_room.walk(80)[:45:2], "west"), running.settings.maps_dir / "west.rho")
    answer = httpx.post(f"{running.url}/v1/maps/west/learn")
    assert answer.status_code == 409
    assert answer.json()["message"] == "0 queries are kept for the map; it learns from 30 at least."


def test_maps_learn_once_a_night(asked_often):
    state, night = asked_often.app.state.rholoc, datetime(2026, 3, 1, 3, 10, tzinfo=UTC)
    jobs = state.jobs.sync
    before = len(jobs.list())
    learn_tonight(state, night)
    learn_tonight(state, night.replace(minute=20))
    (job, *_), count = jobs.list(), len(jobs.list())
    assert count == before + 1
    assert job.map_name == "west"
    jobs.cancel(job.id)
    learn_tonight(state, night.replace(minute=30))
    assert len(jobs.list()) == before + 1
    learn_tonight(state, night.replace(day=2))
    assert len(jobs.list()) == before + 2
    jobs.cancel(jobs.list()[0].id)


@pytest.mark.slow
def test_the_next_version_is_published_and_the_one_before_is_kept(asked_often, monkeypatch):
    """What the worker does with the job."""
    from rholoc.jobs.job import JobOptions
    from rholoc.progress import silent
    from rholoc.worker.pipeline import MappingPipeline, MappingTask

    monkeypatch.setattr(from_queries, "_ROUNDS", 0)  # how much is learned is beside the point
    settings = asked_often.settings
    (settings.data_dir / "work").mkdir(exist_ok=True)
    before = load_map(settings.maps_dir / "west.rho").info
    task = MappingTask(
        recording=None,
        built_file=settings.data_dir / "work" / "map.rho",
        maps_dir=settings.maps_dir,
        map_name="west",
        options=JobOptions(kind=JobKind.LEARN),
        data_dir=settings.data_dir,
    )
    MappingPipeline().build(task, silent)
    for _ in range(2):
        MappingPipeline().publish(task, MapLibrary(settings.maps_dir))
    after = load_map(settings.maps_dir / "west.rho").info
    assert (after.id, after.version) == (before.id, before.version + 1)
    said = httpx.get(f"{asked_often.url}/v1/maps/west/learning").json()["last"]
    assert said["version"] == after.version
    assert said["queries"]["recall_after"] >= said["queries"]["recall_before"]
    assert httpx.post(f"{asked_often.url}/v1/maps/west/restore").json()["version"] == before.version


def test_jobs_without_recordings_leave_recordings_alone(asked_often):
    state = asked_often.app.state.rholoc
    assert "" not in JobTable(state.jobs.sync.engine).mapped_before(9e9)
    state.jobs.sync.delete_mapped_recordings(0)
    assert state.recordings.sync.list() == []


@pytest.fixture(scope="module")
def learner(serve, point_room, picture_world):
    """A service with the maps ``west`` and ``east``, which overlap, and ``old``, which remembers nothing."""
    running = serve()
    walk = point_room.walk(80)
    for name, poses in (("west", walk[:45:2]), ("east", walk[25:65:2])):
        save_map(point_room.map_of(poses, name), running.settings.maps_dir / f"{name}.rho")
    (running.settings.maps_dir / "old.rho").write_bytes(picture_world.rho())
    return running


def post(service, path, body):
    return httpx.post(f"{service.url}/v1/maps/{path}", json=body, timeout=60)


def uploaded(service, **fields):
    fields = {"map": "west", **fields}
    return httpx.post(
        service.url + "/v1/recordings", files={"file": ("walk.mp4", b"\0\0\0\x18ftypmp42")}, data=fields, timeout=30
    )


def test_maps_are_merged_and_forget(learner):
    merged = post(learner, "west/merge", {"other": "east", "into": "both"})
    assert merged.status_code == 200, merged.text
    assert [source["name"] for source in merged.json()["sources"]] == ["west", "east"]
    assert merged.json()["version"] == 2
    before = load_map(learner.settings.maps_dir / "west.rho")
    left = post(learner, "both/forget", {"source": "east"}).json()
    assert (left["version"], left["id"]) == (3, merged.json()["id"])
    assert [source["name"] for source in left["sources"]] == ["west"]
    stored = load_map(learner.settings.maps_dir / "both.rho")
    np.testing.assert_allclose(stored.landmarks.positions, before.landmarks.positions, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("path", "body", "status", "code"),
    [
        ("west/forget", {"source": "attic"}, 422, "invalid_input"),
        ("west/forget", {"source": "west"}, 409, "conflict"),
        ("west/forget", {}, 422, "invalid_request"),
        ("nowhere/forget", {"source": "west"}, 404, "unknown_map"),
        ("old/forget", {"source": "walk"}, 422, "invalid_input"),
        ("west/merge", {"other": "nowhere", "into": "both"}, 404, "unknown_map"),
        ("west/merge", {"other": "east", "into": "../both"}, 422, "invalid_name"),
        ("west/merge", {"other": "west", "into": "twice"}, 409, "conflict"),
        ("west/merge", {"other": "old", "into": "twice"}, 422, "invalid_input"),
        ("west/update", {"recording": "0" * 32}, 404, "unknown_recording"),
        ("nowhere/update", {"recording": "0" * 32}, 404, "unknown_map"),
        ("old/update", {"recording": "0" * 32}, 422, "invalid_input"),
        ("west/update", {"recording": "0" * 32, "poses": "guessed"}, 422, "invalid_request"),
    ],
)
def test_what_does_not_fit_is_refused_and_changes_nothing(learner, path, body, status, code):
    files = {file.name: file.read_bytes() for file in learner.settings.maps_dir.glob("*.rho")}
    answer = post(learner, path, body)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.json()["message"]
    assert {file.name: file.read_bytes() for file in learner.settings.maps_dir.glob("*.rho")} == files


def test_an_update_is_a_job(learner):
    first = uploaded(learner, kind="update").json()
    again = post(learner, "west/update", {"recording": first["recording"], "poses": "visual", "camera": "1,2,3,4"})
    assert again.status_code == 202
    job = again.json()
    assert again.headers["Location"] == f"/v1/jobs/{job['id']}"
    assert (job["map"], job["recording"], job["state"]) == ("west", first["recording"], "queued")
    leases = Leases(learner.app.state.rholoc.jobs.sync.engine)
    works = [leases.take("somebody").work for _ in (first["job"], job)]
    assert [work.options.kind for work in works] == [JobKind.UPDATE, JobKind.UPDATE]
    assert [work.options.poses for work in works] == [None, "visual"]


def test_an_upload_that_no_map_could_learn_is_refused(learner):
    assert uploaded(learner, kind="update", map="nowhere").json()["code"] == "unknown_map"
    assert uploaded(learner, kind="update", map="old").json()["code"] == "invalid_input"
    assert uploaded(learner, kind="improve").json()["code"] == "invalid_request"
