"""Tables of the store, and the database: SQLite or PostgreSQL."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Double,
    Engine,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    create_engine,
    event,
    exc,
    func,
    insert,
    inspect,
    make_url,
    select,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import URL

from service.store.migrations import LAYOUT, upgrade
from service.store.records import BadAddress, StoreError, StoreUnavailable

__all__ = ["Database", "drafts", "events", "jobs", "keys", "pointers", "traffic", "verbs", "versions"]

CONNECTIONS = 3
"""Largest number of connections of a store, besides one for keys and one for notices."""

_SETTING_UP = 0x41645631  # keys of advisory locks
_PUBLISHING = 0x41645632
_ADDING_DRAFTS = 0x41645633
_CHANGING_KEYS = 0x41645634

metadata = MetaData()

layouts = Table("adverb_layout", metadata, Column("number", Integer, primary_key=True, autoincrement=False))

verbs = Table(
    "adverb_verbs",
    metadata,
    Column("name", String(63), primary_key=True),
    Column("last", Integer, nullable=False),  # highest number so far, including removed versions
)

versions = Table(
    "adverb_versions",
    metadata,
    Column("verb", String(63), ForeignKey("adverb_verbs.name"), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("sha256", String(64), nullable=False, index=True),
    Column("size_bytes", BigInteger, nullable=False),
    Column("author", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("quality", Text, nullable=False),
    Column("created_at_s", Double, nullable=False),
    Column("parent", Integer),  # no foreign key: the parent may be removed
    Column("source_sha256", String(64)),  # archive of the source
)

pointers = Table(
    "adverb_pointers",
    metadata,
    Column("verb", String(63), primary_key=True),
    Column("number", Integer, nullable=False),
    ForeignKeyConstraint(["verb", "number"], ["adverb_versions.verb", "adverb_versions.number"]),
)

events = Table(
    "adverb_events",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("verb", String(63), ForeignKey("adverb_verbs.name"), nullable=False),
    Column("kind", String(16), nullable=False),
    Column("number", Integer, nullable=False),
    Column("current", Integer),
    Column("author", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("at_s", Double, nullable=False),
    Index("adverb_events_of_verb", "verb", "id"),
)

jobs = Table(
    "adverb_jobs",
    metadata,
    Column("id", String(200), primary_key=True),
    Column("verb", String(63), nullable=False, index=True),
    Column("state", String(16), nullable=False),
    Column("request", Text, nullable=False),
    Column("progress", Text, nullable=False),
    Column("reaps", Integer, nullable=False),
    Column("version_before", Integer),
    Column("version_after", Integer),
    Column("detail", Text, nullable=False),
    Column("created_at_s", Double, nullable=False, index=True),
    Column("updated_at_s", Double, nullable=False),
)

traffic = Table(
    "adverb_traffic",
    metadata,
    Column("verb", String(63), primary_key=True),
    Column("server", String(200), primary_key=True),
    Column("cells", Text, nullable=False),
    Column("at_s", Double, nullable=False),
)

drafts = Table(
    "adverb_drafts",
    metadata,
    Column("id", String(32), primary_key=True),
    Column("revision", Integer, nullable=False),
    Column("name", String(63), nullable=False),
    Column("clips", Integer, nullable=False),
    Column("excluded", Integer, nullable=False),
    Column("archive", String(64), nullable=False),  # blobs
    Column("motion", String(64), nullable=False),
    Column("artifact", String(64)),
    Column("size_bytes", BigInteger, nullable=False),
    Column("document", Text, nullable=False),
    Column("created_at_s", Double, nullable=False),
    Column("changed_at_s", Double, nullable=False, index=True),
)

keys = Table(
    "adverb_keys",
    metadata,
    Column("id", String(16), primary_key=True),
    Column("name", Text, nullable=False),
    Column("scopes", Text, nullable=False),  # separated by blanks
    Column("sha256", String(64), nullable=False),
    Column("created_at_s", Double, nullable=False),
    Column("expires_at_s", Double),
    Column("revoked_at_s", Double),
    Column("revision", Integer, nullable=False, index=True),  # rises with each change of any key
)


class Database:
    """A database with a small connection pool; connection failures raise :class:`StoreUnavailable`.

    Parameters
    ----------
    address : str
        ``sqlite:////absolute/state.db`` or ``postgresql://…``.
    timeout_s : float
        Longest wait for a connection, a lock or a statement, seconds.
    connections : int
        Largest number of connections.

    Raises
    ------
    BadAddress
        The address is of another kind.
    """

    def __init__(self, address: str, *, timeout_s: float, connections: int = CONNECTIONS) -> None:
        self.url, self.timeout_s, self._connections = _url(address), timeout_s, connections
        self.sqlite = self.url.get_backend_name() == "sqlite"
        self.available, self.closed = False, False
        self._engine = self._make_engine()

    def apart(self) -> Database:
        """The same database through a connection of its own, for which calls of this one do not wait."""
        address = self.url.render_as_string(hide_password=False)
        return Database(address, timeout_s=self.timeout_s, connections=1)

    def prepare(self) -> None:
        """Create missing tables and upgrade older ones; raises :class:`StoreError` if they are newer than this code."""
        if self.sqlite:
            self._write_ahead()
        with self.transaction(writes=True) as connection:
            if not self.sqlite:
                connection.execute(select(func.pg_advisory_xact_lock(_SETTING_UP)))
            metadata.create_all(connection)
            layout = connection.execute(select(func.max(layouts.c.number))).scalar()
            if layout is None:
                connection.execute(insert(layouts).values(number=LAYOUT))
            elif layout > LAYOUT:
                raise StoreError(f"the database has layout {layout}; this Adverb reads up to {LAYOUT}: upgrade it")
            elif layout < LAYOUT:
                upgrade(connection, layout)

    @property
    def missing(self) -> bool:
        """Whether it is a file that does not exist; a connection would create it."""
        return self.sqlite and not Path(str(self.url.database)).is_file()

    def layout(self) -> int | None:
        """Layout of the tables, without a change to them; None where there are none."""
        with self.transaction() as connection:
            if not inspect(connection).has_table(layouts.name):
                return None
            return connection.execute(select(func.max(layouts.c.number))).scalar()

    @contextmanager
    def transaction(self, *, writes: bool = False) -> Iterator[Connection]:
        """A transaction that is committed at the end, or rolled back by any exception.

        Raises :class:`StoreUnavailable` if the database cannot be reached or does not answer in time.
        """
        if self.closed:
            raise StoreUnavailable("it is closed")
        try:
            with self._engine.connect().execution_options(adverb_writes=writes) as connection, connection.begin():
                self.available = True
                yield connection
        except (exc.IntegrityError, exc.ProgrammingError, exc.DataError):
            raise  # a programming error
        except exc.TimeoutError as err:  # of the pool; the database itself may work
            raise StoreUnavailable(f"no connection became free within {self.timeout_s:g} s") from err
        except exc.DBAPIError as err:
            self.available = False
            raise StoreUnavailable(self.reason(err)) from err

    def insert(self, table: Table) -> sqlite.Insert | postgresql.Insert:
        """An insert with ``ON CONFLICT`` clauses."""
        return sqlite.insert(table) if self.sqlite else postgresql.insert(table)

    def lock_blobs(self, connection: Connection, *, removing: bool) -> None:
        """Until the transaction ends, prevent others from removing blobs or, if ``removing``, from publishing."""
        if self.sqlite:
            return  # SQLite has one writer at a time
        lock = func.pg_advisory_xact_lock if removing else func.pg_advisory_xact_lock_shared
        connection.execute(select(lock(_PUBLISHING)))

    def lock_drafts(self, connection: Connection) -> None:
        """Until the transaction ends, prevent others from adding drafts, so that their number can be bounded."""
        if not self.sqlite:
            connection.execute(select(func.pg_advisory_xact_lock(_ADDING_DRAFTS)))

    def lock_keys(self, connection: Connection) -> None:
        """Until the transaction ends, prevent others from changing keys, so that revisions rise in order."""
        if not self.sqlite:
            connection.execute(select(func.pg_advisory_xact_lock(_CHANGING_KEYS)))

    def notify(self, connection: Connection, verb: str) -> None:
        """Notify servers, when the transaction is committed, that the current version of a verb changed."""
        if not self.sqlite:
            from service.store.postgres import CHANNEL

            connection.execute(select(func.pg_notify(CHANNEL, verb)))

    def arguments(self) -> dict[str, Any]:
        """Keyword arguments for a direct connection of the driver."""
        _, arguments = self._engine.dialect.create_connect_args(self.url)
        return dict(arguments) | {"tcp_user_timeout": int(1000 * self.timeout_s)}

    def reason(self, err: BaseException) -> str:
        """An error as one short line without the password."""
        text = str(getattr(err, "orig", None) or err).strip() or type(err).__name__
        line = text.splitlines()[0][:200]
        password = self.url.password
        return line.replace(str(password), "***") if password else line

    def close(self) -> None:
        """Close every connection; later calls raise :class:`StoreUnavailable`."""
        self.closed = True
        self._engine.dispose()

    def _make_engine(self) -> Engine:
        if self.sqlite:
            return _file_engine(self.url, self.timeout_s, self._connections)
        from service.store.postgres import make_engine

        return make_engine(self.url, timeout_s=self.timeout_s, connections=self._connections)

    def _write_ahead(self) -> None:
        """Turn on SQLite's write-ahead log; retries, as SQLite fails while another process does the same."""
        deadline_s = time.monotonic() + self.timeout_s
        while True:
            try:
                connection = sqlite3.connect(str(self.url.database), timeout=self.timeout_s)
                try:
                    connection.execute("PRAGMA journal_mode = WAL")
                finally:
                    connection.close()
                return
            except sqlite3.Error as err:
                if "locked" not in str(err) or time.monotonic() > deadline_s:
                    raise StoreUnavailable(self.reason(err)) from err
                time.sleep(0.01)


