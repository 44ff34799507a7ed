"""Wrong addresses, other versions, missing packages: said in words, and nobody waits for them."""

import pytest

from tests.ports import reserved_port
from tests.until import until
from wrenchbook.service.jobs.attempt import EngineError
from wrenchbook.service.jobs.dask import DaskEngine
from wrenchbook.service.settings import SettingsError, check_engine

OTHER_VERSION = """
import importlib.metadata as metadata
real = metadata.version
metadata.version = lambda name: "0.0.7" if name == "wrenchbook" else real(name)
"""


def test_an_address_where_nobody_is_is_told_and_has_no_places(tmp_path, own):
    engine = DaskEngine(f"tcp://127.0.0.1:{reserved_port()}")
    with pytest.raises(EngineError, match=r"Dask scheduler at tcp://127\.0\.0\.1"):
        engine.submit(own.attempt("quick"))
    assert engine.slots == 0
    engine.close()


@pytest.mark.parametrize(
    ("name", "scheduler", "why"),
    [
        ("dask", None, "add --scheduler"),
        ("dask", "10.0.0.1:8786", "write tcp://10.0.0.1:8786"),
        ("dask", "http://10.0.0.1:8786", "must begin with tcp:// or tls://"),
        ("local", "tcp://10.0.0.1:8786", "add --engine dask"),
        ("cloud", None, "--engine must be local or dask"),
    ],
)
def test_settings_that_cannot_work_are_refused_at_once(name, scheduler, why):
    with pytest.raises(SettingsError, match=why):
        check_engine(name, scheduler)


def test_an_address_of_no_kind_dask_knows_is_told(own):
    engine = DaskEngine("carrier://pigeon:1")
    until(lambda: "carrier" in (engine.trouble or "") and "cannot be used" in engine.trouble)
    engine.close()


def test_a_worker_of_another_version_gets_nothing_to_solve(own, cluster):
    strange = cluster.folder / "strange"
    strange.mkdir(parents=True)
    (strange / "sitecustomize.py").write_text(OTHER_VERSION)
    path = f"{strange}:{cluster.environment['PYTHONPATH']}"
    cluster.start_scheduler()
    cluster.start_worker(PYTHONPATH=path)
    engine = own.open_engine()
    own._engines.append(engine)
    until(lambda: "0.0.7" in (engine.trouble or ""))
    assert engine.slots == 0
    cluster.start_worker()
    until(lambda: engine.slots)
    attempts = [own.attempt("quick") for _ in range(4)]
    for attempt in attempts:
        engine.submit(attempt)
    assert {own.end(engine, attempt) for attempt in attempts} == {"finished"}


def test_a_worker_without_the_program_gets_nothing_and_a_scheduler_needs_none(own, cluster):
    strange = cluster.folder / "strange"
    strange.mkdir(parents=True)
    absent = "raise ModuleNotFoundError('No module named wrenchbook')"
    (strange / "wrenchbook.py").write_text(absent)
    sound = cluster.environment["PYTHONPATH"]
    cluster.environment["PYTHONPATH"] = str(strange)
    cluster.start_scheduler()
    cluster.start_worker()
    engine = own.open_engine()
    own._engines.append(engine)
    until(lambda: "install wrenchbook[cluster,server]" in (engine.trouble or ""))
    cluster.start_worker(PYTHONPATH=sound)
    until(lambda: engine.slots)
    attempt = own.attempt("quick")
    engine.submit(attempt)
    assert own.end(engine, attempt) == "finished"


def test_files_of_100_mb_stay_behind_by_name_and_an_answer_of_100_mb_fails(own, cluster):
    cluster.start_scheduler()
    cluster.start_worker()
    engine, attempt = own.engine(), own.attempt("leaves_100_mb")
    answer = own.attempt("answers_100_mb")
    engine.submit(attempt)
    engine.submit(answer)
    assert own.end(engine, attempt) == own.end(engine, answer) == "finished"
    log = (attempt.folder / "log.txt").read_text()
    assert "huge.bin (100000000 bytes)" in log
    assert log.endswith("the last line\n")
    assert len(log) < 1_100_000
    assert not (attempt.folder / "huge.bin").exists()
    assert own.outcome(attempt).status == "done"
    assert own.outcome(answer).error["kind"] == "answer_too_large"
