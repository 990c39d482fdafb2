"""A storage that is gone, slow, unavailable or breaks off: nothing is torn, and it is said what is wrong."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from failing_storage import FailingStorage, StorageFault
from rholoc.errors import StorageUnavailable
from rholoc.storage import ObjectStorage, objects

pytestmark = pytest.mark.slow
BUCKET, CONTENT = "rholoc", bytes(range(256)) * 4000


@pytest.fixture(scope="module")
def failing() -> Iterator[FailingStorage]:
    """An S3 server with an empty bucket, which does not fail yet."""
    boto3 = pytest.importorskip("boto3")
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    failing = FailingStorage(f"http://{host}:{port}")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "test")
        patch.setenv("AWS_REGION", "us-east-1")
        patch.setenv("AWS_ENDPOINT_URL", failing.url)
        patch.setenv("AWS_ALLOW_HTTP", "true")
        boto3.client("s3", region_name="us-east-1").create_bucket(Bucket=BUCKET)
        yield failing
    failing.close()
    server.stop()


@pytest.fixture
def storage(failing: FailingStorage, monkeypatch: pytest.MonkeyPatch) -> Iterator[ObjectStorage]:
    """A storage that is patient for one second."""
    monkeypatch.setattr(objects, "_RETRY_FOR_S", 1.0)
    yield ObjectStorage(f"s3://{BUCKET}/service")
    failing.fault = None


@pytest.mark.parametrize("fault", [StorageFault.GONE, StorageFault.UNAVAILABLE])
def test_a_storage_that_does_not_come_back_is_unavailable(
    fault: StorageFault, storage: ObjectStorage, failing: FailingStorage, tmp_path: Path
) -> None:
    storage.put("maps/a", CONTENT)
    failing.fault = fault
    with pytest.raises(StorageUnavailable):
        storage.put("maps/b", CONTENT)
    with pytest.raises(StorageUnavailable):
        storage.fetch("maps/a", tmp_path / "a")
    assert list(tmp_path.iterdir()) == []
    failing.fault = None
    assert storage.fetch("maps/a", tmp_path / "a") == len(CONTENT)
    assert "maps/b" not in {one.key for one in storage.list("maps")}


@pytest.mark.parametrize("fault", [StorageFault.UNAVAILABLE, StorageFault.SLOW])
def test_a_storage_that_is_back_soon_is_waited_for(
    fault: StorageFault, failing: FailingStorage, storage: ObjectStorage, tmp_path: Path
) -> None:
    failing.fault = fault
    over = threading.Timer(0.3, lambda: setattr(failing, "fault", None))
    over.start()
    storage.put(f"maps/{fault}", CONTENT)
    over.join()
    assert storage.fetch(f"maps/{fault}", tmp_path / "a") == len(CONTENT)
    assert (tmp_path / "a").read_bytes() == CONTENT


def test_an_object_that_breaks_off_is_not_kept(storage: ObjectStorage, failing: FailingStorage, tmp_path: Path) -> None:
    storage.put("maps/c", CONTENT)
    failing.fault = StorageFault.TRUNCATES
    with pytest.raises(StorageUnavailable):
        storage.fetch("maps/c", tmp_path / "c")
    assert list(tmp_path.iterdir()) == []
