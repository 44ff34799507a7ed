"""No reply tells where things lie on the machine."""

import pytest

from wrenchbook.service.files.redact import redact, redact_values


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "not written to /tmp/data/components: full",
            "not written to .../components: full",
        ),
        ("'/usr/lib/python3/json.py' line 3", "'.../json.py' line 3"),
        ("POST /v1/components/plate/table failed", "POST /v1/components/plate/table failed"),
        ("12 N/m and m/s, /health/ready", "12 N/m and m/s, /health/ready"),
        ("http://host/tmp/x", "http://host/tmp/x"),
        (
            'Traceback (most recent call last):\n  File "/usr/y.py"\n    f()\nValueError: bad',
            "ValueError: bad",
        ),
    ],
)
def test_paths_of_the_machine_lose_their_folders_and_nothing_else_does(text, told):
    assert redact(text) == told


def test_every_text_of_a_reply_is_looked_at():
    assert redact_values({"a": ["/tmp/x/y", 1, None, {"b": "/usr/lib/z"}]}) == {
        "a": [".../y", 1, None, {"b": ".../z"}]
    }
