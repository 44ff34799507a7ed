-- The ledger of version 0.3's rows under the schema 13, of a development version.
BEGIN TRANSACTION;
CREATE TABLE blocks (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        kind TEXT NOT NULL,
        client TEXT NOT NULL,
        sequence INTEGER NOT NULL,
        digest BLOB NOT NULL,
        UNIQUE (component, kind, client, sequence)
    );
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
CREATE TABLE edits (
        seq INTEGER PRIMARY KEY,
        component TEXT NOT NULL,
        row INTEGER NOT NULL REFERENCES rows (seq),
        withdrawn INTEGER NOT NULL CHECK (withdrawn IN (0, 1)),
        created REAL NOT NULL
    );
INSERT INTO "edits" VALUES(7,'rig',6,1,1700000100.0);
CREATE TABLE extremes (
        component TEXT NOT NULL,
        place INTEGER NOT NULL CHECK (place >= 0),
        wrench BLOB NOT NULL CHECK (length(wrench) >= 48 AND length(wrench) % 8 = 0),
        PRIMARY KEY (component, place)
    );
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
CREATE TABLE import_parts (
        first INTEGER PRIMARY KEY,
        last INTEGER NOT NULL,
        import INTEGER NOT NULL REFERENCES imports (id),
        component TEXT NOT NULL,
        hidden INTEGER NOT NULL CHECK (hidden IN (0, 1))
    );
INSERT INTO "import_parts" VALUES(1,6,1,'rig',0);
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
        rig TEXT NOT NULL DEFAULT '',
        findings TEXT NOT NULL DEFAULT '[]'
    );
INSERT INTO "imports" VALUES(1,'rig',1700000000.0,'me','t.csv','csv','00','a note',6,'','[{"cause":"sign","keys":["a7b8a4f9d02e35771d52eadacc227d52"]}]');
CREATE TABLE jobs (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) >= 48 AND length(wrench) % 8 = 0),
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
        not_before REAL,
        asked_by TEXT NOT NULL DEFAULT '',
        engine TEXT,
        task TEXT,
        began REAL,
        UNIQUE (component, fingerprint, wrench)
    );
INSERT INTO "jobs" VALUES(1,'rig','f',X'000000000000224000000000000000000000000000000000000000000000000000000000000000000000000000000000','waiting',0,0,0,NULL,1700000000.0,NULL,NULL,NULL,NULL,NULL,'',NULL,NULL,NULL);
CREATE TABLE leases (
        owner TEXT PRIMARY KEY,
        engine TEXT NOT NULL,
        beat INTEGER NOT NULL,
        at REAL NOT NULL
    );
CREATE TABLE recorded (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) >= 48 AND length(wrench) % 8 = 0),
        UNIQUE (component, wrench)
    );
CREATE TABLE rows (
        seq INTEGER PRIMARY KEY AUTOINCREMENT,
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        source TEXT NOT NULL,
        wrench BLOB NOT NULL CHECK (length(wrench) >= 48 AND length(wrench) % 8 = 0),
        displacement BLOB NOT NULL CHECK (length(displacement) >= 48),
        compliance BLOB
            CHECK (length(compliance) * 8 = length(displacement) * length(wrench)),
        uncertainty BLOB CHECK (length(uncertainty) = length(displacement)),
        job INTEGER REFERENCES jobs (id),
        created REAL NOT NULL,
        origin TEXT NOT NULL,
        key BLOB NOT NULL UNIQUE,
        seal BLOB NOT NULL,
        curvature BLOB CHECK (length(curvature) * 6
        = length(wrench) * (length(wrench) / 8 + 1) * (length(wrench) / 8 + 2))
    );
