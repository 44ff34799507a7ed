"""The SQL of the ledger's tables, and the steps from the schemas of released versions."""

APPLICATION_ID = 0x77726E63  # "wrnc": distinguishes a ledger from other programs' SQLite files
VERSION = 17  # version of TABLES; each change raises it and adds a step from the previous version

# `wrench`, `displacement` and similar columns are float64, little-endian, of any number of loads
# and outputs; see packing.py.
_WRENCH = "wrench BLOB NOT NULL CHECK (length(wrench) >= 48 AND length(wrench) % 8 = 0)"
_CURVATURE = """curvature BLOB CHECK (length(curvature) * 6
        = length(wrench) * (length(wrench) / 8 + 1) * (length(wrench) / 8 + 2))"""  # until 13
_RIG = "rig TEXT NOT NULL DEFAULT ''"
_FINDINGS = "findings TEXT NOT NULL DEFAULT '[]'"
# Whether the row was edited by itself, and not as one of an import.
_SINGLE = "single INTEGER NOT NULL DEFAULT 0 CHECK (single IN (0, 1))"

# Notes on components and archived ones; JSON of the queries that no table covered, and of the error
# of the solver of a setup.
_STATE = """
    CREATE TABLE catalogue (
        component TEXT PRIMARY KEY,
        notes TEXT NOT NULL,
        archived INTEGER NOT NULL CHECK (archived IN (0, 1)),
        renamed_to TEXT,
        copied_from TEXT
    );
    CREATE TABLE demand (
        component TEXT PRIMARY KEY,
        counts TEXT NOT NULL
    );
    CREATE TABLE solver_errors (
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        estimate TEXT NOT NULL,
        PRIMARY KEY (component, fingerprint)
    );
"""

# Profiles of test rigs: TOML texts by name.
_RIGS = """
    CREATE TABLE rigs (name TEXT PRIMARY KEY, profile TEXT NOT NULL);
"""

# Writes and their actors. REPLACE fires no trigger of DELETE, so a trigger of INSERT refuses it.
_ACTOR = "actor TEXT NOT NULL DEFAULT ''"
_TURNS = """
    -- Waiting jobs start by priority and id of each actor in turn: the one whose last start is the
    -- longest ago is the next.
    CREATE INDEX jobs_in_turn ON jobs (status, actor, priority DESC, id);
    CREATE INDEX jobs_of_actor ON jobs (actor, started);
"""
_REFUSED = "BEGIN SELECT RAISE(ABORT, 'entries of the audit are never changed'); END"
_AUDIT = f"""
    CREATE TABLE audit (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        time REAL NOT NULL,
        actor TEXT NOT NULL,
        action TEXT NOT NULL,
        component TEXT NOT NULL,
        object TEXT NOT NULL,
        before TEXT,
        after TEXT
    );
    CREATE INDEX audit_of_component ON audit (component, id);
    CREATE INDEX audit_of_actor ON audit (actor, id);
    CREATE INDEX audit_by_time ON audit (time);
    CREATE TRIGGER audit_kept BEFORE UPDATE ON audit {_REFUSED};
    CREATE TRIGGER audit_complete BEFORE DELETE ON audit {_REFUSED};
    CREATE TRIGGER audit_not_replaced BEFORE INSERT ON audit
        WHEN EXISTS (SELECT 1 FROM audit WHERE id = new.id) {_REFUSED};
"""

# A record has consecutive rows, from `seq`, of one setup, source and note: the bytes of their
# numbers and keys, one after the other. The key leaves out columns that a table file may lack; the
# seal covers the complete record.
_ROWS = """
    CREATE TABLE {name} (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        count INTEGER NOT NULL CHECK (count >= 1),
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        source TEXT NOT NULL,
        wrench BLOB NOT NULL
            CHECK (length(wrench) >= 48 * count AND length(wrench) % (8 * count) = 0),
        displacement BLOB NOT NULL CHECK (length(displacement) >= 48 * count),
        compliance BLOB
            CHECK (length(compliance) * 8 * count = length(displacement) * length(wrench)),
        curvature BLOB CHECK (length(curvature) * 6 = length(wrench)
            * (length(wrench) / count / 8 + 1) * (length(wrench) / count / 8 + 2)),
        uncertainty BLOB CHECK (length(uncertainty) = length(displacement)),
        job INTEGER REFERENCES jobs (id),
        created REAL NOT NULL,
        origin TEXT NOT NULL,
        key BLOB NOT NULL CHECK (length(key) = 16 * count),
        seal BLOB NOT NULL
    );
"""
# The first 8 bytes of the key of each row. Different keys may share them: `rows` decides.
_KEYS = """
    CREATE TABLE row_keys (hash INTEGER, seq INTEGER, PRIMARY KEY (hash, seq)) WITHOUT ROWID;
"""
_INDICES = """
    CREATE INDEX rows_of_component ON rows (component, seq, count);
    -- Rows of another setup than a component's are counted with each version of its table.
    CREATE INDEX rows_of_setup ON rows (component, fingerprint) WHERE fingerprint <> '';
"""
_COPIED = (
    "seq, component, fingerprint, source, wrench, displacement, compliance, curvature,"
    " uncertainty, job, created, origin, key, seal"
)

