"""The catalogue of messages has each kind of error, with its place and its placeholders."""

import pytest

from tests.messages import messages


@pytest.mark.parametrize(
    ("package", "place", "text"),
    [
        ("service/cli", "exit 2", "--start and --clear exclude each other; give one of them"),
        ("service/http", "403", "Host {name[:100]!r} is not allowed"),
        ("service", "409", "{name!r} is a table of measured rows"),
        ("fea/mesh/cad", "422, check: exit 1", "there is no body {number}"),
        ("fea", "failed job, 424", "Lower the load range, or stiffen the part"),
    ],
)
def test_the_catalogue_has_the_errors_of_each_kind(package: str, place: str, text: str):
    results = [
        message for message in messages() if message.package == package and message.place == place
    ]
    assert any(text.replace("!r", "") in result.text for result in results)


def test_the_catalogue_names_the_line_of_a_message():
    assert all(message.source.rpartition(":")[2].isdigit() for message in messages())