INSERT INTO "rows" VALUES(1,'rig','','measured',X'000000000000F03F00000000000000000000000000000000000000000000000000000000000000000000000000000000',X'8DEDB5A0F7C6B03E000000000000000000000000000000000000000000000000000000000000000048AFBC9AF2D77A3E',NULL,NULL,NULL,1700000000.0,'t.csv:1',X'A7B8A4F9D02E35771D52EADACC227D52',X'056E25AB1EB168A92DA16B58D954B853',NULL);
INSERT INTO "rows" VALUES(2,'rig','','measured',X'000000000000004000000000000000000000000000000000000000000000000000000000000000000000000000000000',X'8DEDB5A0F7C6C03E000000000000000000000000000000000000000000000000000000000000000048AFBC9AF2D77A3E',NULL,NULL,NULL,1700000000.0,'t.csv:2',X'2C75A71EA165BE168D5D4E20791B15D1',X'B439CBD228490BA4F252EC0D17950F91',NULL);
INSERT INTO "rows" VALUES(3,'rig','','measured',X'00000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000F03F',X'54E41071732AC93E000000000000000000000000000000000000000000000000000000000000000048AFBC9AF2D77A3E',NULL,NULL,NULL,1700000000.0,'t.csv:3',X'240AB02EA3414AC9CD5D8C8175F356AF',X'7F124126600F4EADED17F866978799A5',NULL);
INSERT INTO "rows" VALUES(4,'rig','','measured',X'000000000000F03F0000000000000000000000000000000000000000000000000000000000000000000000000000F03F',X'8DEDB5A0F7C6D03E000000000000000000000000000000000000000000000000000000000000000048AFBC9AF2D77A3E',NULL,NULL,NULL,1700000000.0,'t.csv:4',X'F9BF37FE01816847B1E7A544B73D0BD7',X'4A05BC020CB693FCFB2A825D94E34FCD',NULL);
INSERT INTO "rows" VALUES(5,'rig','','measured',X'00000000000000400000000000000000000000000000000000000000000000000000000000000000000000000000F03F',X'F068E388B5F8D43E000000000000000000000000000000000000000000000000000000000000000048AFBC9AF2D77A3E',NULL,NULL,NULL,1700000000.0,'t.csv:5',X'8322848DB75FDADD8D6AD6DCF47E912B',X'71836556C86C6555610E0AADA19CC8B5',NULL);
INSERT INTO "rows" VALUES(6,'rig','','measured',X'000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000000040',X'54E41071732AD93E000000000000000000000000000000000000000000000000000000000000000048AFBC9AF2D77A3E',NULL,NULL,NULL,1700000000.0,'t.csv:6',X'68CEB1060CF151652EC983A71AE1FA1B',X'4AC9FB6FA4A24E424BCDE48F88D257AF',NULL);
CREATE TABLE solver_errors (
        component TEXT NOT NULL,
        fingerprint TEXT NOT NULL,
        estimate TEXT NOT NULL,
        PRIMARY KEY (component, fingerprint)
    );
CREATE INDEX jobs_in_order ON jobs (status, priority DESC, id);
CREATE INDEX jobs_of_component ON jobs (component, status);
CREATE INDEX jobs_of_owner ON jobs (owner) WHERE owner IS NOT NULL;
CREATE INDEX jobs_listed_by_component ON jobs (component);
CREATE INDEX jobs_listed_by_status ON jobs (status);
CREATE INDEX rows_of_component ON rows (component, seq);
CREATE INDEX rows_of_setup ON rows (component, fingerprint) WHERE fingerprint <> '';
CREATE INDEX edits_of_component ON edits (component, seq);
CREATE INDEX edits_of_row ON edits (row, seq);
CREATE INDEX imports_of_component ON imports (component, id);
CREATE INDEX hidden_parts ON import_parts (first) WHERE hidden = 1;
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('rows',7);
INSERT INTO "sqlite_sequence" VALUES('imports',1);
INSERT INTO "sqlite_sequence" VALUES('jobs',1);
COMMIT;
PRAGMA application_id = 2003988067;
PRAGMA user_version = 13;
