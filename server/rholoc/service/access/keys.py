"""API keys. A key is shown once, when it is made; only its hash is stored."""

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
from rholoc.library.folder_documents import Documents, FolderDocuments
from rholoc.service.errors import QuotaExceeded

HANDED_PREFIX = "handed-"  # of the names of handed-on keys
FOLDER = "keys"
_PREFIX = "rho_"
_BYTES = 32
_HASH = re.compile(r"[0-9a-f]{64}")
_MAX_NAME_LENGTH = 64
_MAX_CHAIN = 100  # length of a chain of handed-on keys
_MAX_HANDED = 1000  # valid at the same time, of all keys together
_MAX_HANDED_BY = 100  # by one key, with those below it
_NAME_BYTES = 4  # of a key that is handed on


class Scope(StrEnum):
    """Scope of a key; each scope includes the ones before it."""

    VISIT = "visit"  # find oneself in a site, see its rooms and named points
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
    """Limits of a key together with all keys that it handed on; None stands for no limit.

    Attributes:
        requests_per_s: to each server.
        burst: maximum number of requests at once; None for one second's worth, at least 1.
        maps: maximum number, including maps that its jobs will publish.
        stored_bytes: of its maps and recordings.
        jobs: maximum number of queued and running jobs.
    """

    requests_per_s: float | None = None
    burst: int | None = None
    maps: int | None = None
    stored_bytes: int | None = None
    jobs: int | None = None

    @property
    def quotas(self) -> bool:
        """Whether maps, bytes or jobs are limited."""
        return any(limit is not None for limit in (self.maps, self.stored_bytes, self.jobs))

    def within(self, other: KeyLimits) -> KeyLimits:
        """The lower of the two limits, one by one; None where neither has one."""
        both = ((getattr(self, one.name), getattr(other, one.name)) for one in fields(self))
        return KeyLimits(*(min((one for one in pair if one is not None), default=None) for pair in both))


@dataclass(frozen=True)
class ApiKey:
    """Stored data of a key, without the secret.

    Attributes:
        name: unique.
        scope: of the key.
        created: seconds since the epoch.
        expires: seconds since the epoch; None for never.
        limits: of the key.
        holder: id of the key that handed it on, whose limits include this key; empty if there is none.
        id: hash of the secret.
        site: only site that a key of scope ``visit`` is for; empty for all.
    """

    name: str
    scope: Scope
    created: float
    expires: float | None = None
    limits: KeyLimits = field(default_factory=KeyLimits)
    holder: str = ""
    id: str = ""
    site: str = ""

    @property
    def expired(self) -> bool:
        """Whether its lifetime is over; False if it is unlimited."""
        return self.expires is not None and time.time() >= self.expires


