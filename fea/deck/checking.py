"""Checks of a deck without running it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from wrenchbook.fea.deck.running import missing_placeholders
from wrenchbook.fea.readers.registry import reader_named
from wrenchbook.fea.spec.problems import BundleError, BundleProblem
from wrenchbook.fea.spec.schema import Deck


def deck_report(deck: Deck) -> tuple[dict[str, Any], list[BundleProblem]]:
    """Return a summary of a deck, and warnings.

    A program that is not installed here is a warning and no mistake of the bundle: solves may run
    elsewhere, and one that does not says so.

    Returns
    -------
    dict
        Its ``file``, ``program`` (the path found, or None), ``reader``, ``moment``, ``unit`` and
        ``timeout`` (s).
    list of Problem
        What may keep a solve from working.

    Raises
    ------
    BundleError
        If the deck lacks a placeholder, or what its reader depends on.
    """
    content = deck.file.read_bytes()
    problems = [_missing(name) for name in missing_placeholders(content)]
    text = "\n".join(
        file.read_text(encoding="utf-8", errors="replace") for file in (deck.file, *deck.files)
    )
    mistakes = reader_named(deck.output["reader"]).mistakes(text, deck)
    problems += [BundleProblem("deck.file", f"{deck.file.name} {mistake}") for mistake in mistakes]
    if problems:
        raise BundleError(problems)
    program = deck.command[0]
    own = [file for file in deck.files if Path(program) == Path(file.name)]
    program = program if own and "/" in program else shutil.which(program)
    summary = {
        "file": deck.file.name,
        "program": program,
        "reader": deck.output["reader"],
        "moment": deck.moment,
        "unit": deck.unit,
        "timeout": deck.timeout,
    }
    return summary, [] if program else [_not_here(deck.command[0])]


def _missing(placeholder: str) -> BundleProblem:
    message = (
        f"has no {placeholder}; put it where that load goes, or into a comment line that says what "
        "takes the load instead"
    )
    return BundleProblem("deck.file", message)


def _not_here(program: str) -> BundleProblem:
    message = f'the program "{program}" is not on the PATH of this machine; install it where '
    return BundleProblem("deck.command", message + "solves run")
