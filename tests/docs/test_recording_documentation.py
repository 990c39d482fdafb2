"""What may be said of a recording is documented, and so is every format."""

from __future__ import annotations

from pathlib import Path

import pytest

from rholoc.recordings import AdviceKind, WarningKind
from rholoc.recordings.readers import READERS

ROOT = Path(__file__).parents[2]
COMMANDS = (ROOT / "server" / "COMMANDS.md").read_text(encoding="utf-8")
FORMATS = (ROOT / "maps" / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [*WarningKind, *AdviceKind])
def test_every_warning_and_advice_is_documented(kind: WarningKind | AdviceKind) -> None:
    assert f"`{kind.value}`" in COMMANDS


def test_every_format_has_a_row() -> None:
    section = FORMATS.split("### Formats of recorder apps and datasets")[1].split("\n##")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")]
    assert len(rows) == 1 + len(READERS)  # the head
