"""Actors: each write has its entry in the audit; keys and users reach what they may; fair turns."""

import itertools
import sqlite3
import time

import pytest
from starlette.testclient import TestClient

from tests.service.expired import add_expired_key
from tests.service.ledger_rows import claim
from tests.service.test_access import CALLS, TABLE_ONLY, bearer
from wrenchbook.service.actors import ANY, CALLER, Caller, NotPermittedError, acting_as
from wrenchbook.service.http.access import SecuritySettings
from wrenchbook.service.http.app import create_app
from wrenchbook.service.http.proxy import proxy_trust
from wrenchbook.service.keys import Keyring, KeysError
from wrenchbook.service.ledger import Ledger, Quota, QuotaError, noted
from wrenchbook.service.settings import Settings, SettingsError
from wrenchbook.service.workers.builder import note_settings

# Calls of the whole server, and those that answer about the components of the caller alone. One
# that is in neither list, and of no component, fails the matrix below.
OF_SERVER = {"/metrics", "/v1/audit", "/v1/keys", "/v1/keys/{name}", "/v1/keys/{name}/rotate"}
OF_SERVER_BUT_READ = {"/v1/rigs", "/v1/rigs/{name}"}
LIMITED = {"/health/ready", "/v1/components", "/v1/jobs", "/v1/scenes/plan", "/v1/events"}
JOB = "/v1/jobs/{job_id}"
ROWS = {"rows": [{"wrench": [1, 0, 0, 0, 0, 0], "displacement": [1e-6] * 6}]}
PROXY = {"trust_proxy_user": "X-Forwarded-User", "trust_proxy_from": "10.0.0.5, 10.1.0.0/16"}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("actors")


@pytest.fixture(scope="module")
def keys(place):
    keyring = Keyring(place)
    keys = {
        scope: keyring.add(f"{scope}er", scope, components=("bar", "ri?_*"))
        for scope in ("read", "write", "admin")
    }
    keys["all"] = keyring.add("root", "admin")
    keys["bob"] = keyring.add("bob", "write")
    keys["over"] = add_expired_key(place, "over", "admin")
    return keys


@pytest.fixture(scope="module")
def http(place, keys):
    settings = Settings(place, solvers=0, actor_jobs=3, **PROXY, trust_proxy_groups="X-Groups")
    settings = Settings(**{**vars(settings), "trust_proxy_scopes": "lab=write,ops=admin,*=read"})
    security = SecuritySettings(proxy=proxy_trust(settings))
    with TestClient(create_app(settings, security), raise_server_exceptions=False) as client:
        client.headers["content-type"] = "application/json"
        yield client