class KeyStore:
    """The keys of a service: a file each, named by the key's SHA-256. Safe to share between threads and processes.

    A key has 32 random bytes, so a slow hash is not needed. A handed-on key is valid as long as all keys above it are.
    :meth:`find`, :meth:`is_valid`, :meth:`chain` and :meth:`family` use the keys in memory, which each change here and
    each :meth:`refresh` updates; all other methods read the files.

    Args:
        files: of the keys; or the folder of data, in which they are ``keys/SHA256``.
    """

    def __init__(self, files: Path | Documents) -> None:
        self._files = FolderDocuments(files / FOLDER, mode=0o700) if isinstance(files, Path) else files
        self._known: dict[str, ApiKey] | None = None
        self._stamp: object = None
        self._reading = threading.Lock()

    def refresh(self) -> None:
        """Read the keys, if they may have changed since the last time."""
        stamp = self._files.stamp()
        if self._known is None or stamp is None or stamp != self._stamp:
            self._reload()

    def _reload(self) -> dict[str, ApiKey]:
        """Read all keys again; returns them by the hash of their secret."""
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
        site: str = "",
    ) -> str:
        """Make a key and return its secret, which cannot be retrieved again.

        Args:
            name: unique name.
            scope: of the key.
            lifetime_s: None for an unlimited lifetime.
            limits: of the key; None for none of its own.
            handed_by: parent key. Its limits cap the new key's; the new key is invalid as soon as the parent is. The
                caller checks that the parent's scope includes ``scope``.
            site: only site that a key of scope ``visit`` is for; empty for all.

        Raises:
            InvalidName: the name is empty, over 64 characters or not printable.
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
        key = ApiKey(name, scope, now, None if lifetime_s is None else now + lifetime_s, limits, holder, site=site)
        self._write(_hash(secret), key)
        return secret

    def hand_on(
        self, scope: Scope, lifetime_s: float, limits: KeyLimits, by: ApiKey | None, site: str = "", name: str = ""
    ) -> tuple[str, str]:
        """Make a temporary key, and delete expired ones. Returns its name, and its secret, which cannot be retrieved
        again.

        Args:
            scope: of the key.
            lifetime_s: its lifetime.
            limits: of the key.
            by: parent key; None if the server needs no keys.
            site: only site that a key of scope ``visit`` is for; empty for all.
            name: end of the key's name, after ``handed-``; empty for a random one.

        Raises:
            InvalidName: the name is too long or not printable.
            Conflict: there is a key of that name.
            QuotaExceeded: the parent's root key with all below it has 100 valid temporary keys.
            Busy: there are 1000 valid temporary keys.
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
        name = HANDED_PREFIX + (name or secrets.token_hex(_NAME_BYTES))
        return name, self.create(name, scope, lifetime_s, limits, by, site)

    def limit(self, name: str, limits: KeyLimits) -> ApiKey:
        """Replace the limits of the key called ``name``, from the next request on; returns the key.

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
        """The key called ``name``.

        Raises:
            NotFound: there is none.
        """
        key = self._read(self._hash_of(name))
        if key is None:
            raise _unknown(name)
        return key

    def chain(self, key: ApiKey) -> list[ApiKey]:
        """The key, its parent in memory, and so on to the root, at most 100: all keys to which a request counts."""
        found, known = [key], self._in_memory()
        while (holder := known.get(found[-1].holder)) is not None and len(found) < _MAX_CHAIN:
            found.append(holder)
        return found

    def is_valid(self, key: ApiKey) -> bool:
        """Whether a key and all keys above it exist, in memory, and have not expired."""
        chain, known = self.chain(key), self._in_memory()
        return not chain[-1].holder and all(one.id in known and not one.expired for one in chain)

    def family(self, name: str) -> list[str]:
        """Names of the key called ``name`` and of all keys in memory below it; empty if there is none."""
        known = self._in_memory().values()
        return [key.name for key in known if any(one.name == name for one in self.chain(key))]

    def keys(self) -> list[ApiKey]:
        """All keys, expired ones too, the oldest first."""
        return sorted(self._reload().values(), key=lambda key: key.created)

    def revoke(self, name: str) -> None:
        """Delete the key of that name and all keys that it handed on, directly or indirectly.

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
        """The key with this secret, also an expired one; None if it is unknown, or a key above it was revoked."""
        key = self._in_memory().get(_hash(secret))
        return None if key is None or self.chain(key)[-1].holder else key

    def _in_memory(self) -> dict[str, ApiKey]:
        """All keys by the hash of their secret, as last read."""
        return self._reload() if self._known is None else self._known

    def _hashes(self) -> list[str]:
        """Names of the keys' files: the hashes of their secrets."""
        return [name for name in self._files.names() if _HASH.fullmatch(name)]

    def _hash_of(self, name: str) -> str:
        """The hash of the secret of the key called ``name``. Raises NotFound."""
        for hashed in self._hashes():
            key = self._read(hashed)
            if key is not None and key.name == name:
                return hashed
        raise _unknown(name)

    def _write(self, hashed: str, key: ApiKey) -> None:
        """Store a key under the hash of its secret, and read all keys again."""
        stored = {name: value for name, value in asdict(key).items() if name != "id"}
        self._files.write(hashed, json.dumps(stored).encode(), called="the key")
        self._reload()

    def _read(self, hashed: str) -> ApiKey | None:
        """The key with this hash; None if it was revoked meanwhile."""
        try:
            stored = json.loads(self._files.read(hashed))
        except FileNotFoundError:
            return None
        limits = KeyLimits(**stored.get("limits", {}))
        holder, site = stored.get("holder", ""), stored.get("site", "")
        return ApiKey(
            stored["name"], Scope(stored["scope"]), stored["created"], stored["expires"], limits, holder, hashed, site
        )


def _unknown(name: str) -> NotFound:
    """Error for a name that no key has."""
    return NotFound(f"There is no key called {name[:_MAX_NAME_LENGTH]}.", "rholoc key list shows the keys.")


def _hash(secret: str) -> str:
    """SHA-256 of a secret, 64 hex digits."""
    return hashlib.sha256(secret.encode()).hexdigest()
