"""A hook of mkdocs: the repository's own pages and pictures are the site's, where they lie."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "server/README.md",
    "server/COMMANDS.md",
    "server/LIGHT.md",
    "maps/README.md",
    "client/README.md",
    "docs/library.md",
    "docs/method.md",
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
    return files
