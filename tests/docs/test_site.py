"""The site of all pages: whole, built without network and without a warning."""

from __future__ import annotations

import os
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SITE = ROOT / "docs" / "site"
NOWHERE = "http://127.0.0.1:9"


class _Page(HTMLParser):
    """What a page shows and links to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.pictures: list[str] = []
        self.loaded: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = {name: value or "" for name, value in attrs}
        if tag == "img":
            self.pictures.append(known["src"])
        if tag in ("script", "img") and "src" in known:
            self.loaded.append(known["src"])
        if tag == "link" and known.get("rel") == "stylesheet":
            self.loaded.append(known["href"])


def test_every_route_and_model_is_in_the_http_reference(monkeypatch: pytest.MonkeyPatch, openapi) -> None:
    monkeypatch.syspath_prepend(str(SITE))
    import http_reference

    page = http_reference.page(openapi)
    headings = [line for line in page.splitlines() if line.startswith("### ")]
    methods = {"get", "put", "post", "patch", "delete", "head", "options"}
    for path, item in openapi["paths"].items():
        for method in methods & item.keys():
            assert f"### `{method.upper()} {path}`" in headings
            assert item[method]["summary"] in page
    for name, schema in openapi["components"]["schemas"].items():
        assert f"### {name}" in headings
        assert all(f"| `{field}` |" in page for field in schema.get("properties", {}))
    sys.modules.pop("http_reference")


@pytest.mark.slow
def test_the_site_builds_and_shows_the_notebook(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", SITE / "mkdocs.yml", "-d", tmp_path]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1", "http_proxy": NOWHERE, "https_proxy": NOWHERE}
    built = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    assert "WARNING" not in built.stderr
    reference = (tmp_path / "reference.html").read_text(encoding="utf-8")
    assert all(f'id="rholoc.{home}' in reference for home in ("mapping.build_map", "localization.Localizer"))
    assert (tmp_path / "server" / "COMMANDS.html").is_file()
    notebook = _Page(tmp_path / "docs" / "notebook.html")
    drawn = [name for name in notebook.pictures if name.startswith("paper-")]
    assert len(drawn) == 7
    assert all((tmp_path / "docs" / name).stat().st_size > 5000 for name in drawn)
    for path in tmp_path.rglob("*.html"):
        assert not [address for address in _Page(path).loaded if "://" in address], path
