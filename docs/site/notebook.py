"""A notebook, run from its first cell to its last, as a page in Markdown with its pictures."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl

_DPI = 110


@dataclass
class Page:
    """What a notebook says and shows.

    Attributes:
        text: Markdown.
        pictures: PNG files by the names that the text has for them.
    """

    text: str = ""
    pictures: dict[str, bytes] = field(default_factory=dict)


def run_notebook(path: Path) -> Page:
    """Run a notebook's cells in this process, in its folder; an error in a cell is raised.

    Whatever ``print`` says and ``plt.show`` shows stands below the cell that does.
    """
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    page = Page()
    names: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.chdir(path.parent), _shown(plt) as pictures:
        for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
            source = "".join(cell["source"])
            if cell["cell_type"] == "markdown":
                page.text += f"{source}\n\n"
                continue
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(source, f"{path.name}, cell {number}", "exec"), names)
            page.text += f"```python\n{source}\n```\n\n"
            if printed.getvalue():
                page.text += f"```text\n{printed.getvalue().rstrip()}\n```\n\n"
            for picture in pictures:
                name = f"{path.stem}-{len(page.pictures) + 1}.png"
                page.pictures[name] = picture
                page.text += f"![what the cell above draws]({name})\n\n"
            pictures.clear()
    return page


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
