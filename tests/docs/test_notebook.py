"""The notebook keeps its outputs; the site's test runs it."""

from __future__ import annotations

import base64
import json
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
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
