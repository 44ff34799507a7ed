"""The demonstration runs from its first step to its last."""

from __future__ import annotations

import pytest

from wrenchbook.service.cli import demo
from wrenchbook.service.cli.render import Screen


@pytest.mark.slow
def test_the_demonstration_has_no_complaint(monkeypatch):
    monkeypatch.setattr(demo, "CHECKED", 5)
    figures = demo.run(Screen(record=True))
    assert figures["failed"] is None
    assert figures["answer"]["coverage"] == "covered"
