"""The recipe for SLURM solves a job in workers that sbatch starts as the submitting user."""

import os
import re
import subprocess
import sys

import pytest

from tests.service.engines.cluster import SOURCES, Cluster
from tests.until import until
from wrenchbook.service.jobs.dask import DaskEngine
from wrenchbook.service.jobs.dispatcher import Dispatcher
from wrenchbook.service.ledger import Ledger

RECIPE = re.compile(r"^import threading\n.*?\.wait\(\)\n", re.MULTILINE | re.DOTALL)
SBATCH = """#!/bin/sh
cp "$1" {folder}/job.sh
setsid sh {folder}/job.sh > {folder}/job.log 2>&1 &
echo "Submitted batch job $!"
"""
SCANCEL = "#!/bin/sh\nkill -- -$1\n"  # as SLURM, which ends all processes of a job


@pytest.mark.timeout(300)
def test_the_recipe_of_the_readme_solves_in_workers_that_sbatch_has_started(tmp_path):
    pytest.importorskip("dask_jobqueue", reason="of the extra dev")
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (tmp_path / name).write_text(text.format(folder=tmp_path))
        (tmp_path / name).chmod(0o755)
    cluster = Cluster(tmp_path)
    readme = (SOURCES / "service" / "cluster" / "README.md").read_text()
    recipe = RECIPE.search(readme)[0]
    recipe = recipe.replace('"port": 8786', f'"port": {cluster.port}, "host": "127.0.0.1"')
    environment = cluster.environment | {"TMPDIR": str(tmp_path)}
    environment["WRENCHBOOK_SOLVE"] = "stand_in:quick"
    environment["PATH"] = f"{tmp_path}:{os.environ['PATH']}"
    environment["PYTHONPATH"] += f":{os.environ.get('PYTHONPATH', '')}"
    command = [sys.executable, "-c", recipe.replace("maximum=16", "maximum=1")]
    scheduler = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    assert cluster.address in scheduler.stdout.readline()
    ledger, engine = Ledger(tmp_path / "ledger.sqlite"), DaskEngine(cluster.address)
    bundle = SOURCES / "data" / "components" / "bar"
    dispatcher = Dispatcher(ledger, engine, lambda _: bundle, tmp_path / "jobs")
    try:
        job, _ = ledger.accept("bar", "f", (10.0, 0, 0, 0, 0, 0))
        dispatcher.start()
        until(lambda: ledger.job(job.id).is_final)
        assert ledger.job(job.id).status == "done", ledger.job(job.id).error
        assert "#SBATCH --mem=4G" in (tmp_path / "job.sh").read_text()
    finally:
        dispatcher.stop()
        engine.close()
        scheduler.send_signal(2)  # Ctrl-C: the recipe cancels its jobs
        scheduler.communicate(timeout=60)
        ledger.close()
