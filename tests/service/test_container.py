"""The container image, compose.yaml and the units: what is pinned, rights, open ports."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "Dockerfile").read_text()
COMPOSE = yaml.safe_load((ROOT / "compose.yaml").read_text())
SERVICES = COMPOSE["services"]
UNITS = sorted((ROOT / "service" / "cluster" / "systemd").glob("*.service"))
DIGEST = r"@sha256:[0-9a-f]{64}\b"


def test_images_of_others_are_pinned_by_digest():
    stages = set(re.findall(r"^FROM .* AS (\w+)$", DOCKERFILE, re.MULTILINE))
    bases = set(re.findall(r"^FROM (\S+)", DOCKERFILE, re.MULTILINE)) - stages
    images = {item["image"] for item in SERVICES.values()} - {"wrenchbook"}
    images.remove("${OAUTH2_PROXY_IMAGE:-none}")  # whoever uses it names it with its digest
    assert len(bases) == len(images) == 1
    for image in bases | images:
        assert re.search(r":\d[\w.-]*" + DIGEST, image), image


def test_the_image_installs_nothing_without_a_hash():
    installs = re.findall(r"pip install ((?:[^\\\n]|\\\n)*)", DOCKERFILE)
    assert len(installs) == 2
    for options in installs:
        assert "--require-hashes" in options or "--no-deps --no-build-isolation ." in options


@pytest.mark.parametrize(("file", "extra"), [("", "server"), ("-cluster", "cluster")])
def test_the_locks_of_the_image_pin_each_package_of_its_extras(file: str, extra: str):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lock = (ROOT / f"requirements{file}.lock").read_text()
    for wanted in project["optional-dependencies"][extra]:
        name = re.match(r"[\w-]+", wanted)
        assert name is not None
        assert re.search(rf"^{name[0]}==.*\\\n +--hash=sha256:", lock, re.MULTILINE), wanted


def test_locks_of_the_image_agree():
    both = [
        dict(re.findall(r"^([\w-]+)==(.*) \\$", (ROOT / name).read_text(), re.MULTILINE))
        for name in ("requirements.lock", "requirements-cluster.lock")
    ]
    shared = both[0].keys() & both[1].keys()
    assert "numpy" in shared
    assert {name: both[0][name] for name in shared} == {name: both[1][name] for name in shared}


def test_all_that_the_image_copies_is_there():
    sources = re.findall(r"^COPY (?!--from)(.*) \S+$", DOCKERFILE, re.MULTILINE)
    assert [name for line in sources for name in line.split() if not (ROOT / name).exists()] == []


def test_the_image_runs_as_a_user_of_its_own_and_reports_its_health():
    last = DOCKERFILE.rpartition("\nFROM ")[2]
    assert re.search(r"^USER wrenchbook$", last, re.MULTILINE)
    assert "'/health/ready'" in last.partition("HEALTHCHECK")[2]


@pytest.mark.parametrize("name", SERVICES)
def test_a_container_has_no_rights_that_it_does_not_need(name: str):
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service.get("cap_add", []) == (["NET_BIND_SERVICE"] if name == "proxy" else [])
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert "/tmp" in service["tmpfs"]


def test_only_the_proxy_has_ports_and_it_speaks_tls():
    assert {name for name, service in SERVICES.items() if "ports" in service} == {"proxy"}
    assert "443:443" in SERVICES["proxy"]["ports"]
    assert SERVICES["proxy"]["configs"] == [
        {"source": "caddyfile", "target": "/etc/caddy/Caddyfile"}
    ]
    content = COMPOSE["configs"]["caddyfile"]["content"]
    assert "reverse_proxy ${UPSTREAM:-server:8000}" in content
    assert content.startswith("${SITE:-localhost} {")  # a name without http:// has TLS


def test_the_proxy_cannot_reach_the_scheduler():
    assert SERVICES["proxy"]["networks"] == ["web"]
    for name in ("scheduler", "worker"):
        assert SERVICES[name]["networks"] == ["solvers"]
    assert COMPOSE["networks"]["solvers"]["internal"] is True


def test_the_server_of_the_containers_makes_a_key():
    assert "--first-key" in SERVICES["server"]["command"]


def test_no_file_names_a_build_argument_that_the_image_does_not_have():
    files = [*(ROOT / "service" / "cluster").glob("*.*"), ROOT / "compose.yaml"]
    named = {name for file in files for name in re.findall(r"--build-arg (\w+)", file.read_text())}
    assert named <= set(re.findall(r"^ARG (\w+)", DOCKERFILE, re.MULTILINE))


def test_the_data_of_the_image_are_its_users_alone():
    assert "install -d -m 0700 -o wrenchbook /data" in DOCKERFILE


def options_of(unit):
    lines = [line for line in unit.read_text().splitlines() if line[:1].isalpha()]
    return dict(line.split("=", 1) for line in lines)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_what_a_unit_writes_is_its_users_alone(unit: Path):
    options = options_of(unit)
    assert (options["UMask"], options["PrivateTmp"]) == ("0077", "true")
    assert options.get("StateDirectoryMode") == ("0700" if "StateDirectory" in options else None)


def test_there_is_a_unit_of_a_server_without_dask():
    started = [options_of(unit)["ExecStart"] for unit in UNITS]
    assert "/opt/wrenchbook/bin/wrenchbook serve --data /var/lib/wrenchbook" in started


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd here")
def test_systemd_finds_no_mistake_in_the_units(tmp_path: Path):
    for unit in UNITS:  # their programs and user are not on this machine
        text = unit.read_text().replace("User=wrenchbook\n", "")
        copy = tmp_path / unit.name.replace("@", "@1")
        copy.write_text(re.sub(r"(?m)^(ExecStart=).*", r"\1/bin/true", text))
    command = ["systemd-analyze", "verify", *map(str, tmp_path.iterdir())]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
