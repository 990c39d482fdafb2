"""A PostgreSQL of the tests' own."""

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest


def _program(name: str) -> str:
    """Where a program of PostgreSQL is; Debian keeps most of them off the path."""
    found = shutil.which(name) or next(map(str, Path("/usr/lib/postgresql").glob(f"*/bin/{name}")), None)
    return found or pytest.skip("PostgreSQL is not installed")


class PostgresServer:
    """A server on a socket in a folder of its own. PostgreSQL refuses to run as root, so it runs as its own user.

    ``setpriv`` changes the user, for Python's own way forks, which a process with threads of OpenBLAS may not survive.
    """

    def __init__(self) -> None:
        user = "postgres" if os.geteuid() == 0 else None
        self._as_user = ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups"] if user else []
        self._folder = Path(tempfile.mkdtemp(prefix="rholoc-postgres-"))  # pytest's own are closed to other users
        if user is not None:
            account = pwd.getpwnam(user)
            os.chown(self._folder, account.pw_uid, account.pw_gid)
        self._cluster = self._folder / "cluster"
        self._options = {"cwd": self._folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        arguments = ["-U", "postgres", "-A", "trust", "-E", "UTF8", "--no-locale", "-N", "-D", str(self._cluster)]
        subprocess.run([*self._as_user, _program("initdb"), *arguments], check=True, **self._options)
        self.start()

    @property
    def host(self) -> Path:
        """Where its socket is."""
        return self._folder

    def start(self) -> None:
        """Start it, and wait until it answers."""
        quick = ["-c", "listen_addresses=", "-c", "fsync=off", "-k", str(self._folder)]
        command = [*self._as_user, _program("postgres"), "-D", str(self._cluster), *quick]
        self._server = subprocess.Popen(command, **self._options)
        ready = [_program("pg_isready"), "-q", "-h", str(self._folder)]
        while not (self._folder / ".s.PGSQL.5432").exists() or subprocess.run(ready, check=False).returncode:
            assert self._server.poll() is None, "PostgreSQL did not start"

    def stop(self) -> None:
        """Stop it at once, whoever is connected."""
        self._server.send_signal(signal.SIGINT)
        self._server.wait(30)

    def kill(self) -> None:
        """Kill all its processes, as a machine does that goes down."""
        self._signal_all(signal.SIGKILL)
        self._server.wait(30)

    def silence(self) -> None:
        """Stop all its processes where they are: connections stay open, and nothing answers."""
        self._signal_all(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it answer again."""
        self._signal_all(signal.SIGCONT)

    @contextmanager
    def silent(self) -> Iterator[None]:
        """Silence it for the block."""
        self.silence()
        try:
            yield
        finally:
            self.resume()

    def _signal_all(self, number: signal.Signals) -> None:
        (pid,) = (int(line) for line in (self._cluster / "postmaster.pid").read_text().split("\n")[:1])
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for one in [pid, *map(int, children)]:
            with suppress(ProcessLookupError):
                os.kill(one, number)

    def create_database(self, name: str) -> str:
        """Make a database; returns its URL."""
        subprocess.run([_program("createdb"), "-h", str(self._folder), "-U", "postgres", name], check=True)
        return f"postgresql://postgres@/{name}?host={self._folder}"

    def close(self) -> None:
        """Stop it and remove what it kept."""
        self.stop()
        shutil.rmtree(self._folder)
