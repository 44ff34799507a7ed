"""What commands print of others' words."""

import io

import pytest
from rich.table import Table

from wrenchbook.service.cli.render import Screen


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
