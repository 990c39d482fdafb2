"""Small files by name, in the catalogue that several servers share."""

import sqlalchemy as sa

from rholoc.library.folder_documents import Accepts, Documents
from rholoc.storage.replica import Replica
from rholoc.storage.tables import documents_table


class StoredDocuments(Documents):
    """The small files of one kind, read from memory and written to the database.

    Args:
        replica: the catalogue.
        kind: first part of their paths.
    """

    def __init__(self, replica: Replica, kind: str) -> None:
        self._replica = replica
        self._prefix = f"{kind}/"

    def names(self) -> list[str]:
        """Names of all files of this kind as of the last refresh, in no order."""
        return [path.removeprefix(self._prefix) for path in self._replica.documents if path.startswith(self._prefix)]

    def read(self, name: str) -> bytes:
        """Content of a file as of the last refresh. Raises FileNotFoundError."""
        try:
            return self._replica.documents[self._prefix + name]
        except KeyError as error:
            raise FileNotFoundError(name) from error

    def stamp(self) -> object:
        """The catalogue's revision at the last refresh; -1 before the first."""
        return self._replica.revision

    def _set(self, name: str, content: bytes | None, called: str, accepts: Accepts | None = None) -> bool:
        """Store a file, or remove it (``content`` None), in a transaction. False if refused, or already missing."""
        table, path = documents_table, self._prefix + name
        with self._replica.changing() as (connection, revision):
            present = connection.execute(sa.select(table.c.content).where(table.c.path == path)).scalar()
            if (content is None and present is None) or (accepts is not None and not accepts(present)):
                return False
            values = {"content": content, "revision": revision}
            changed = connection.execute(table.update().where(table.c.path == path).values(**values))
            if not changed.rowcount:
                connection.execute(table.insert().values(path=path, **values))
        return True
