"""What the check reports of bundles: cases of refusals.toml, each a change of a sound bundle."""

import shutil
from pathlib import Path

import pytest

from tests.fea.two_interfaces import LINK
from tests.refusals import assert_told, cases, changed
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check import as_text, report
from wrenchbook.fea.solver.vibration import Riding

BAR = Path(__file__).with_name("slender.toml").read_text("utf-8")
GOOD = {"slender": BAR, "link": LINK}


def entries(told, kind):
    return [f"{item['where']}: {item['message']}" for item in told[kind]]


@cases(__file__, "reported")
def test_what_the_check_reports(tmp_path, case):
    folder = tmp_path / case["good"]
    if case["good"] in GOOD:
        folder.mkdir()
        text = GOOD[case["good"]]
    else:
        shutil.copytree(SHIPPED / case["good"], folder)
        text = (folder / "component.toml").read_text("utf-8")
    (folder / "component.toml").write_text(changed(text, case), "utf-8")
    reported = report(folder, *([Riding.of(case["riding"])] if "riding" in case else []))
    assert reported["ok"] is ("problems" not in case), reported["problems"]
    for kind in ("problems", "warnings"):
        for words in case.get(kind, ()):
            assert_told({"words": [words]}, entries(reported, kind))
        for words in case.get(f"no_{kind}", ()):
            assert not any(words in entry for entry in entries(reported, kind))
    for words in case.get("text", ()):
        assert words in as_text(reported)
    for words in case.get("no_text", ()):
        assert words not in as_text(reported)
    for path, expected in case.get("values", {}).items():
        result = reported
        for key in path.split("."):
            result = result[int(key) if key.isdigit() else key]
        exact = isinstance(expected, str | list) and not (
            expected and isinstance(expected[0], float)
        )
        near = expected if exact else pytest.approx(expected, rel=case.get("near", 1e-6))
        assert result == near, path


def test_a_memory_of_a_hundred_gigabytes_is_written_out():
    cost = {"linear_seconds": 1.0, "nonlinear_seconds": 2.0, "memory_bytes": 123_000_000_000}
    text = as_text({"ok": True, "warnings": [], "problems": [], "estimate": cost | {"basis": "?"}})
    assert "123 GB of memory" in text
