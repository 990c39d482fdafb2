"""Localizers live as long as their maps are in memory."""

from __future__ import annotations

import time
from pathlib import Path
from typing import cast

from rholoc.library import MapLibrary
from rholoc.library.map_cache import memory_bytes
from rholoc.maps import save_map
from rholoc.service.frames.localizers import Localizers
from rholoc.service.frames.map_choice import Candidates, each_map
from rholoc.service.http.stopwatch import Stopwatch


def test_a_map_that_leaves_memory_takes_its_localizer_along(tmp_path: Path, picture_world) -> None:
    for name in ("first", "second"):
        save_map(picture_world.map_, tmp_path / f"{name}.rho")
    library = MapLibrary(tmp_path, cache_bytes=1.5 * memory_bytes(picture_world.map_))
    localizers = Localizers(library, 0.5)
    first = localizers.get("first")
    assert localizers.get("first") is first
    localizers.get("second")
    again = localizers.get("first")
    assert again is not first
    assert again.map is not first.map


def test_loading_a_map_is_timed_apart() -> None:
    class Cold:
        def get(self, name: str) -> str:
            time.sleep(0.02)
            return name

    asked: list[str] = []
    clock = Stopwatch()
    each_map(
        Candidates(("a", "b"), passing_over=False), cast(Localizers, Cold()), lambda name, _: asked.append(name), clock
    )
    assert asked == ["a", "b"]
    assert clock.stages_ms["load"] >= 40
