"""Database table of the maps, recordings and jobs that API keys hold."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum

import sqlalchemy as sa

from rholoc.storage.database import read_rows
from rholoc.storage.tables import holdings_table as table


class Kind(StrEnum):
    """Kind of a held thing."""

    MAP = "map"
    RECORDING = "recording"  # or the upload that becomes one
    JOB = "job"  # or the upload that brings it


@dataclass(frozen=True)
class Holding:
    """Something that a key has stored or begun.

    Attributes:
        kind: of the thing.
        name: a map's name, or an id.
        key: name of the key.
        holder: name of the root of the chain of keys that handed ``key`` on; empty if there is none.
        size_bytes: of a recording's files; 0 for other kinds.
    """

    kind: Kind
    name: str
    key: str
    holder: str = ""
    size_bytes: int = 0


class Holdings:
    """The holdings of all keys, which may outlive the held things: callers must check.

    Each method raises SQLAlchemyError if the database does not answer.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def hold(self, holding: Holding) -> None:
        """Record a holding, in place of any earlier holder's of the same thing. Raises SQLAlchemyError."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(*_is(holding.kind, holding.name)))
            connection.execute(table.insert().values(**asdict(holding)))

    def rename(self, kind: Kind, name: str, new_name: str) -> None:
        """Rename a held thing; a holding of the new name is replaced. Raises SQLAlchemyError."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(*_is(kind, new_name)))
            connection.execute(table.update().where(*_is(kind, name)).values(name=new_name))

    def of(self, keys: Sequence[str]) -> Sequence[Holding]:
        """Holdings of the named keys and of keys with such a ``holder``, revoked or not. Raises SQLAlchemyError."""
        return self._found(sa.or_(table.c.key.in_(keys), table.c.holder.in_(keys)))

    def all(self) -> Sequence[Holding]:
        """Holdings of all keys. Raises SQLAlchemyError."""
        return self._found(sa.true())

    def drop(self, holdings: Sequence[Holding]) -> None:
        """Remove holdings, unless their holder has changed. Raises SQLAlchemyError."""
        with self._engine.begin() as connection:
            for one in holdings:
                connection.execute(table.delete().where(*_is(one.kind, one.name), table.c.key == one.key))

    def _found(self, where: sa.ColumnElement[bool]) -> Sequence[Holding]:
        """The holdings whose rows fulfil a condition."""
        rows = read_rows(self._engine, sa.select(table).where(where))
        return [Holding(**{**row, "kind": Kind(row["kind"])}) for row in rows]


def _is(kind: Kind, name: str) -> tuple[sa.ColumnElement[bool], sa.ColumnElement[bool]]:
    """Conditions on a row: the holding of this thing."""
    return table.c.kind == kind, table.c.name == name
