"""The client's public names, its error tree, and that it stands alone."""

from __future__ import annotations

import dataclasses
import inspect
import re
import runpy
import subprocess
import sys
from pathlib import Path

import rholoc_client
from rholoc.service.errors import error_classes, status_of
from rholoc_client import errors

MODELS = (
    "Alternative",
    "Camera",
    "CameraProfile",
    "Features",
    "Frame",
    "FramePose",
    "Job",
    "Localization",
    "MapSummary",
    "Matches",
    "NearPlace",
    "OfSite",
    "OnEarth",
    "Place",
    "Pose",
    "Prior",
    "Site",
    "SiteMap",
    "SitePose",
)


OF_TRACKING = {"AsyncTracker", "ImuNoise", "OdometryNoise", "TrackOptions", "TrackStatus", "Tracked", "Tracker"}


def client_errors() -> list[type[Exception]]:
    return [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, Exception)]


def test_all_is_what_is_public():
    public = {name for name in vars(rholoc_client) if not name.startswith("_") and name[0].isupper()}
    public -= {"TYPE_CHECKING", "Any"}
    assert set(rholoc_client.__all__) == public | OF_TRACKING
    assert all(getattr(rholoc_client, name).__module__.startswith("rholoc_client") for name in OF_TRACKING)
    assert public - OF_TRACKING == {"AsyncClient", "Client", *MODELS} | {kind.__name__ for kind in client_errors()}


def test_models_are_frozen():
    for name in MODELS:
        assert getattr(rholoc_client, name).__dataclass_params__.frozen
        assert dataclasses.is_dataclass(getattr(rholoc_client, name))


def test_the_drawn_tree_is_the_real_one():
    drawn: dict[str, str] = {}
    above: list[str] = []
    for line in (errors.__doc__ or "").splitlines():
        found = re.match(r"    ([│├└─ ]*)([A-Z]\w+)", line)
        if found:
            depth = len(found[1]) // 4
            above[depth:] = [found[2]]
            drawn[found[2]] = above[depth - 1] if depth else "Exception"
    assert drawn == {kind.__name__: kind.__base__.__name__ for kind in client_errors()}


def test_every_code_of_the_service_is_an_exception():
    assert {kind.code for kind in error_classes()} <= set(errors.BY_CODE)
    for kind in error_classes():
        if "code" in vars(kind):  # others are told as the error that they are a kind of
            assert errors.BY_CODE[kind.code].__name__ == kind.__name__
        assert status_of(kind) >= 400


def test_the_blocking_client_is_written_from_the_other():
    """After a change: python client/write_sync.py."""
    script = runpy.run_path(str(Path(__file__).parents[2] / "client" / "write_sync.py"))
    assert script["SYNC_FILE"].read_text(encoding="utf-8") == script["sync_source"]()


def test_the_client_needs_neither_the_service_nor_numpy():
    code = "import sys, rholoc_client; print([m for m in ('rholoc', 'numpy', 'cv2') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
