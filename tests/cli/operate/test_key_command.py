"""``rholoc key``: keys made, listed and revoked by the command are those that the server knows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rholoc.cli import app
from rholoc.errors import Conflict, NotFound
from rholoc.service.access.keys import KeyLimits, KeyStore, Scope


def run(folder: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, ["key", *arguments, "--data", str(folder)])


def test_a_key_is_printed_alone_and_works_until_it_is_revoked(tmp_path):
    secret = run(tmp_path, "create", "robot", "--scope", "map", "--expires", "1").stdout.strip()
    key = KeyStore(tmp_path).find(secret)
    assert (key.name, key.scope, key.expires - key.created) == ("robot", Scope.MAP, 24 * 3600)
    assert run(tmp_path, "revoke", "robot").exit_code == 0
    assert KeyStore(tmp_path).find(secret) is None


def test_keys_are_listed_without_their_secrets(tmp_path):
    secret = run(tmp_path, "create", "[bold]robot").stdout.strip()
    assert "[bold]robot: localize" in run(tmp_path, "list").stdout
    listed = run(tmp_path, "list", "--json").stdout
    (key,) = json.loads(listed)
    assert (key["name"], key["scope"], key["expires"]) == ("[bold]robot", "localize", None)
    assert secret not in listed


def test_limits_are_set_changed_and_lifted(tmp_path):
    run(tmp_path, "create", "robot", "--requests-per-s", "5", "--burst", "20", "--stored-bytes", "1000")
    (key,) = KeyStore(tmp_path).keys()
    assert key.limits == KeyLimits(5.0, 20, None, 1000, None)
    assert "5 requests a second, 20 at once, 1000 bytes" in run(tmp_path, "list").stdout
    assert run(tmp_path, "limit", "robot", "--maps", "3", "--jobs", "0").exit_code == 0
    (listed,) = json.loads(run(tmp_path, "list", "--json").stdout)
    assert (listed["limits"]["maps"], listed["limits"]["jobs"], listed["limits"]["burst"]) == (3, 0, None)
    run(tmp_path, "limit", "robot")
    assert KeyStore(tmp_path).named("robot").limits == KeyLimits()
    assert run(tmp_path, "limit", "robot", "--burst", "0").exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "kind"), [(("create", "a"), Conflict), (("revoke", "b"), NotFound), (("limit", "b"), NotFound)]
)
def test_what_cannot_be_done_is_said(tmp_path, arguments, kind):
    run(tmp_path, "create", "a")
    assert isinstance(run(tmp_path, *arguments).exception, kind)


def test_a_scope_that_there_is_not_is_wrong_usage(tmp_path):
    assert run(tmp_path, "create", "a", "--scope", "all").exit_code == 2
