"""A hook of mkdocs: the repository's own pages and pictures are the site's, where they lie.

Two pages are made: the HTTP reference of the service's OpenAPI document, and the notebook, run.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import http_reference
import notebook
from mkdocs.structure.files import File, Files

from rholoc.service import Settings, create_app

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "server/README.md",
    "docs/service/asking.md",
    "docs/service/mapping.md",
    "docs/service/operating.md",
    "docs/service/reference.md",
    "server/COMMANDS.md",
    "server/LIGHT.md",
    "maps/README.md",
    "client/README.md",
    "client/js/README.md",
    "client/unity/README.md",
    "benchmarks/lab/README.md",
    "ros/README.md",
    "docs/howto.md",
    "docs/library.md",
    "docs/robots.md",
    "docs/method.md",
    "docs/others.md",
    "docs/experiments.md",
    "docs/page.md",
    "docs/paper.md",
)
_LINK = re.compile(r"(?<=\]\()([^)#\s]+)|(?<=src=\")([^\"]+)")


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the pages, and what they show or link to."""
    wanted = dict.fromkeys(PAGES)
    for page in PAGES:
        for link in _LINK.finditer((ROOT / page).read_text(encoding="utf-8")):
            target = link[1] or link[2]
            if "://" in target or target.startswith(("mailto:", "/")):
                continue
            path = ((ROOT / page).parent / target).resolve()
            if path.is_file() and path.is_relative_to(ROOT):
                wanted[path.relative_to(ROOT).as_posix()] = None
    for name in wanted:
        if files.get_file_from_path(name) is None:
            files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    files.append(File.generated(config, "http.md", content=http_reference.page(create_app(Settings()).openapi())))
    run = notebook.run_notebook(notebook.NOTEBOOK)
    files.append(File.generated(config, "docs/notebook.md", content=run.text))
    for name, picture in run.pictures.items():
        files.append(File.generated(config, f"docs/{name}", content=picture))
    return files
