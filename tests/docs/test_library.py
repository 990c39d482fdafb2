"""What the library's page shows, runs; what it offers is there; the site builds without a warning."""

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rholoc
from rholoc.maps import read_trajectory_csv
from rholoc.simulation import simulate_recording

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
REFERENCE = (ROOT / "docs" / "site" / "content" / "reference.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
OF_A_WALK = next(number for number, block in enumerate(BLOCKS) if "read_recording" in block)


@pytest.fixture
def beside_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the files that the page names, as the working directory."""
    shutil.copy(ROOT / "maps" / "testsite.rho", tmp_path)
    shutil.copy(ROOT / "maps" / "queries" / "1.jpg", tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_pages_examples_run(beside_files: Path) -> None:
    names: dict[str, Any] = {}
    for block in BLOCKS[:OF_A_WALK]:
        exec(compile(block, "docs/library.md", "exec"), names)
    assert names["answer"].localized
    assert names["figures"].n == 2


@pytest.mark.slow
def test_the_examples_of_a_walk_run(beside_files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = beside_files / "walk"
    simulate_recording(walk, seconds=8.0, fps=6)
    truth = read_trajectory_csv(walk / "truth.csv")
    rows = np.column_stack([truth.frames, truth.positions, truth.quaternions_xyzw])
    np.savetxt(walk / "poses.txt", rows, fmt=["%d", *["%.6f"] * 7])
    names: dict[str, Any] = {"rholoc": rholoc, "Path": Path}
    for block in BLOCKS[OF_A_WALK:]:
        exec(compile(block, "docs/library.md", "exec"), names)
    assert (beside_files / "kitchen.rho").is_file()
    assert "already learned" in capsys.readouterr().out


@pytest.mark.parametrize("name", rholoc.__all__)
def test_every_name_is_there_shown_and_in_the_reference(name: str) -> None:
    assert getattr(rholoc, name).__name__ == name
    assert f"rholoc.{name}(" in PAGE or f"rholoc.{name}." in PAGE
    assert re.search(rf"^::: rholoc\.\w+\.{name}$", REFERENCE, re.MULTILINE)


def test_importing_it_loads_nothing_heavy() -> None:
    code = "import sys, rholoc; assert 'numpy' not in sys.modules; assert 'build_map' in dir(rholoc); rholoc.nothing"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert "has no attribute 'nothing'" in done.stderr


NOTEBOOK = ROOT / "docs" / "paper.ipynb"


def test_outputs_are_kept() -> None:
    cells: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    for cell in code:
        source, kinds = "".join(cell["source"]), [one["output_type"] for one in cell["outputs"]]
        assert ("display_data" in kinds) == ("plt.show()" in source)
        assert ("stream" in kinds) == ("print(" in source), "run python docs/site/notebook.py"
    assert str(ROOT) not in NOTEBOOK.read_text(encoding="utf-8")


def test_a_page_has_what_cells_say_print_and_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    from notebook import keep_outputs, run_notebook

    plot = "import matplotlib.pyplot as plt\nplt.plot([1, 2])\nplt.show()\nprint(6 * 7)"
    cells = [
        {"cell_type": "markdown", "source": ["# A title"]},
        {"cell_type": "code", "source": [line + "\n" for line in plot.split("\n")]},
        {"cell_type": "code", "source": ["assert False, 'wrong'"]},
    ]
    path = tmp_path / "walk.ipynb"
    path.write_text(json.dumps({"cells": cells[:2]}), encoding="utf-8")
    page = run_notebook(path)
    assert page.text.startswith("# A title\n\n```python\nimport matplotlib")
    assert "```text\n42\n```\n\n![what the cell above draws](walk-1.png)" in page.text
    assert page.pictures["walk-1.png"].startswith(b"\x89PNG")
    keep_outputs(path)
    ran = json.loads(path.read_text(encoding="utf-8"))["cells"][1]
    assert ran["outputs"][0]["text"] == ["42\n"]
    assert base64.b64decode(ran["outputs"][1]["data"]["image/png"]).startswith(b"\x89PNG")
    path.write_text(json.dumps({"cells": cells}), encoding="utf-8")
    with pytest.raises(AssertionError, match="wrong"):
        run_notebook(path)
    sys.modules.pop("notebook")


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
