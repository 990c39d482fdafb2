"""The settings of the service, each an environment variable with the prefix ``RHOLOC_``."""

import ipaddress
import math
import os
from enum import StrEnum
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, SecretStr, model_validator

from rholoc.jobs import Capacity
from rholoc.library.stores import Stores
from rholoc.localization import MIN_RECOGNIZED
from rholoc.processes.limits import machine_memory_bytes
from rholoc.recordings import MAX_FRAME_PIXELS
from rholoc.worker import BuildLimits, WorkerSetup


class KeyPolicy(StrEnum):
    """When a request needs an API key."""

    AUTO = "auto"  # unless the server listens on this machine alone
    ALWAYS = "always"
    NEVER = "never"  # something in front of the server authenticates clients


def keys_needed(policy: KeyPolicy, host: str) -> bool:
    """Whether a server that listens on ``host`` requires keys: by policy, AUTO unless it is a local address."""
    return policy is KeyPolicy.ALWAYS or (policy is KeyPolicy.AUTO and not is_loopback(host))


def is_loopback(host: str) -> bool:
    """Whether a host is ``localhost`` or a loopback address; False for any other name."""
    if host == "localhost":  # names below it may be anybody's, where a resolver does not keep them here
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


_PREFIX = "rholoc_"  # of environment variables, in any case of letters
_JOB_MEMORY_SHARE = 0.75
_MAP_MEMORY_SHARE = 1 / 16
_CACHE_MEMORY_SHARE = 1 / 4


