"""Refusals as data: cases of TOML tables, each a sentence, a change of a good text, and words."""

import tomllib
from pathlib import Path

import pytest

GOOD = Path(__file__).parent / "fea" / "good"
"""Bundles that can be solved, of which those in fea/refusals.toml are changes."""


def tables(module):
    """Return {section: {sentence: case}} of the refusals.toml beside a module."""
    return tomllib.loads(Path(module).with_name("refusals.toml").read_text(encoding="utf-8"))


def cases(module, section):
    """Parametrise a test by ``case``: each of one section."""
    results = tables(module)[section].items()
    return pytest.mark.parametrize("case", [pytest.param(case, id=name) for name, case in results])


def changed(text, case):
    """Return a good text with what a case replaces, each of which is there once."""
    for old, new in case["change"].items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def assert_told(case, lines):
    """One of the lines has all the words of a case."""
    assert any(all(word in line for word in case["words"]) for line in lines), lines
