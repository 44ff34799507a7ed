"""What people see while solves go on."""

import io

import pytest
from rich.table import Table

from wrenchbook.service.cli.jobs import event_line
from wrenchbook.service.cli.progress import Pace
from wrenchbook.service.cli.render import Screen
from wrenchbook.service.client import Event


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_a_pace_says_solves_a_minute_and_the_time_left():
    clock = Clock()
    pace = Pace(100, clock)
    assert pace.note() == ""
    clock.now, pace.ended = 30.0, 20
    assert pace.note() == "40 solves/min, at most 2 min left"
    assert pace.note(in_round=5) == "50 solves/min, at most 2 min left"
    clock.now, pace.ended = 60.0, 60
    assert pace.note() == "60 solves/min, at most 40 s left"


def test_events_are_told_in_words():
    job = {"id": 3, "component": "plate", "status": "running"}
    running = Event("job", job | {"progress": {"fraction": 0.5, "message": "step 2"}})
    failed = Event("job", job | {"status": "failed", "error": {"kind": "k", "message": "m"}})
    done = Event("job", job | {"status": "done", "row": 9, "error": None})
    assert event_line(running) == "job 3 of plate: running, 50% step 2"
    assert event_line(failed) == "job 3 of plate: failed, k: m"
    assert event_line(done) == "job 3 of plate: done, row 9"
    table = {"component": "plate", "table_version": 4, "rows": 4}
    assert event_line(Event("table", table)) == "plate: table version 4, 4 rows"
    assert event_line(Event("hello", {"tables": {}})) == ""


# -- texts of others -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text", ["\x1b]0;mine\x07", "\x1b[2J", "a\x00b", "\x9b2J", "\u202egpj.exe"]
)
def test_a_text_of_others_steers_no_terminal(text):
    screen = Screen(file=io.StringIO(), width=60, force_terminal=True)
    table = Table("title")
    table.add_row(text)
    screen.print(table)
    screen.print(text, markup=False, highlight=False, style="red")
    told = screen.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert text not in told
    assert told.count("\N{REPLACEMENT CHARACTER}") >= 2
