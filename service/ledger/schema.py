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
    # Recordings and envelopes: what a simulator's loop has met. Of each block only its key and a
    # digest are kept, so that one sent twice counts once.
    """
    CREATE TABLE gatherings (
        component TEXT NOT NULL,
        kind TEXT NOT NULL CHECK (kind IN ('recording', 'envelope')),
        revision INTEGER NOT NULL,
        offered INTEGER NOT NULL,
        merged INTEGER NOT NULL,
        thinned INTEGER NOT NULL,
        outside INTEGER NOT NULL,
        reach REAL NOT NULL,
        within REAL NOT NULL,
        reach_outside REAL NOT NULL,
        within_outside REAL NOT NULL,
        scale BLOB CHECK (length(scale) = 48),
        PRIMARY KEY (component, kind)
    );
    CREATE TABLE recorded (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) = 48),
        UNIQUE (component, wrench)
    );
    CREATE TABLE extremes (
        component TEXT NOT NULL,
        place INTEGER NOT NULL CHECK (place BETWEEN 0 AND 11),
        wrench BLOB NOT NULL CHECK (length(wrench) = 48),
        PRIMARY KEY (component, place)
    );
    CREATE TABLE blocks (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        kind TEXT NOT NULL,
        client TEXT NOT NULL,
        sequence INTEGER NOT NULL,
        digest BLOB NOT NULL,
        UNIQUE (component, kind, client, sequence)
    );
    """,
    # An attempt's record: which engine runs it, under which task, since when a solver is at it. Its
    # owner's heartbeat stands once an owner, not once an attempt: a beat is one small write then,
    # however many attempts run. What ran before was on the engine there was.
    """
    ALTER TABLE jobs ADD COLUMN engine TEXT;
    ALTER TABLE jobs ADD COLUMN task TEXT;
    ALTER TABLE jobs ADD COLUMN began REAL;
    UPDATE jobs SET engine = 'local', task = id || '-' || attempt WHERE attempt > 0;
    UPDATE jobs SET began = started WHERE status = 'running';
    CREATE INDEX jobs_of_owner ON jobs (owner) WHERE owner IS NOT NULL;
    CREATE TABLE leases (
        owner TEXT PRIMARY KEY,
        engine TEXT NOT NULL,
        beat INTEGER NOT NULL,
        at REAL NOT NULL
    );
    """,
    # Jobs are listed by component, or by status, newest first, a page at a time.
    """
    CREATE INDEX IF NOT EXISTS jobs_listed_by_component ON jobs (component);
    CREATE INDEX IF NOT EXISTS jobs_listed_by_status ON jobs (status);
    """,
    # Imports: who loaded which rows from what, as ranges of their numbers. Rows of a range that is
    # hidden are there for nobody: an import is taken in piece by piece and shown at once.
    """
    CREATE TABLE imports (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        created REAL NOT NULL,
        who TEXT NOT NULL,
        filename TEXT NOT NULL,
        format TEXT NOT NULL,
        digest TEXT NOT NULL,
        note TEXT NOT NULL,
        rows INTEGER NOT NULL
    );
    CREATE INDEX imports_of_component ON imports (component, id);
    CREATE TABLE import_parts (
        first INTEGER PRIMARY KEY,
        last INTEGER NOT NULL,
        import INTEGER NOT NULL REFERENCES imports (id),
        component TEXT NOT NULL,
        hidden INTEGER NOT NULL CHECK (hidden IN (0, 1))
    );
    CREATE INDEX hidden_parts ON import_parts (first) WHERE hidden = 1;
    """,
    # Rows of another setup than a component's own are counted with each version of its table,
    # without a look at every row. Measured rows, which have no setup, are not in it.
    """
    CREATE INDEX rows_of_setup ON rows (component, fingerprint) WHERE fingerprint <> '';
    """,
    # The rig whose readings an import has: the TOML of its frame and reference points.
    "ALTER TABLE imports ADD COLUMN rig TEXT NOT NULL DEFAULT ''",
    # Probable systematic errors of an import's rows, as JSON, each with the keys of its rows.
    "ALTER TABLE imports ADD COLUMN findings TEXT NOT NULL DEFAULT '[]'",
    # Wrenches and displacements of several interfaces and further inputs are longer. A CHECK is
    # text of the schema alone, changed as sqlite.org/lang_altertable.html, section 7, has it.
    """
    PRAGMA writable_schema = ON;
    UPDATE sqlite_schema SET sql = replace(replace(replace(replace(replace(sql,
        'length(wrench) = 48', 'length(wrench) >= 48 AND length(wrench) % 8 = 0'),
        'length(displacement) = 48', 'length(displacement) >= 48'),
        'length(uncertainty) = 48', 'length(uncertainty) = length(displacement)'),
        'length(compliance) = 288',
        'length(compliance) * 8 = length(displacement) * length(wrench)'),
        'length(scale) = 48', 'length(scale) >= 48')
        WHERE type = 'table' AND name IN ('jobs', 'rows', 'gatherings', 'recorded', 'extremes');
    UPDATE sqlite_schema SET sql = replace(sql, 'place BETWEEN 0 AND 11', 'place >= 0')
        WHERE name = 'extremes';
    PRAGMA writable_schema = RESET
    """,
    # Third derivatives of solved rows, k (k + 1) (k + 2) / 6 of k inputs; rows before have none.
    """
    ALTER TABLE rows ADD COLUMN curvature BLOB CHECK (length(curvature) * 6
        = length(wrench) * (length(wrench) / 8 + 1) * (length(wrench) / 8 + 2))
    """,
)
