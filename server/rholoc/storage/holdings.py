"""Which API key holds what: maps, recordings and jobs, in the database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum

import sqlalchemy as sa

from rholoc.storage.tables import holdings_table as table


class Kind(StrEnum):
    """What is held."""

    MAP = "map"
    RECORDING = "recording"  # or the upload that becomes one
    JOB = "job"  # or the upload that brings it


@dataclass(frozen=True)
class Holding:
    """Something that a key has stored, or has begun.

    Attributes:
        kind: what it is.
        name: a map's name, else an id.
        key: the name of the key.
        holder: name of the first of the keys that handed ``key`` on; empty if none did.
        size_bytes: of a recording's files; 0 of anything else.
    """

    kind: Kind
    name: str
    key: str
    holder: str = ""
    size_bytes: int = 0


class Holdings:
    """The holdings of all keys. They may outlive what they are about: whoever asks knows what there is.

    Each method raises SQLAlchemyError where the database does not answer.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine

    def hold(self, holding: Holding) -> None:
        """Note who holds something; whoever held it before does not any more."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(*_is(holding.kind, holding.name)))
            connection.execute(table.insert().values(**asdict(holding)))

    def rename(self, kind: Kind, name: str, new_name: str) -> None:
        """Let the holder of something hold it under another name."""
        with self._engine.begin() as connection:
            connection.execute(table.delete().where(*_is(kind, new_name)))
            connection.execute(table.update().where(*_is(kind, name)).values(name=new_name))

    def of(self, keys: Sequence[str]) -> Sequence[Holding]:
        """Holdings of some keys by name, with those of keys below them that were revoked since."""
        return self._found(sa.or_(table.c.key.in_(keys), table.c.holder.in_(keys)))

    def all(self) -> Sequence[Holding]:
        """What all keys hold."""
        return self._found(sa.true())

    def drop(self, holdings: Sequence[Holding]) -> None:
        """Forget holdings, unless somebody else holds the same by now."""
        with self._engine.begin() as connection:
            for one in holdings:
                connection.execute(table.delete().where(*_is(one.kind, one.name), table.c.key == one.key))

    def _found(self, where: sa.ColumnElement[bool]) -> Sequence[Holding]:
        with self._engine.connect() as connection:
            rows = connection.execute(sa.select(table).where(where)).mappings()
            return [Holding(**{**row, "kind": Kind(row["kind"])}) for row in rows]


def _is(kind: Kind, name: str) -> tuple[sa.ColumnElement[bool], sa.ColumnElement[bool]]:
    return table.c.kind == kind, table.c.name == name
