"""The notebook holds no outputs; the site's test runs it."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "paper.ipynb"


def test_outputs_are_stripped() -> None:
    cells: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(code) > 5
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)


def test_a_page_has_what_cells_say_print_and_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    from notebook import run_notebook

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
    path.write_text(json.dumps({"cells": cells}), encoding="utf-8")
    with pytest.raises(AssertionError, match="wrong"):
        run_notebook(path)
    sys.modules.pop("notebook")
