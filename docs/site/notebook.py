"""A notebook, run from its first cell to its last: as a page in Markdown, or with its outputs kept in it.

``python docs/site/notebook.py`` keeps those of docs/paper.ipynb.
"""

from __future__ import annotations

import base64
import contextlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl

_DPI = 80
NOTEBOOK = Path(__file__).parents[1] / "paper.ipynb"


@dataclass
class Page:
    """What a notebook says and shows.

    Attributes:
        text: Markdown.
        pictures: PNG files by the names that the text has for them.
    """

    text: str = ""
    pictures: dict[str, bytes] = field(default_factory=dict)


@dataclass(frozen=True)
class Cell:
    """A cell that was run: its source, its printed text and the figures that it showed as PNG; Markdown has neither."""

    source: str
    is_code: bool
    printed: str = ""
    pictures: tuple[bytes, ...] = ()


def run_cells(path: Path) -> Iterator[Cell]:
    """Run a notebook's cells in this process, in its folder; an error in a cell is raised."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    names: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.chdir(path.parent), _shown(plt) as pictures:
        for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
            source = "".join(cell["source"])
            if cell["cell_type"] == "markdown":
                yield Cell(source, is_code=False)
                continue
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(source, f"{path.name}, cell {number}", "exec"), names)
            yield Cell(source, True, printed.getvalue(), tuple(pictures))
            pictures.clear()


def run_notebook(path: Path) -> Page:
    """Run a notebook; printed text and shown figures stand below the cell that they are from."""
    page = Page()
    for cell in run_cells(path):
        page.text += f"```python\n{cell.source}\n```\n\n" if cell.is_code else f"{cell.source}\n\n"
        if cell.printed:
            page.text += f"```text\n{cell.printed.rstrip()}\n```\n\n"
        for picture in cell.pictures:
            name = f"{path.stem}-{len(page.pictures) + 1}.png"
            page.pictures[name] = picture
            page.text += f"![what the cell above draws]({name})\n\n"
    return page


def keep_outputs(path: Path) -> None:
    """Run a notebook and write its outputs into it, so that it can be read where it is not run."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    count = 0
    for cell, ran in zip(notebook["cells"], run_cells(path), strict=True):
        if not ran.is_code:
            continue
        count += 1
        cell["execution_count"], cell["outputs"] = count, []
        if ran.printed:
            lines = ran.printed.splitlines(keepends=True)
            cell["outputs"].append({"output_type": "stream", "name": "stdout", "text": lines})
        for picture in ran.pictures:
            data = {"image/png": base64.b64encode(picture).decode("ascii")}
            cell["outputs"].append({"output_type": "display_data", "data": data, "metadata": {}})
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@contextlib.contextmanager
def _shown(plt: Any) -> Iterator[list[bytes]]:
    """The figures that are shown, as PNG, instead of a window."""
    pictures: list[bytes] = []

    def show() -> None:
        for number in plt.get_fignums():
            content = io.BytesIO()
            plt.figure(number).savefig(content, dpi=_DPI, bbox_inches="tight", metadata={"Software": None})
            pictures.append(content.getvalue())
        plt.close("all")

    usual, plt.show = plt.show, show
    try:
        yield pictures
    finally:
        plt.show = usual
        plt.close("all")


if __name__ == "__main__":
    keep_outputs(NOTEBOOK)
