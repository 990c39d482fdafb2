"""What the pages for contributors name is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "server" / "rholoc"
METHOD = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("module", sorted(set(re.findall(r"`([a-z_0-9]+(?:/[a-z_0-9]+)+\.py)`", METHOD))))
def test_modules_of_the_method_exist(module: str) -> None:
    assert (PACKAGE / module).is_file()


def test_modules_that_the_method_names_without_their_room_exist() -> None:
    named = set(re.findall(r"`([a-z_0-9]+\.py)`", METHOD))
    assert named <= {path.name for path in PACKAGE.rglob("*.py")}


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:server|tests|benchmarks|maps)/[\w/.]*)`", CONTRIBUTING))))
def test_paths_for_contributors_exist(path: str) -> None:
    assert (ROOT / path).exists()


def test_every_package_is_in_the_table_for_contributors() -> None:
    named = set(re.findall(r"`(\w+)`", CONTRIBUTING))
    assert {folder.name for folder in PACKAGE.iterdir() if (folder / "__init__.py").is_file()} <= named


def test_nothing_cites_a_design_that_is_not_here() -> None:
    citing = [path for path in PACKAGE.rglob("*.py") if "DESIGN" in path.read_text(encoding="utf-8")]
    assert citing == []
