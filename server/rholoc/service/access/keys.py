"""API keys: who may do what. A key is shown once, when it is made; only its hash is kept."""

from __future__ import annotations

import hashlib
import json
import re
import secrets
import threading
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from enum import StrEnum
from pathlib import Path

from rholoc.errors import Busy, Conflict, InvalidName, NotFound
from rholoc.maps import Documents, FolderDocuments
from rholoc.service.errors import QuotaExceeded

HANDED_PREFIX = "handed-"  # of the names of keys that were handed on
FOLDER = "keys"
_PREFIX = "rho_"
_BYTES = 32
_HASH = re.compile(r"[0-9a-f]{64}")
_MAX_NAME_LENGTH = 64
_MAX_CHAIN = 100  # keys that were handed on one by the other
_MAX_HANDED = 1000  # valid at the same time, of all keys together
_MAX_HANDED_BY = 100  # by one key, with those below it
_NAME_BYTES = 4  # of a key that is handed on


class Scope(StrEnum):
    """What a key allows; each scope includes the ones before it."""

    READ = "read"  # look at maps, jobs, cameras
    LOCALIZE = "localize"  # ask for poses
    MAP = "map"  # upload, build, update, merge, rename
    ADMIN = "admin"  # delete maps

    def allows(self, wanted: Scope) -> bool:
        """Whether this scope includes ``wanted``."""
        order = list(Scope)
        return order.index(self) >= order.index(wanted)


@dataclass(frozen=True)
class KeyLimits:
    """How much a key allows, with all keys that it handed on; None where there is no limit.

    Attributes:
        requests_per_s: requests a second, to each server.
        burst: how many may come at once; None: those of a second, at least one.
        maps: how many maps it may hold, those of its jobs included.
        stored_bytes: of its maps and recordings.
        jobs: how many of its jobs may be queued or running.
    """

    requests_per_s: float | None = None
    burst: int | None = None
    maps: int | None = None
    stored_bytes: int | None = None
    jobs: int | None = None

    @property
    def quotas(self) -> bool:
        """Whether what it may hold is limited."""
        return any(limit is not None for limit in (self.maps, self.stored_bytes, self.jobs))

    def within(self, other: KeyLimits) -> KeyLimits:
        """The lower of each limit."""
        both = ((getattr(self, one.name), getattr(other, one.name)) for one in fields(self))
        return KeyLimits(*(min((one for one in pair if one is not None), default=None) for pair in both))


@dataclass(frozen=True)
class ApiKey:
    """What is known of a key; not the key itself.

    Attributes:
        name: says whose it is; unique.
        scope: what it allows.
        created: seconds since the epoch.
        expires: seconds since the epoch, or None.
        limits: how much it allows.
        holder: the id of the key that handed it on, and to which it counts as well; empty if none did.
        id: the key's hash.
    """

    name: str
    scope: Scope
    created: float
    expires: float | None = None
    limits: KeyLimits = field(default_factory=KeyLimits)
    holder: str = ""
    id: str = ""

    @property
    def expired(self) -> bool:
        """Whether its time is over."""
        return self.expires is not None and time.time() >= self.expires


