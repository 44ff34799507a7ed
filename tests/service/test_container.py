"""The container image and compose.yaml: what is pinned, who may write, which ports are open."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "Dockerfile").read_text()
COMPOSE = yaml.safe_load((ROOT / "compose.yaml").read_text())
SERVICES = COMPOSE["services"]
DIGEST = r"@sha256:[0-9a-f]{64}\b"


def test_images_of_others_are_pinned_by_digest():
    stages = set(re.findall(r"^FROM .* AS (\w+)$", DOCKERFILE, re.MULTILINE))
    bases = set(re.findall(r"^FROM (\S+)", DOCKERFILE, re.MULTILINE)) - stages
    images = {one["image"] for one in SERVICES.values()} - {"wrenchbook"}
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
    assert "reverse_proxy server:8000" in content
    assert content.startswith("${SITE:-localhost} {")  # a name without http:// has TLS


def test_the_proxy_cannot_reach_the_scheduler():
    assert SERVICES["proxy"]["networks"] == ["web"]
    for name in ("scheduler", "worker"):
        assert SERVICES[name]["networks"] == ["solvers"]
    assert COMPOSE["networks"]["solvers"]["internal"] is True


def test_the_server_of_the_containers_makes_a_key():
    assert "--first-key" in SERVICES["server"]["command"]
