"""A few calls of each kind made up from the document; `make fuzz` sends ten thousand.

WRENCHBOOK_FUZZ is how many; with it the calls differ each time, and sequences are sent too.
"""

import os
from collections import Counter

import pytest

from tests.fuzz import document

EXAMPLES = int(os.environ.get("WRENCHBOOK_FUZZ", "150"))


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    with document.server(tmp_path_factory.mktemp("fuzz")) as result:
        yield result


@pytest.mark.timeout(7200)
def test_no_call_answers_what_the_document_does_not_say(served):
    child, client = served
    reported: Counter[int] = Counter()
    calls = document.operations(client.url)
    for call in calls:
        document.fuzz(call, max(3, EXAMPLES // len(calls)), reported)
    assert child.poll() is None
    assert reported[200] > 20
    assert reported[422] > 20
    print(
        f"\n{sum(reported.values())} calls, {dict(reported)}, "
        f"{document.peak(child) >> 20} MB at most"
    )


@pytest.mark.skipif("WRENCHBOOK_FUZZ" not in os.environ, reason="minutes: make fuzz runs it")
@pytest.mark.timeout(7200)
def test_no_sequence_of_calls_answers_what_the_document_does_not_say(served):
    child, client = served
    reported: Counter[int] = Counter()
    document.follow(client.url, EXAMPLES, reported)
    assert child.poll() is None
    assert reported[200] > 20
    print(
        f"\n{sum(reported.values())} calls in sequences, {dict(reported)}, "
        f"{document.peak(child) >> 20} MB"
    )