class KeyStore:
    """The keys of a service: a file each, named by the key's SHA-256. Safe to share between threads and processes.

    A key is 32 random bytes, which cannot be guessed, so a slow hash is not needed. A key that was handed on is valid
    for as long as the keys above it are. :meth:`find`, :meth:`is_valid` and :meth:`chain` go by the keys in memory,
    which each change here and each :meth:`refresh` updates; all other methods read the files.

    Args:
        data_dir: the folder that they are kept in.
        files: where they are kept instead.
    """

    def __init__(self, data_dir: Path, files: Documents | None = None) -> None:
        self._files = files or FolderDocuments(Path(data_dir) / FOLDER, mode=0o700)
        self._known: dict[str, ApiKey] | None = None
        self._stamp: object = None
        self._reading = threading.Lock()

    def refresh(self) -> None:
        """Read the keys, if they may have changed since the last time."""
        stamp = self._files.stamp()
        if self._known is None or stamp is None or stamp != self._stamp:
            self._reload()

    def _reload(self) -> dict[str, ApiKey]:
        with self._reading:
            stamp = self._files.stamp()
            found = {hashed: self._read(hashed) for hashed in self._hashes()}
            known = self._known = {hashed: key for hashed, key in found.items() if key is not None}
            self._stamp = stamp
        return known

    def create(
        self,
        name: str,
        scope: Scope,
        lifetime_s: float | None = None,
        limits: KeyLimits | None = None,
        handed_by: ApiKey | None = None,
    ) -> str:
        """Make a key and return it; it cannot be seen again.

        Args:
            name: whose it is.
            scope: what it allows.
            lifetime_s: for how long; None: forever.
            limits: how much it allows.
            handed_by: the key that it is handed on by: it gets no more, and counts to it.

        Raises:
            InvalidName: the name is empty, too long or not printable.
            Conflict: there is a key of that name.
            StorageFull: the disk is full.
        """
        if not 0 < len(name) <= _MAX_NAME_LENGTH or not name.isprintable():
            raise InvalidName(f"{name[:_MAX_NAME_LENGTH]!r} is not a valid key name.", "Use 1 to 64 characters.")
        if any(key.name == name for key in self.keys()):
            raise Conflict(f"There is already a key called {name}.", "Revoke it first, or choose another name.")
        secret = _PREFIX + secrets.token_urlsafe(_BYTES)
        now = time.time()
        limits, holder = limits or KeyLimits(), ""
        if handed_by is not None:
            limits, holder = limits.within(handed_by.limits), handed_by.id
        key = ApiKey(name, scope, now, None if lifetime_s is None else now + lifetime_s, limits, holder)
        self._write(_hash(secret), key)
        return secret

    def hand_on(self, scope: Scope, lifetime_s: float, limits: KeyLimits, by: ApiKey | None) -> tuple[str, str]:
        """Make a temporary key. Returns its name, and the key itself, which cannot be seen again.

        Args:
            scope: what it allows.
            lifetime_s: for how long.
            limits: how much it allows.
            by: the key that it is handed on by; None where none is needed.

        Raises:
            QuotaExceeded: that key has handed on too many.
            Busy: there are too many temporary keys.
            StorageFull: the disk is full.
        """
        handed = [key for key in self.keys() if key.name.startswith(HANDED_PREFIX)]
        for key in handed:
            if key.expired:
                with suppress(NotFound):  # another request has done so
                    self.revoke(key.name)
        valid = [key for key in handed if not key.expired]
        first = None if by is None else self.chain(by)[-1]
        if first is not None and sum(self.chain(key)[-1].id == first.id for key in valid) >= _MAX_HANDED_BY:
            raise QuotaExceeded(
                f"The key {first.name} has handed on {_MAX_HANDED_BY} keys, the most allowed.",
                "Revoke some, or wait until they expire.",
            )
        if len(valid) >= _MAX_HANDED:
            raise Busy("Too many temporary keys exist at the moment.", "Revoke some, or wait until they expire.")
        name = HANDED_PREFIX + secrets.token_hex(_NAME_BYTES)
        return name, self.create(name, scope, lifetime_s, limits, by)

    def limit(self, name: str, limits: KeyLimits) -> ApiKey:
        """Set how much the key of a name allows, from the next request on; returns the key.

        Raises:
            NotFound: there is no key of this name.
            StorageFull: the disk is full.
        """
        hashed = self._hash_of(name)
        key = self._read(hashed)
        if key is None:
            raise _unknown(name)
        limited = replace(key, limits=limits)
        self._write(hashed, limited)
        return limited

    def named(self, name: str) -> ApiKey:
        """The key of a name.

        Raises:
            NotFound: there is none.
        """
        key = self._read(self._hash_of(name))
        if key is None:
            raise _unknown(name)
        return key

    def chain(self, key: ApiKey) -> list[ApiKey]:
        """The keys that a request with a key counts to: itself, the one that handed it on, and so on to the first."""
        found, known = [key], self._in_memory()
        while (holder := known.get(found[-1].holder)) is not None and len(found) < _MAX_CHAIN:
            found.append(holder)
        return found

    def is_valid(self, key: ApiKey) -> bool:
        """Whether a key still exists and has not expired, nor have those above it."""
        chain, known = self.chain(key), self._in_memory()
        return not chain[-1].holder and all(one.id in known and not one.expired for one in chain)

    def family(self, name: str) -> list[str]:
        """The names of a key and of all keys below it that exist."""
        known = self._in_memory().values()
        return [key.name for key in known if any(one.name == name for one in self.chain(key))]

    def keys(self) -> list[ApiKey]:
        """All keys, expired ones too, the oldest first."""
        return sorted(self._reload().values(), key=lambda key: key.created)

    def revoke(self, name: str) -> None:
        """Delete the key of that name and all keys below it.

        Raises:
            NotFound: there is no key of this name.
        """
        revoked = self._hash_of(name)
        below = [key.id for key in self._reload().values() if any(one.id == revoked for one in self.chain(key))]
        for hashed in dict.fromkeys([revoked, *below]):
            with suppress(FileNotFoundError):
                self._files.delete(hashed)
        self._reload()

    def find(self, secret: str) -> ApiKey | None:
        """The key, expired or not, or None; None too if a key above it was revoked."""
        key = self._in_memory().get(_hash(secret))
        return None if key is None or self.chain(key)[-1].holder else key

    def _in_memory(self) -> dict[str, ApiKey]:
        return self._reload() if self._known is None else self._known

    def _hashes(self) -> list[str]:
        return [name for name in self._files.names() if _HASH.fullmatch(name)]

    def _hash_of(self, name: str) -> str:
        """The hash of the key of a name. Raises NotFound."""
        for hashed in self._hashes():
            key = self._read(hashed)
            if key is not None and key.name == name:
                return hashed
        raise _unknown(name)

    def _write(self, hashed: str, key: ApiKey) -> None:
        stored = {name: value for name, value in asdict(key).items() if name != "id"}
        self._files.write(hashed, json.dumps(stored).encode(), called="the key")
        self._reload()

    def _read(self, hashed: str) -> ApiKey | None:
        """A key; None where it was revoked meanwhile."""
        try:
            stored = json.loads(self._files.read(hashed))
        except FileNotFoundError:
            return None
        limits = KeyLimits(**stored.get("limits", {}))
        holder = stored.get("holder", "")
        return ApiKey(
            stored["name"], Scope(stored["scope"]), stored["created"], stored["expires"], limits, holder, hashed
        )


def _unknown(name: str) -> NotFound:
    return NotFound(f"There is no key called {name[:_MAX_NAME_LENGTH]}.", "rholoc key list shows the keys.")


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
