"""View vectors of all maps in a file, so that a start does not have to read the maps.

One SQLite file that several processes may share. Everything in it can be computed again from the maps, so a corrupt
file is discarded.
"""

from __future__ import annotations

import contextlib
import io
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

import numpy as np

from rholoc.features import get_extractor
from rholoc.features.picture_vectors import DIMENSIONS, PictureVectors
from rholoc.geometry import FloatArray
from rholoc.localization.index.view_index import packed_vectors, unpacked_vectors

_BUSY_TIMEOUT_S = 10.0
_LAYOUT = 2  # of the tables; a file of another one is begun anew
_TABLES = """
CREATE TABLE IF NOT EXISTS models (
    features TEXT PRIMARY KEY, id TEXT NOT NULL, maps INTEGER NOT NULL, data BLOB NOT NULL
);
CREATE TABLE IF NOT EXISTS views (
    map TEXT PRIMARY KEY, file TEXT NOT NULL, features TEXT NOT NULL, model TEXT NOT NULL, vectors BLOB NOT NULL
);
"""


@dataclass(frozen=True, eq=False)
class Model:
    """A model that turns pictures with one kind of features into vectors.

    Attributes:
        id: unique identifier.
        features: name of the extractor.
        maps: number of maps it was trained on.
        pictures: the model itself.
    """

    id: str
    features: str
    maps: int
    pictures: PictureVectors

    @classmethod
    def new(cls, features: str, maps: int, pictures: PictureVectors) -> Model:
        """A newly trained model with an identifier of its own."""
        return cls(uuid4().hex, features, maps, pictures)


@dataclass(frozen=True, eq=False)
class StoredViews:
    """View vectors of one map.

    Attributes:
        map: name of the map.
        file: identifies the version of its file that they were made from.
        model: id of the model that made the vectors.
        features: name of the extractor.
        vectors: (V, ``DIMENSIONS``).
    """

    map: str
    file: str
    features: str
    model: str
    vectors: FloatArray


class ViewStore:
    """The file with the view vectors. Not thread-safe.

    Args:
        path: of the file; None keeps everything in memory.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._connection: sqlite3.Connection | None = None

    def close(self) -> None:
        """Close the database connection; the next call opens another one."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def models(self) -> dict[str, Model]:
        """All models by the names of their features, except for unreadable ones and unknown extractors."""
        found = {}
        with self._open() as database:
            rows = database.execute("SELECT features, id, maps, data FROM models").fetchall()
        for features, id_, maps, data in rows:
            with contextlib.suppress(Exception):  # whatever is wrong with it, it is learned anew
                with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
                    pictures = PictureVectors.of_arrays(arrays, get_extractor(features).metric)
                found[features] = Model(id_, features, maps, pictures)
        return found

    def model_ids(self) -> dict[str, str]:
        """Ids of all models by the names of their features."""
        with self._open() as database:
            return dict(database.execute("SELECT features, id FROM models").fetchall())

    def put_model(self, model: Model, views: Iterable[StoredViews] = ()) -> None:
        """Store a model and the views it made; the model of the same features and all its views are deleted."""
        data = io.BytesIO()
        np.savez(data, allow_pickle=False, **model.pictures.arrays())
        row = (model.features, model.id, model.maps, data.getvalue())
        with self._open() as database:
            database.execute("INSERT OR REPLACE INTO models VALUES (?, ?, ?, ?)", row)
            database.execute("DELETE FROM views WHERE features = ?", (model.features,))
            database.executemany(_PUT_VIEWS, map(_row, views))

    def put(self, views: StoredViews) -> None:
        """Store a map's views, replacing its earlier ones."""
        with self._open() as database:
            database.execute(_PUT_VIEWS, _row(views))

    def drop(self, maps: Iterable[str]) -> None:
        """Delete the views of the named maps; unknown names are ignored."""
        with self._open() as database:
            database.executemany("DELETE FROM views WHERE map = ?", [(name,) for name in maps])

    def views(self, map_name: str | None = None) -> Iterator[StoredViews]:
        """Views of all maps, or of the map ``map_name``; read lazily within a transaction."""
        query = "SELECT map, file, features, model, vectors FROM views"
        with self._open() as database:
            rows = (
                database.execute(query) if map_name is None else database.execute(f"{query} WHERE map = ?", (map_name,))
            )
            for name, file, features, model, data in rows:
                packed = np.frombuffer(data[: len(data) // DIMENSIONS * DIMENSIONS], np.int8).reshape(-1, DIMENSIONS)
                yield StoredViews(name, file, features, model, unpacked_vectors(packed))

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        """The database in a transaction, opened if it is not. A corrupt file is deleted, so that the next call starts
        with an empty one.

        Raises:
            sqlite3.Error: the file cannot be used.
            OSError: its folder cannot be made.
        """
        if self._connection is None:
            self._connection = self._connected()
        try:
            with self._connection as database:
                yield database
        except sqlite3.OperationalError:  # it is locked, the disk is full, the folder cannot be written to
            self.close()
            raise
        except sqlite3.DatabaseError:
            self.close()
            self._remove()
            raise

    def _connected(self) -> sqlite3.Connection:
        """An open connection; a corrupt file, or one of another layout, is begun anew. Raises OperationalError."""
        try:
            return self._new_connection()
        except sqlite3.OperationalError:
            raise
        except sqlite3.DatabaseError:
            self._remove()
            return self._new_connection()

    def _new_connection(self) -> sqlite3.Connection:
        """Open the database, making folder, file and tables if missing. Raises DatabaseError for another layout."""
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
        connection = sqlite3.connect(self._path or ":memory:", timeout=_BUSY_TIMEOUT_S, check_same_thread=False)
        try:
            if self._path is not None:
                connection.execute("PRAGMA journal_mode = WAL")
                connection.execute("PRAGMA synchronous = NORMAL")
            (layout,) = connection.execute("PRAGMA user_version").fetchone()
            if layout not in (0, _LAYOUT):
                raise sqlite3.DatabaseError("The file is of another version.")
            connection.executescript(_TABLES)
            connection.execute(f"PRAGMA user_version = {_LAYOUT}")
        except sqlite3.Error:
            connection.close()
            raise
        return connection

    def _remove(self) -> None:
        """Delete the file with SQLite's own beside it; nothing for a database in memory."""
        if self._path is not None:
            for ending in ("", "-wal", "-shm"):
                self._path.with_name(self._path.name + ending).unlink(missing_ok=True)


_PUT_VIEWS = "INSERT OR REPLACE INTO views VALUES (?, ?, ?, ?, ?)"


def _row(views: StoredViews) -> tuple[str, str, str, str, bytes]:
    """The columns of a row of the table ``views``."""
    return views.map, views.file, views.features, views.model, packed_vectors(views.vectors).tobytes()