TABLES = f"""
    CREATE TABLE jobs (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        {_WRENCH},
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
        row INTEGER UNIQUE
            CHECK ((row IS NOT NULL) = (status = 'done')),
        not_before REAL,
        asked_by TEXT NOT NULL DEFAULT '',
        engine TEXT,
        task TEXT,
        began REAL,
        {_ACTOR},
        UNIQUE (component, fingerprint, wrench)
    );
    {_TURNS}
    CREATE INDEX jobs_of_component ON jobs (component, status);
    CREATE INDEX jobs_of_owner ON jobs (owner) WHERE owner IS NOT NULL;
    -- Jobs are listed by component, or by status, newest first, a page at a time.
    CREATE INDEX jobs_listed_by_component ON jobs (component);
    CREATE INDEX jobs_listed_by_status ON jobs (status);

    -- The heartbeat of each owner of running jobs: one small write, however many attempts run.
    CREATE TABLE leases (
        owner TEXT PRIMARY KEY,
        engine TEXT NOT NULL,
        beat INTEGER NOT NULL,
        at REAL NOT NULL
    );

    {_ROWS.format(name="rows")}
    {_INDICES}
    {_KEYS}
    CREATE TABLE edits (
        seq INTEGER PRIMARY KEY,
        component TEXT NOT NULL,
        row INTEGER NOT NULL,
        withdrawn INTEGER NOT NULL CHECK (withdrawn IN (0, 1)),
        created REAL NOT NULL,
        {_SINGLE}
    );
    CREATE INDEX edits_of_component ON edits (component, seq);
    CREATE INDEX edits_of_row ON edits (row, seq);

    -- Imports: ranges of numbers of rows. No reader sees the rows of a hidden range: an import is
    -- written piece by piece and published at once. `rig` is TOML, `findings` JSON with the keys of
    -- the rows of each probable systematic error.
    CREATE TABLE imports (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        created REAL NOT NULL,
        who TEXT NOT NULL,
        filename TEXT NOT NULL,
        format TEXT NOT NULL,
        digest TEXT NOT NULL,
        note TEXT NOT NULL,
        rows INTEGER NOT NULL,
        {_RIG},
        {_FINDINGS}
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

    -- Recordings and envelopes: the wrenches that a simulator's loop has met. Of each block only
    -- its key and a digest are kept, so that one sent twice counts once.
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
        scale BLOB CHECK (length(scale) >= 48),
        PRIMARY KEY (component, kind)
    );
    CREATE TABLE recorded (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        {_WRENCH},
        UNIQUE (component, wrench)
    );
    CREATE TABLE extremes (
        component TEXT NOT NULL,
        place INTEGER NOT NULL CHECK (place >= 0),
        {_WRENCH},
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
    {_STATE}
    {_RIGS}
    {_AUDIT}
"""

# By the schema version of a file: the version after the script, and the script. 8 is that of
# release 0.2, 12 that of 0.3. A CHECK is text of the schema alone, changed as in
# sqlite.org/lang_altertable.html, section 7: wrenches and displacements had six numbers.
STEPS = {
    8: (
        12,
        f"""
        ALTER TABLE imports ADD COLUMN {_RIG};
        ALTER TABLE imports ADD COLUMN {_FINDINGS};
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
        PRAGMA writable_schema = RESET;
        ALTER TABLE rows ADD COLUMN {_CURVATURE}
        """,
    ),
    12: (13, _STATE),
    # A record of `rows` was one row, with a unique key; jobs and edits referred to it.
    13: (
        14,
        f"""
        PRAGMA writable_schema = ON;
        UPDATE sqlite_schema SET sql = replace(sql, ' REFERENCES rows (seq)', '')
            WHERE type = 'table' AND name IN ('jobs', 'edits');
        PRAGMA writable_schema = RESET;
        {_KEYS}
        INSERT INTO row_keys SELECT key_hash(key), seq FROM rows ORDER BY 1;
        {_ROWS.format(name="new_rows")}
        INSERT INTO new_rows (count, {_COPIED}) SELECT 1, {_COPIED} FROM rows;
        DELETE FROM sqlite_sequence WHERE name = 'new_rows';
        INSERT INTO sqlite_sequence SELECT 'new_rows', seq FROM sqlite_sequence
            WHERE name = 'rows';
        DROP TABLE rows;
        ALTER TABLE new_rows RENAME TO rows;
        {_INDICES}
        """,
    ),
    14: (15, _RIGS),
    15: (
        16,
        f"""
        ALTER TABLE jobs ADD COLUMN {_ACTOR};
        DROP INDEX jobs_in_order;
        {_TURNS}
        {_AUDIT}
        """,
    ),
    16: (17, f"ALTER TABLE edits ADD COLUMN {_SINGLE}"),
}