def _url(address: str) -> URL:
    scheme = address.partition(":")[0]
    kind = scheme.partition("+")[0]
    if kind not in ("sqlite", "postgresql", "postgres"):
        raise BadAddress(f"a database is 'sqlite:////absolute/file.db' or 'postgresql://…', not '{scheme:.40}:…'")
    try:
        url = make_url(address)
    except (exc.ArgumentError, ValueError):
        raise BadAddress(f"the database's address '{scheme}:…' cannot be read") from None  # may hold a password
    if kind != "sqlite":
        return url.set(drivername="postgresql+psycopg")
    if not url.database or not Path(url.database).is_absolute():
        raise BadAddress("SQLite needs an absolute file: 'sqlite:////absolute/file.db'")
    return url.set(drivername="sqlite+pysqlite")


def _file_engine(url: URL, timeout_s: float, connections: int) -> Engine:
    engine = create_engine(
        url,
        pool_size=connections,
        max_overflow=0,
        pool_timeout=timeout_s,
        hide_parameters=True,
        connect_args={"timeout": timeout_s},
    )

    @event.listens_for(engine, "connect")
    def _tune(connection: sqlite3.Connection, record: object) -> None:
        connection.isolation_level = None  # transactions begin below, not in the driver
        connection.execute("PRAGMA foreign_keys = ON")
        connection.execute("PRAGMA synchronous = FULL")

    @event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get("adverb_writes")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine
