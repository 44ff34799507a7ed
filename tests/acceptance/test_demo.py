"""The demonstration runs from its first step to its last."""

from __future__ import annotations

import re

import pytest

from wrenchbook.service.cli import demo
from wrenchbook.service.cli.render import Screen


@pytest.mark.slow
def test_the_demonstration_has_no_complaint(monkeypatch):
    monkeypatch.setattr(demo, "CHECKED", 5)
    screen = Screen(record=True)
    figures = demo.run(screen)
    assert figures["failed"] is None
    assert figures["answer"]["coverage"] == "covered"
    # The errors are those of the table that answered, before the new solves entered it.
    text = screen.export_text()
    filled = re.search(r"plate_thin has (\d+) rows", text)
    assert filled
    assert f"The table of {filled[1]} rows answers in" in text
    assert figures["rows"] == int(filled[1]) + 5  # with the solves of the comparison
