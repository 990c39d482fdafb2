"""How much memory a container, or a service of systemd, leaves a process."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rholoc.processes.limits import _control_group_limits


@pytest.mark.parametrize(
    ("own", "files", "expected"),
    [
        ("0::/\n", {"memory.max": "1000\n"}, 1000.0),
        ("0::/\n", {"memory.max": "max\n"}, math.inf),
        ("0::/system.slice/rholoc.service\n", {"system.slice/rholoc.service/memory.max": "2000\n"}, 2000.0),
        (
            "0::/system.slice/rholoc.service\n",
            {"system.slice/rholoc.service/memory.max": "2000\n", "system.slice/memory.max": "1500\n"},
            1500.0,
        ),
        ("0::/docker/123\n", {"memory.max": "3000\n"}, 3000.0),  # as a container sees it
        ("4:memory:/docker/123\n2:cpu:/\n", {"memory/docker/123/memory.limit_in_bytes": "4000\n"}, 4000.0),
        ("", {}, math.inf),
    ],
)
def test_the_tightest_control_group_counts(own: str, files: dict[str, str], expected: float, tmp_path: Path) -> None:
    groups = tmp_path / "groups"
    groups.mkdir()
    (tmp_path / "memory.max").write_text("1\n")  # not of a control group
    for name, content in files.items():
        (groups / name).parent.mkdir(parents=True, exist_ok=True)
        (groups / name).write_text(content)
    (tmp_path / "own").write_text(own)
    assert min(_control_group_limits(tmp_path / "own", groups)) == expected
    assert _control_group_limits(tmp_path / "none", groups) == [math.inf]
