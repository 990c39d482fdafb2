"""Floor plans and GeoJSON as files: their content and media type."""

import io
import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

PlaceSource = Mapping[str, Any] | bytes | Path | str  # GeoJSON, or a file's content or path

_ZIP = "application/zip"
_STARTS = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp", b"PK": _ZIP}
_IMAGE = re.compile(r"^image:\s*[\"']?(.+?)[\"']?\s*$", re.MULTILINE)


def plan_content(source: PlaceSource) -> tuple[bytes, str]:
    """Content and media type of a floor plan or of GeoJSON.

    The yaml of a ``map_server`` is packed with its picture. Everything that is neither picture nor archive is taken for
    GeoJSON.

    Raises:
        OSError: a file cannot be read.
        ValueError: a yaml names no picture.
    """
    if isinstance(source, Mapping):
        return json.dumps(dict(source)).encode(), "application/geo+json"
    if not isinstance(source, bytes):
        path = Path(source)
        if path.suffix.lower() in (".yaml", ".yml"):
            return _packed(path), _ZIP
        source = path.read_bytes()
    return source, next((kind for start, kind in _STARTS.items() if source.startswith(start)), "application/geo+json")


def _packed(path: Path) -> bytes:
    text = path.read_text(encoding="utf-8")
    named = _IMAGE.search(text)
    if named is None:
        raise ValueError(f"{path} names no image: it is no yaml of map_server.")
    picture, packed = path.parent / named[1], io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr(path.name, text)
        archive.write(picture, picture.name)
    return packed.getvalue()
