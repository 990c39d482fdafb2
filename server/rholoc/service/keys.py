"""API keys: who may do what. A key is shown once, when it is made; only its hash is kept."""

from __future__ import annotations

import hashlib
import hmac
import json
import re
import secrets
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path

from rholoc.errors import Conflict, InvalidName, NotFound
from rholoc.maps import Documents, FolderDocuments

HANDED_PREFIX = "handed-"  # of the names of keys that were handed on
FOLDER = "keys"
_PREFIX = "rho_"
_BYTES = 32
_HASH = re.compile(r"[0-9a-f]{64}")
_MAX_NAME_LENGTH = 64


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
class ApiKey:
    """What is known of a key; not the key itself.

    Attributes:
        name: says whose it is; unique.
        scope: what it allows.
        created: seconds since the epoch.
        expires: seconds since the epoch, or None.
    """

    name: str
    scope: Scope
    created: float
    expires: float | None = None

    @property
    def expired(self) -> bool:
        """Whether its time is over."""
        return self.expires is not None and time.time() >= self.expires


class KeyStore:
    """The keys of a service: a file each, named by the key's SHA-256.

    A key is 32 random bytes, which cannot be guessed, so a slow hash is not needed. New and revoked keys take effect
    with the next request, in every process that shares the folder.

    Args:
        data_dir: the folder that they are kept in.
        files: where they are kept instead.
    """

    def __init__(self, data_dir: Path, files: Documents | None = None) -> None:
        self._files = files or FolderDocuments(Path(data_dir) / FOLDER, mode=0o700)

    def create(self, name: str, scope: Scope, lifetime_s: float | None = None) -> str:
        """Make a key and return it; it cannot be seen again.

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
        key = ApiKey(name, scope, now, None if lifetime_s is None else now + lifetime_s)
        self._files.write(_hash(secret), json.dumps(asdict(key)).encode(), called="the key")
        return secret

    def keys(self) -> list[ApiKey]:
        """All keys, expired ones too, the oldest first."""
        return sorted((key for key in map(self._read, self._hashes()) if key is not None), key=lambda key: key.created)

    def revoke(self, name: str) -> None:
        """Forget the key of that name.

        Raises:
            NotFound: there is no key of this name.
        """
        found = [hashed for hashed in self._hashes() if (key := self._read(hashed)) is not None and key.name == name]
        if not found:
            raise NotFound(f"There is no key called {name}.", "rholoc key list shows the keys.")
        for hashed in found:
            with suppress(FileNotFoundError):
                self._files.delete(hashed)

    def find(self, secret: str) -> ApiKey | None:
        """The key, expired or not, or None. The comparison takes the same time wherever two hashes differ."""
        given = _hash(secret)
        matching = [hashed for hashed in self._hashes() if hmac.compare_digest(hashed, given)]
        return self._read(matching[0]) if matching else None

    def _hashes(self) -> list[str]:
        return [name for name in self._files.names() if _HASH.fullmatch(name)]

    def _read(self, hashed: str) -> ApiKey | None:
        """A key; None where it was revoked meanwhile."""
        try:
            stored = json.loads(self._files.read(hashed))
        except FileNotFoundError:
            return None
        return ApiKey(stored["name"], Scope(stored["scope"]), stored["created"], stored["expires"])


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()
