"""The SQL of the ledger's tables, as it grew."""

APPLICATION_ID = 0x77726E63  # "wrnc": tells a ledger from other programs' SQLite files

# One script a schema version; a file of version n has the first n of them.
SCRIPTS = (
    """
    CREATE TABLE jobs (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) = 48),
        status TEXT NOT NULL
            CHECK (status IN ('waiting', 'running', 'done', 'failed', 'cancelled')),
        priority INTEGER NOT NULL,
        attempt INTEGER NOT NULL,
        lost INTEGER NOT NULL,
        owner TEXT CHECK ((owner IS NOT NULL) = (status = 'running')),
        created REAL NOT NULL,
        started REAL,
        finished REAL,
        error TEXT CHECK ((error IS NOT NULL) = (status = 'failed')),
        row INTEGER UNIQUE REFERENCES rows (seq)
            CHECK ((row IS NOT NULL) = (status = 'done')),
        UNIQUE (component, fingerprint, wrench)
    );
    CREATE INDEX jobs_in_order ON jobs (status, priority DESC, id);
    CREATE INDEX jobs_of_component ON jobs (component, status);
    CREATE TABLE rows (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        source TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) = 48),
        displacement BLOB NOT NULL CHECK (length(displacement) = 48),
        compliance BLOB CHECK (length(compliance) = 288),
        uncertainty BLOB CHECK (length(uncertainty) = 48),
        job INTEGER UNIQUE REFERENCES jobs (id),
        created REAL NOT NULL,
        origin TEXT NOT NULL,
        key BLOB NOT NULL UNIQUE
    );
    CREATE INDEX rows_of_component ON rows (component, seq);
    """,
    # Jobs wait after a death. Rows carry a seal over all of them, can be withdrawn, and one job
    # may give a second row when its first one is withdrawn.
    """
    ALTER TABLE jobs ADD COLUMN not_before REAL;
    CREATE TABLE sealed (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        source TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) = 48),
        displacement BLOB NOT NULL CHECK (length(displacement) = 48),
        compliance BLOB CHECK (length(compliance) = 288),
        uncertainty BLOB CHECK (length(uncertainty) = 48),
        job INTEGER REFERENCES jobs (id),
        created REAL NOT NULL,
        origin TEXT NOT NULL,
        key BLOB NOT NULL UNIQUE,
        seal BLOB NOT NULL
    );
    INSERT INTO sealed SELECT *, seal(key, compliance, origin) FROM rows;
    DROP TABLE rows;
    ALTER TABLE sealed RENAME TO rows;
    CREATE INDEX rows_of_component ON rows (component, seq);
    CREATE TABLE edits (
        seq INTEGER PRIMARY KEY,
        component TEXT NOT NULL,
        row INTEGER NOT NULL REFERENCES rows (seq),
        withdrawn INTEGER NOT NULL CHECK (withdrawn IN (0, 1)),
        created REAL NOT NULL
    );
    CREATE INDEX edits_of_component ON edits (component, seq);
    CREATE INDEX edits_of_row ON edits (row, seq);
    """,
    # Where a job comes from: those of queries are limited in number.
    "ALTER TABLE jobs ADD COLUMN asked_by TEXT NOT NULL DEFAULT ''",
)
