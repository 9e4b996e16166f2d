"""Changes of the tables' layout, made in place when a database is opened; the same SQL on SQLite and PostgreSQL."""

from __future__ import annotations

import json

from sqlalchemy import Connection, text

__all__ = ["LAYOUT", "upgrade"]

LAYOUT = 4
"""Layout of the tables that this code reads and writes. A database with a newer one is refused."""

_RENAMED_IN_2 = (
    ("adverb_versions", "who", "author"),
    ("adverb_versions", "why", "reason"),
    ("adverb_events", "who", "author"),
    ("adverb_events", "why", "reason"),
    ("adverb_jobs", "asked", "request"),
)
"""Table, old and new name of each column that layout 2 renames."""


def upgrade(connection: Connection, layout: int) -> None:
    """Bring tables of an older layout to :data:`LAYOUT`, in the caller's transaction and under its lock."""
    if layout < 2:
        _to_layout_2(connection)
    if layout < 3:  # the table of drafts is new, and is made with all missing ones, as is that of keys in layout 4
        connection.execute(text("ALTER TABLE adverb_versions ADD COLUMN source_sha256 VARCHAR(64)"))
    connection.execute(text("UPDATE adverb_layout SET number = :number"), {"number": LAYOUT})


def _to_layout_2(connection: Connection) -> None:
    """Rename columns, and the key ``who`` of each job's request."""
    for table, old, new in _RENAMED_IN_2:
        connection.execute(text(f"ALTER TABLE {table} RENAME COLUMN {old} TO {new}"))
    for id, request in connection.execute(text("SELECT id, request FROM adverb_jobs")).all():
        renamed = {"author" if name == "who" else name: value for name, value in json.loads(request).items()}
        values = {"id": id, "request": json.dumps(renamed, separators=(",", ":"))}
        connection.execute(text("UPDATE adverb_jobs SET request = :request WHERE id = :id"), values)
