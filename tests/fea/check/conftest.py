"""Checks of decks without the estimate of the solver's error, in which they spend their time."""

import pytest

from tests.slow import slow
from wrenchbook.fea.check import reporting


@pytest.fixture(params=["no estimate", slow("estimate")])
def estimates(request, monkeypatch):
    """Check meshes as if they were too large for the estimate; in `make test-slow` as they are."""
    if request.param == "no estimate":
        monkeypatch.setattr(reporting, "_MAX_SECONDS", 0.0)