class Settings(BaseModel):
    """Settings of one process of the service. ``RHOLOC_PORT=80`` sets ``port``."""

    model_config = ConfigDict(frozen=True, extra="ignore", validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _with_environment(cls, given: dict[str, Any]) -> dict[str, Any]:
        """The given settings, and from the environment those that are not given."""
        variables = {name.lower(): text for name, text in os.environ.items()}
        return {name: variables[key] for name in cls.model_fields if (key := f"{_PREFIX}{name}") in variables} | given

    maps_dir: Path = Field(default=Path("maps"), description="The folder of the maps that are served.")
    data_dir: Path = Field(
        default=Path(".rholoc"), description="The folder of recordings, jobs and unfinished uploads."
    )
    database_url: SecretStr = Field(
        default=SecretStr(""),
        description="The database of jobs, postgresql://user:password@host/name; empty: an SQLite file in data_dir.",
    )
    storage_url: SecretStr = Field(
        default=SecretStr(""),
        description="Where servers and workers on several machines keep maps and recordings together: "
        "s3://bucket/prefix, gs://bucket/prefix, az://container/prefix or file:///folder; cameras and keys then go "
        "into the database. Empty: in maps_dir and data_dir.",
    )
    storage_cache_bytes: int = Field(
        default=10 * 2**30,
        ge=0,
        description="What copies of the maps in storage_url may take in data_dir; those used longest ago leave for "
        "others.",
    )
    host: str = Field(default="127.0.0.1", description="The address that the server listens on.")
    port: int = Field(
        default=8080, ge=0, le=65535, description="The port that the server listens on; 0 takes a free one."
    )
    keys: KeyPolicy = Field(
        default=KeyPolicy.AUTO,
        description="Whether requests need an API key; auto: unless the server listens on this machine alone.",
    )
    worker: bool = Field(default=True, description="Whether this process also works on mapping jobs.")
    concurrency: int = Field(
        default_factory=lambda: os.cpu_count() or 1,
        ge=1,
        description="How many frames are localized at the same time; default: the number of cores.",
    )
    queue_length: int = Field(
        default=16, ge=0, description="How many more frames may wait; beyond, the answer is `busy`."
    )
    min_recognized: float = Field(
        default=MIN_RECOGNIZED, ge=0, le=1, description="Poses that are less probably of the right place are withheld."
    )
    default_deadline_ms: float = Field(default=5000, gt=0, description="The deadline of requests that name none.")
    max_image_pixels: int = Field(default=50_000_000, ge=1, description="The most pixels an image may claim to have.")
    max_feature_pixels: int = Field(
        default=4_000_000, ge=1, description="Images of more pixels are scaled down to so many to find their features."
    )
    max_features: int = Field(default=5000, ge=1, description="The most features a descriptor set may hold.")
    max_request_bytes: int = Field(
        default=32 * 2**20,
        ge=1,
        description="The largest body of a localization request, and of a piece of an upload with a checksum.",
    )
    max_json_bytes: int = Field(
        default=2**16, ge=1, description="The largest JSON body, but for a descriptor set: cameras, options, names."
    )
    max_upload_bytes: int = Field(default=4 * 2**30, ge=1, description="The largest upload of a map or a recording.")
    max_map_bytes: int = Field(
        default_factory=lambda: int(_MAP_MEMORY_SHARE * machine_memory_bytes()),
        ge=1,
        description="The largest map file that is taken in; default: a sixteenth of the machine's or the container's "
        "memory, for a map takes six times its file while it is checked.",
    )
    map_cache_bytes: int = Field(
        default_factory=lambda: int(_CACHE_MEMORY_SHARE * machine_memory_bytes()),
        ge=0,
        description="What the maps that were asked last may take in memory; those asked longest ago leave for others. "
        "Default: a quarter of the machine's or the container's memory. The one asked last always stays.",
    )
    export_time_limit_s: float = Field(
        default=300, gt=0, description="How long the export of a map into another format may take."
    )
    origins: str = Field(
        default="",
        pattern=r"^(https?://[\w.-]+(:\d+)?(,https?://[\w.-]+(:\d+)?)*)?$",
        description="Web sites whose pages may use the API from a browser, with commas: `https://app.example`.",
    )
    open_metrics: bool = Field(default=False, description="Whether `/metrics` needs no API key.")
    max_connections: int = Field(default=500, ge=1, description="The most connections that are open at a time.")
    max_streams: int = Field(
        default=40,
        ge=0,
        description="The most streams of frames (WebSockets) that are open; half of them by one client.",
    )
    max_unfinished_uploads: int = Field(
        default=100, ge=1, description="The most resumable uploads that are unfinished at a time."
    )
    max_video_pixels: int = Field(
        default=MAX_FRAME_PIXELS, ge=1, description="The most pixels a frame of a recording may have, by its header."
    )
    live: bool = Field(
        default=False, description="Whether those who may read see who asks for poses now, where, and how surely."
    )
    keep_failures: bool = Field(
        default=False,
        description="Whether the places where requests failed or were unsure are kept in memory for a day, without "
        "pictures and without who asked.",
    )
    keep_refused: int = Field(
        default=0,
        ge=0,
        le=500,
        description="How many refused pictures are kept in memory, small, with who sent them, for those who may make "
        "maps to see why; 0: none. Visitors' are never kept.",
    )
    learn: bool = Field(
        default=False,
        description="Whether maps learn from their users: the features of frames that were localized surely are kept, "
        "never the picture, and each night maps learn from them.",
    )
    learn_hour: int = Field(
        default=3, ge=-1, le=23, description="The hour, UTC, at which maps learn; -1: only when they are asked to."
    )
    learn_max_bytes: int = Field(
        default=128 * 2**20, ge=2**20, description="The most bytes of queries that are kept for a map."
    )
    learn_not_from: str = Field(
        default="", description="The names of keys whose queries teach nothing, separated by commas."
    )
    learn_from_handed: bool = Field(
        default=False, description="Whether queries by keys that were handed on, as links do, teach as well."
    )
    keep_pictures: bool = Field(
        default=False,
        description="Whether maps that are made here keep a small picture of each view, which those who may read see; "
        "also whether pictures of maps that have them are shown.",
    )
    slow_client_timeout_s: float = Field(
        default=30,
        gt=0,
        description="How long a request's body may be silent, or behind 500 bytes a second, before it is given up.",
    )
    upload_expires_s: float = Field(
        default=24 * 3600, gt=0, description="How long an unfinished upload is kept without a further byte."
    )
    recording_retention_days: float = Field(
        default=math.inf,
        ge=0,
        description="How long a recording is kept after its map was published; inf: until it is deleted.",
    )
    job_time_limit_s: float = Field(default=6 * 3600, gt=0, description="How long one mapping job may take.")
    job_memory_gib: float = Field(
        default_factory=lambda: _JOB_MEMORY_SHARE * machine_memory_bytes() / 2**30,
        gt=0,
        description="How much memory the processes of one mapping job may hold, on Linux; default: three quarters of "
        "the machine's or the container's.",
    )
    worker_jobs: int = Field(default=1, ge=1, description="How many mapping jobs a worker does at a time.")
    worker_memory_gib: float = Field(
        default_factory=lambda: _JOB_MEMORY_SHARE * machine_memory_bytes() / 2**30,
        gt=0,
        description="How much memory a worker has for its jobs together: it leaves jobs that need more to others. "
        "Default: three quarters of the machine's or the container's.",
    )
    max_upload_files: int = Field(
        default=20_000, ge=1, description="The most files one upload of a recording may hold."
    )

    @property
    def worker_setup(self) -> WorkerSetup:
        """Folders and limits of this service's workers."""
        return WorkerSetup(
            self.data_dir,
            self.maps_dir,
            self.jobs_database,
            self.shared_storage,
            Capacity(self.worker_jobs, self.worker_memory_gib * 2**30),
            BuildLimits(self.job_time_limit_s, self.job_memory_gib * 2**30, self.max_video_pixels),
        )

    def stores(self) -> Stores:
        """The service's stores, not opened.

        Raises:
            InvalidInput: a URL is not valid.
        """
        return Stores(
            self.maps_dir,
            self.data_dir,
            self.jobs_database,
            self.shared_storage,
            self.storage_cache_bytes,
            self.map_cache_bytes,
        )

    @property
    def jobs_database(self) -> str | None:
        """The URL of the jobs' database; None for the SQLite file in ``data_dir``."""
        return self.database_url.get_secret_value() or None

    @property
    def shared_storage(self) -> str | None:
        """The URL of the storage that servers and workers share; None for folders of their own."""
        return self.storage_url.get_secret_value() or None
