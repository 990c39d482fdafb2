"""What commands write to is looked at before they work."""

from __future__ import annotations

import os

import pytest

from rholoc.cli.options import check_target
from rholoc.errors import InvalidInput, InvalidMap
from rholoc.maps import read_coefficient_table


def test_a_file_that_cannot_be_written_is_refused_before_the_work(tmp_path, monkeypatch):
    assert check_target(tmp_path / "a.rho", "the map") == tmp_path / "a.rho"
    with pytest.raises(InvalidInput, match=r"There is no folder .*/nowhere to write the map to\. Create it first\."):
        check_target(tmp_path / "nowhere" / "a.rho", "the map")
    with pytest.raises(InvalidInput, match=r"is a folder\. Name a file to write the map to"):
        check_target(tmp_path, "the map")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(InvalidInput, match="cannot be written to"):
        check_target(tmp_path / "a.rho", "the map")


def test_a_map_that_is_imported_as_a_table_needs_no_import(tmp_path):
    for name, hint in (("a.rho", "needs no import"), ("a.csv", "Export the map again")):
        (tmp_path / name).write_bytes(b"\xb0\x00\xff")
        with pytest.raises(InvalidMap, match=hint):
            read_coefficient_table(tmp_path / name)
