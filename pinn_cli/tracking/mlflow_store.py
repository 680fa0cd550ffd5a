"""Where MLflow keeps runs: a SQLite file, or a server; which of them can be used is found out without MLflow.

MLflow itself would import drivers by the name in a URI, make files of any name, and try a server that does not answer
for minutes.
"""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import getproxies

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.paths import located

SQLITE, SERVERS = "sqlite:///", ("http", "https")
ALLOWED = "a SQLite file, sqlite:///FILE, or a server, http://HOST:PORT"
# How a database begins; one that was only just made is empty.
SQLITE_HEADER = b"SQLite format 3\0"
# A server is waited for so long, s, for each of two tries; what the user's environment says of it counts more.
ANSWER_S = 10
_LIMITS = {
    "MLFLOW_HTTP_REQUEST_TIMEOUT": str(ANSWER_S),
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
}


@dataclass(frozen=True)
class Store:
    """A store of runs.

    Attributes:
        uri: As MLflow takes it.
        database: The SQLite file; None for a server.
    """

    uri: str
    database: Path | None

    @classmethod
    def of(cls, uri: object, start: Path) -> Store:
        """The one that a user names; a relative file begins at ``start``.

        Raises:
            InputError: It is neither a SQLite file nor a server.
        """
        if isinstance(uri, str) and uri.startswith(SQLITE) and uri.removeprefix(SQLITE).strip(" /"):
            database = located(uri.removeprefix(SQLITE), start)
            return cls(f"{SQLITE}{database}", database)
        if not isinstance(uri, str) or _address(uri) is None:
            raise InputError("tracking.uri", uri, ALLOWED)
        return cls(uri, None)

    def check(self) -> None:
        """Refuse a file that is no database, and a server that does not answer.

        Raises:
            InputError: It is one of these.
        """
        if self.database is None:
            os.environ.update({name: value for name, value in _LIMITS.items() if name not in os.environ})
            self._check_server()
            return
        try:
            whole = self.database.is_file()
            there = whole or self.database.exists()
            with self.database.open("rb") if whole else open(os.devnull, "rb") as file:
                beginning = file.read(len(SQLITE_HEADER))
        except (OSError, ValueError) as error:  # a null character is a ValueError
            hint = getattr(error, "strerror", None) or str(error)
            raise InputError("tracking.uri", self.uri, "a file that can be used", hint) from error
        if (there and not whole) or beginning not in (b"", SQLITE_HEADER):
            raise InputError("tracking.uri", self.uri, ALLOWED, "what is there is no SQLite file, and is left alone")

    def _check_server(self) -> None:
        address, scheme = _address(self.uri), urlsplit(self.uri).scheme
        if address is None or scheme in getproxies():
            return
        try:
            socket.create_connection(address, timeout=ANSWER_S).close()
        except (OSError, UnicodeError) as error:
            hint = f"nothing answers there ({getattr(error, 'strerror', None) or error})"
            raise InputError("tracking.uri", self.uri, "a server that runs", hint) from error


def _address(uri: str) -> tuple[str, int] | None:
    """Host and port of a server; None where there is none."""
    try:
        parts = urlsplit(uri)
        port = parts.port
    except ValueError:  # no port is above 65535
        return None
    if parts.scheme not in SERVERS or not parts.hostname:
        return None
    return parts.hostname, port or (443 if parts.scheme == "https" else 80)
