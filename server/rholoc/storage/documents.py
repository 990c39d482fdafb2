"""Small files in the catalogue, which all servers share."""

from __future__ import annotations

from collections.abc import Callable

import sqlalchemy as sa

from rholoc.storage.replica import Replica
from rholoc.storage.tables import documents_table


class _HoldsSomethingElse(Exception):
    """A file does not hold what it should."""


class CatalogueDocuments:
    """The small files of one kind; see :class:`rholoc.maps.Documents`. Read from memory, written to the database.

    Args:
        replica: the catalogue.
        kind: what they are, the beginning of their paths.
    """

    def __init__(self, replica: Replica, kind: str) -> None:
        self._replica = replica
        self._prefix = f"{kind}/"

    def names(self) -> list[str]:
        """The names of all files."""
        return [path.removeprefix(self._prefix) for path in self._replica.documents if path.startswith(self._prefix)]

    def read(self, name: str) -> bytes:
        """What a file holds. Raises FileNotFoundError."""
        try:
            return self._replica.documents[self._prefix + name]
        except KeyError as error:
            raise FileNotFoundError(name) from error

    def stamp(self) -> object:
        """The catalogue's revision."""
        return self._replica.revision

    def write(self, name: str, content: bytes, called: str = "") -> None:
        """Store a file. Raises SQLAlchemyError: nothing was replaced."""
        self._set(name, content)

    def exchange(self, name: str, before: bytes | None, content: bytes, called: str = "") -> bool:
        """Store a file that holds ``before``. Raises SQLAlchemyError: nothing was replaced."""
        try:
            self._set(name, content, lambda present: present == before)
        except _HoldsSomethingElse:
            self._replica.refresh()
            return False
        return True

    def delete(self, name: str) -> None:
        """Remove a file. Raises FileNotFoundError."""
        self.read(name)
        self._set(name, None)

    def _set(self, name: str, content: bytes | None, accepts: Callable[[bytes | None], bool] = lambda _: True) -> None:
        path = self._prefix + name
        with self._replica.changing() as (connection, revision):
            wanted = sa.select(documents_table.c.content).where(documents_table.c.path == path)
            if not accepts(connection.execute(wanted).scalar()):
                raise _HoldsSomethingElse
            values = {"content": content, "revision": revision}
            changed = connection.execute(
                documents_table.update().where(documents_table.c.path == path).values(**values)
            )
            if not changed.rowcount:
                connection.execute(documents_table.insert().values(path=path, **values))
