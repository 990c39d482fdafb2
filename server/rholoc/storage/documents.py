"""Small files in the catalogue, which all servers share."""

from __future__ import annotations

from rholoc.storage.replica import Replica
from rholoc.storage.tables import documents_table


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

    def delete(self, name: str) -> None:
        """Remove a file. Raises FileNotFoundError."""
        self.read(name)
        self._set(name, None)

    def _set(self, name: str, content: bytes | None) -> None:
        path = self._prefix + name
        with self._replica.changing() as (connection, revision):
            values = {"content": content, "revision": revision}
            changed = connection.execute(
                documents_table.update().where(documents_table.c.path == path).values(**values)
            )
            if not changed.rowcount:
                connection.execute(documents_table.insert().values(path=path, **values))
