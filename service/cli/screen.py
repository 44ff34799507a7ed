"""The terminal that commands print on; control characters in names are escaped."""

from __future__ import annotations

import re
from typing import Any

from rich.console import Console
from rich.text import Text

# Control characters but tab and line end: with them a note or a log could move the cursor, rename
# the window or type into some terminals.
_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


class Screen(Console):
    """A console on which texts are letters and nothing else."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Render a text, with a sign in place of each character that would steer a terminal."""
        return super().render_str(_STEERING.sub("\N{REPLACEMENT CHARACTER}", text), **options)