@pytest.fixture
def ledger(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    yield ledger
    ledger.close()


def entries(http, keys, **query):
    reply = http.get("/v1/audit", params=query, headers=bearer(keys["all"]))
    return [(entry["actor"], entry["action"], entry["object"]) for entry in reply.json()["entries"]]


@pytest.mark.parametrize(("method", "path"), CALLS)
def test_each_call_has_a_rule_for_each_key_component_and_address(http, keys, method, path):
    for name, scope in itertools.product(("bar", "plate"), ("read", "write", "admin")):
        url = path.replace("{name}", name).replace("{job_id}", "999999").replace("{row}", "1")
        url = url.replace("{number}", "1")
        if path == "/v1/events":  # a stream of a component that exists would not end
            url += "?component=none"
        reply = http.request(method, url, content=b"{", headers=bearer(keys[scope]))
        kind = reply.json().get("type", "") if reply.status_code == 403 else ""
        if path.startswith("/v1/components/{name}"):
            expected = name != "bar"
        elif path in OF_SERVER or (path in OF_SERVER_BUT_READ and method != "GET"):
            expected = True
        else:
            named = path in LIMITED | OF_SERVER_BUT_READ or path.startswith((JOB, "/umbridge/"))
            assert named, f"{path} has no rule for keys of some components"
            expected = False
        refused = kind.endswith((":components", ":scope"))
        assert refused >= expected, reply.text
        if scope == "admin":
            assert refused == expected, reply.text
    url = path.replace("{name}", "bar").replace("{job_id}", "1").replace("{row}", "1")
    assert http.request(method, url, headers=bearer(keys["over"])).status_code == 401
    unknown = {"X-Forwarded-User": "ann", "X-Groups": "ops"}  # of an address that is not trusted
    assert http.request(method, url, headers=unknown).status_code == 401


def test_a_key_of_some_components_sees_no_other(http, keys, place):
    key, other = bearer(keys["admin"]), bearer(keys["bob"])
    job = http.post("/v1/components/plate/solve", json={"force": [0, 0, 1]}, headers=other).json()
    path = f"/v1/jobs/{job['job']['id']}"
    assert http.get(path, headers=other).json()["actor"] == "bob"
    for text in (path, path.replace("/jobs/", "/jobs/+"), f"{path}/log", f"{path}/files"):
        assert http.get(text, headers=key).status_code in (404, 422)
    assert http.delete(path, headers=key).status_code == 404
    refusals = [http.get(text, headers=key).json() for text in (path, "/v1/jobs/99999")]
    assert refusals[0] == refusals[1]  # not whether there is such a job
    assert http.delete("/v1/jobs", headers=key).status_code == 200
    assert http.get(path, headers=other).json()["status"] == "waiting"
    assert {item["component"] for item in http.get("/v1/jobs", headers=key).json()["jobs"]} <= {
        "bar"
    }
    names = http.get("/v1/components", headers=key).json()["components"]
    assert [name["name"] for name in names] == ["bar"]
    assert http.get("/umbridge/Info", headers=key).json()["models"] == ["bar"]
    assert set(http.get("/health/ready", headers=key).json()["tables"]) == {"bar"}
    scene = {"components": {"plate": {"force": [[0, 1]] * 3, "moment": [[0, 1]] * 3}}}
    assert http.post("/v1/scenes/plan", json=scene, headers=key).status_code == 404
    assert http.get("/v1/events?component=plate", headers=key).status_code == 404
    root = bearer(keys["all"])
    http.post("/v1/components/plate/copy", json={"name": "rig_2"}, headers=root)
    for caller, origin in ((root, "plate"), (key, None)):
        copy = http.get("/v1/components/rig_2", headers=caller).json()
        assert copy["copied_from"] == origin
    for new in ({"name": "spare"}, {"name": "rig"}):
        assert http.post("/v1/components/bar/copy", json=new, headers=key).status_code == 403
    created = http.post("/v1/components", json={**TABLE_ONLY, "name": "other"}, headers=key)
    assert created.status_code == 403
    assert not (place / "components" / "other").exists()
    http.delete(path, headers=other)


def test_each_write_has_one_entry_of_its_actor(http, keys):
    bob, root, part = bearer(keys["bob"]), bearer(keys["all"]), "/v1/components/rig"
    assert http.post("/v1/components", json=TABLE_ONLY, headers=bob).status_code == 201
    loaded = http.post(f"{part}/table?wait_s=0", json=ROWS, headers=bob).json()
    assert loaded["inserted"] == 1, loaded
    row = loaded["table_version"]
    job = http.post("/v1/components/bar/solve", json={"force": [0, 0, 7]}, headers=bob).json()
    job = job["job"]["id"]
    calls = [
        ("DELETE", f"{part}/table/{row}", None, "row.withdraw", row),
        ("POST", f"{part}/table/{row}/restore", None, "row.restore", row),
        ("DELETE", f"{part}/imports/{loaded['import']}", None, "import.withdraw", 1),
        ("POST", f"{part}/imports/{loaded['import']}/restore", None, "import.restore", 1),
        ("PUT", f"{part}/notes", {"text": "seen"}, "component.edit", "rig"),
        ("DELETE", f"{part}/demand", None, "demand.forget", "rig"),
        ("DELETE", f"/v1/jobs/{job}", None, "job.cancel", job),
        ("POST", f"/v1/jobs/{job}/retry", None, "job.retry", job),
        ("DELETE", f"/v1/jobs/{job}", None, "job.cancel", job),
    ]
    written = [("bob", "component.add", "rig"), ("bob", "import.load", str(loaded["import"]))]
    written.append(("bob", "job.accept", str(job)))
    for method, path, body, action, subject in calls:
        reply = http.request(method, path, json=body, headers=bob)
        assert reply.status_code == 200, reply.text
        written.append(("bob", action, str(subject)))
    assert entries(http, keys, actor="bob", limit=len(written))[::-1] == written
    assert http.post("/v1/keys", json={"name": "tmp"}, headers=root).status_code == 201
    rotated = http.post("/v1/keys/tmp/rotate", json={}, headers=root)
    assert rotated.status_code == 201
    assert http.delete("/v1/keys/tmp", headers=root).status_code == 200
    assert [entry[:2] for entry in entries(http, keys, action="key.*")] == [
        ("root", "key.revoke"), ("root", "key.rotate"), ("root", "key.add")
    ]  # fmt: skip
    assert http.delete("/v1/keys/none", headers=root).status_code == 404
    assert len(entries(http, keys, action="key.*")) == 3
    page = http.get("/v1/audit?limit=2&component=rig", headers=root).json()
    older = http.get(page["next"], headers=root).json()["entries"]
    assert older[0]["id"] < page["entries"][-1]["id"]
    assert entries(http, keys, until="2000-01-01T00:00:00Z") == []


def test_entries_of_the_audit_are_only_added(ledger):
    with acting_as("ann"):
        ledger.accept("bar", "f", [0.0] * 6)
    for statement in (
        "UPDATE audit SET actor = 'eve'",
        "DELETE FROM audit",
        "REPLACE INTO audit SELECT id, time, 'eve', action, '', '', NULL, NULL FROM audit",
    ):
        db = sqlite3.connect(ledger.path)
        with pytest.raises(sqlite3.IntegrityError, match="never changed"):
            db.execute(statement)
        db.close()
    assert [entry.actor for entry in ledger.audit()] == ["ann"]


def test_a_job_of_an_earlier_setup_that_waits_anew_keeps_its_actor(ledger):
    with acting_as("ann"):
        other = ledger.accept("bar", "new", [0.0] * 6)[0]
        ledger.cancel(other.id)
        ledger.accept("bar", "old", [0.0] * 6)
    claimed = claim(ledger, "d")
    ledger.renew(claimed.id, claimed.attempt, "new")
    again = ledger.job(other.id)
    assert (again.status, again.actor) == ("waiting", "ann")


def test_a_write_that_fails_leaves_no_entry(ledger):
    with pytest.raises(OSError, match="full"), noted(ledger, "key.add", "ann"):
        raise OSError("full")
    assert ledger.audit() == []


def test_ten_jobs_beside_a_thousand_are_among_the_first_25(ledger):
    with acting_as("many"):
        ledger.accept_many("bar", "f", [[float(n), 0, 0, 0, 0, 0] for n in range(1000)])
    done = [claim(ledger, "d") for _ in range(3)]
    with acting_as("few"):
        few = ledger.accept_many("bar", "f", [[0, float(n), 0, 0, 0, 1] for n in range(10)])
    ahead = ledger.ahead(few[9].id, 0, time.time())
    assert sum(part.waiting for part in ahead) <= 20
    for _ in range(22):
        job = claim(ledger, "d")
        ledger.commit(job.id, job.attempt, [0.0] * 6)
        done.append(job)
    assert {job.id for job in few} <= {job.id for job in done[:25]}
    assert {entry.actor for entry in ledger.audit(action="row.solve")} == {"many", "few"}


def test_own_jobs_may_be_cancelled_and_others_by_admin_alone(ledger):
    jobs = {}
    for actor in ("ann", "bob"):
        with acting_as(actor):
            jobs[actor] = ledger.accept("bar", "f", [len(jobs), 0, 0, 0, 0, 0])[0].id
    CALLER.set(Caller("ann", ANY, admin=False))
    with pytest.raises(NotPermittedError, match="belongs to bob"):
        ledger.cancel(jobs["bob"])
    assert ledger.cancel_many(None, "waiting") == 1
    CALLER.set(Caller.unlimited("root"))
    assert ledger.cancel(jobs["bob"]).status == "cancelled"


def test_quotas_of_open_jobs_and_solver_seconds_refuse_further_jobs(ledger, http, keys):
    with acting_as("ann"):
        seconds = Quota(None, 5.0)
        ledger.accept("bar", "f", [1.0] * 6, quota=seconds)
        job = claim(ledger, "d")
        ledger.commit(job.id, 1, [0.0] * 6, seconds=6.0)
        with pytest.raises(QuotaError, match="6 s of its quota of 5") as error:
            ledger.accept("bar", "f", [2.0] * 6, quota=seconds)
        assert 0 < error.value.retry_s <= 86_400
    plate, bob = "/v1/components/plate_thin", bearer(keys["bob"])
    for force in range(5):
        reply = http.post(f"{plate}/solve", json={"force": [force, 0, 0]}, headers=bob)
    assert reply.status_code == 429
    assert int(reply.headers["retry-after"]) > 0
    assert "open jobs" in reply.json()["detail"]
    loop = {"force": [0, 0, 500], "moment": [0, 0, 0]}  # of a loop: an estimate, and no job
    reply = http.post(f"{plate}/displacement", json=loop, headers=bob).json()
    assert reply["job"] is None
    assert "quota" in reply["reason"]


def test_a_batch_beyond_the_quota_has_the_jobs_that_the_quota_allows(http, keys):
    wrenches = [[40.0 * (axis == place) for axis in range(6)] for place in range(6)]
    body = {"wrenches": wrenches, "on_thin": "queue"}
    http.post("/v1/components/plate_thin/displacements", json=body, headers=bearer(keys["bob"]))
    bobs = {"actor": "bob", "status": "waiting"}
    jobs = http.get("/v1/jobs", params=bobs, headers=bearer(keys["bob"])).json()["jobs"]
    assert len(jobs) == 3


def test_the_audit_of_settings_has_no_credentials(ledger, tmp_path):
    url = "sftp://ann:se:cr@et@nas.example/replica"
    note_settings(ledger, Settings(tmp_path, replicate=url))
    (entry,) = ledger.audit(action="settings")
    assert entry.after["replicate"] == "sftp://nas.example/replica"


def test_settings_with_a_path_are_noted_once(ledger, tmp_path):
    """A server with --backup-folder did not start."""
    for _ in range(2):
        note_settings(ledger, Settings(tmp_path, backup_folder=tmp_path))
    (entry,) = ledger.audit(action="settings")
    assert entry.after["backup_folder"] == str(tmp_path)


def test_a_user_of_a_trusted_proxy_alone_is_named(http, keys):
    user = {"X-Forwarded-User": "ann@lab.example", "X-Groups": "lab, none"}
    for address in ("10.0.0.5", "10.1.2.3", "::ffff:10.0.0.5"):
        proxy = TestClient(http.app, client=(address, 1))
        job = proxy.post("/v1/components/bar/solve", json={"force": [9, 9, 9]}, headers=user)
        assert job.status_code == 202, job.text
        refused = proxy.get("/v1/keys", headers=user)
        assert refused.status_code == 403
        assert (
            "the user 'user:ann@lab.example' has the scope write"
            in refused.json()["detail"].lower()
        )
        assert proxy.get("/v1/keys", headers={**user, "X-Groups": "ops"}).status_code == 200
        doubled = [*user.items(), ("X-Forwarded-User", "root")]
        refused = proxy.get("/v1/jobs", headers=doubled)
        assert (refused.status_code, refused.json()["title"]) == (
            400,
            "A proxy header is there twice",
        )
        assert "header x-forwarded-user more than once" in refused.json()["detail"]
        assert proxy.get("/v1/jobs", headers={"X-Forwarded-User": "a\tb"}).status_code == 403
        assert proxy.get("/v1/jobs").status_code == 401
    assert ("user:ann@lab.example", "job.accept") in [entry[:2] for entry in entries(http, keys)]
    for address in ("10.0.0.6", "127.0.0.1", "x"):
        stranger = TestClient(http.app, client=(address, 1))
        assert stranger.get("/v1/jobs", headers=user).status_code == 401
        forwarded = {**user, "X-Forwarded-For": "10.0.0.5"}
        assert stranger.get("/v1/jobs", headers=forwarded).status_code == 401


@pytest.mark.parametrize(
    "wrong",
    [
        {"trust_proxy_from": None},
        {"trust_proxy_from": "proxy"},
        {"trust_proxy_user": None},
        {"trust_proxy_user": "Cookie"},
        {"trust_proxy_scopes": "lab=root"},
    ],
)
def test_settings_of_a_proxy_that_cannot_be_are_refused(tmp_path, wrong):
    with pytest.raises(SettingsError):
        proxy_trust(Settings(tmp_path, **{**PROXY, **wrong}))


def test_a_rotated_key_has_two_secrets_until_the_old_one_ends(tmp_path):
    keyring = Keyring(tmp_path)
    old = keyring.add("ann", "write", components=("bar",))
    new = keyring.rotate("ann", 3600.0)
    assert keyring.find(old).components == keyring.find(new).components == ("bar",)
    assert keyring.find(old).expires == pytest.approx(time.time() + 3600.0, abs=60.0)
    newest = keyring.rotate("ann", 0.0)
    assert (keyring.find(old), keyring.find(new)) == (None, None)
    assert keyring.find(newest).expires is None
    for overlap, name, why in (
        (-1.0, "ann", "from 0 to 277777 hours, not"),
        (0.0, "eve", "no key .eve.; name one of: ann"),
    ):
        with pytest.raises(KeysError, match=why):
            keyring.rotate(name, overlap)
    keyring.revoke("ann")
    assert len(keyring) == 0
    with pytest.raises(KeysError, match="is in the past: now it is"):
        keyring.add("ann", "write", expires=time.time() - 1.0)


def test_the_last_use_of_a_key_is_noted_at_most_once_a_minute(http, keys, place):
    def used():
        return {key["name"]: key["last_used"] for key in Keyring(place).public()}

    http.get("/v1/jobs", headers=bearer(keys["read"]))
    first = used()["reader"]
    assert first == pytest.approx(time.time(), abs=600.0)
    http.get("/v1/jobs", headers=bearer(keys["read"]))
    assert used()["reader"] == first
    assert used()["over"] is None
