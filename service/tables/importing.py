"""Rows into the ledger: from table files, read in the sandbox, and from another component."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from wrenchbook.service.formats.options import Options, ParsedTable
from wrenchbook.service.formats.read import ReadResult, read_block, read_untrusted
from wrenchbook.service.formats.rig import Rig
from wrenchbook.service.ledger import ImportOrigin, Ledger, NotedRows, row_keys
from wrenchbook.service.ledger.imports import Loaded
from wrenchbook.service.library.component import Component
from wrenchbook.service.tables.mapped import ServedTable
from wrenchbook.surrogate.findings.comparison import MAX_COMPARED_ROWS, comparison_findings
from wrenchbook.surrogate.findings.find import MAX_ROWS
from wrenchbook.surrogate.findings.response import RigFinding
from wrenchbook.surrogate.table.compliance import fit_compliance
from wrenchbook.surrogate.table.rows import SOLVED

SAME = 1e-12  # part of a number: bounds the rounding of an export in other units and its import
TWICE = (
    "import {0.id} already has the rows of this file ({0.filename}), read with other options, so "
    "tests count twice. If its options were wrong, withdraw it, then import this file again, which "
    "restores the rows that both have: wrenchbook withdraw {0.component} {0.id}"
)
_MAX_TRIED = 16  # stored rows of almost the same sum with which a row is compared; few have any
# Weight of displacements in the sums: they are 1e-6 to 1e-3 m and rad, loads 1 to 1000 N and N·m.
_DISPLACEMENT_WEIGHT = 1e6

# By component: its fingerprint and the numbers of its solves, and their compliance.
_compliances: dict[str, tuple[tuple[str, bytes], list[list[float]]]] = {}


def import_files(
    ledger: Ledger,
    component: Component,
    files: Sequence[Path],
    options: Options,
    origin: ImportOrigin,
    *,
    dry_run: bool = False,
    partial: bool = False,
    preview: int = 0,
    table: ServedTable | None = None,
    append: bool = False,
) -> dict[str, Any]:
    """Read one table, or the logs of loads and displacements, load its rows, and return the reply.

    `options`: of the file; load range and fingerprint are the component's.
    `dry_run`: whether rows are only counted.
    `partial`: whether good rows are loaded even if others have mistakes.
    `preview`: number of good rows in the reply.
    `table`: measured rows that differ from its answers have a finding.
    `append`: whether the rows, of a JSON block, go into the import of `origin`, without findings.

    Raises SandboxBusyError, ImportRunningError, LedgerUnavailableError or OSError if nothing can be
    read or written now, and AppendError as `Ledger.append_rows`.
    """
    setup = {"load_range": component.load_range, "fingerprint": component.fingerprint}
    options = replace(options, **setup)
    read = read_block(files[0], options) if append else read_untrusted(files, options, preview)
    report = dict(read.report)
    refused = report["is_ruined"] or bool(report["errors"] and not partial)
    report.pop("converted")
    # A block is in SI, so that a repeated one has the stored bits; a comparison with all stored
    # rows would take longer with each block.
    pieces = read.pieces if append else lambda: _with_stored_numbers(ledger, component, read)

    loaded = Loaded(0, 0, None)
    if not refused:
        if table is not None:
            report["findings"] += _compare_with_table(read, table, read.report["findings"])
        earlier = ledger.same_file(component.name, origin.digest) if origin.digest else None
        if earlier is not None:
            report["findings"].append(RigFinding("twice", TWICE.format(earlier)).body())
        if dry_run:
            keys = [key for piece in pieces() for key in _keys(component, piece)]
            new = len(set(keys) - ledger.known_rows(keys).keys())
            loaded = Loaded(new, len(keys) - new, None)
        else:
            findings = _findings_by_key(component, report["findings"], pieces)
            origin = replace(origin, format=report["format"], rig=options.rig, findings=findings)
            blocks = (NotedRows(piece, piece.note) for piece in pieces())
            load = ledger.append_rows if append else ledger.import_rows
            loaded = load(component.name, blocks, origin)

    restored = 0
    if loaded.known and not append:
        again = (key for piece in pieces() for key in _keys(component, piece))
        keys = ledger.withdrawn_keys(component.name, again)
        restored = len(keys) if dry_run else ledger.restore_confirmed(component.name, keys)
    if not loaded.new:  # all rows were stored before, so that none counts twice
        report["findings"] = [item for item in report["findings"] if item["cause"] != "twice"]

    holds = component.load_range.holds
    rows = report.pop("rows")
    good = rows.pop("good")
    return {
        "inserted": loaded.new,
        "existing": loaded.known,
        "restored": restored,
        "beyond_range": sum(int((~holds(piece.wrench)).sum()) for piece in read.pieces()),
        "dry_run": dry_run,
        "partial": partial,
        "import": loaded.number,
        "rig": Rig.read(options.rig).as_json() if options.rig else None,
        "loaded": not refused and not dry_run,
        **report,
        "rows": {**rows, "loaded": 0 if refused or dry_run else good},
    }


def _keys(component: Component, piece: ParsedTable) -> list[bytes]:
    return row_keys(component.name, NotedRows(piece, piece.note))


def _findings_by_key(
    component: Component,
    findings: Sequence[Mapping[str, Any]],
    pieces: Callable[[], Iterator[ParsedTable]],
) -> str:
    """Return findings as JSON whose rows are hexadecimal keys instead of positions in the file."""
    rows = [row for finding in findings for row in finding["rows"]]
    key_of: dict[int, str] = {}
    if rows:
        for piece in pieces():
            named = piece.take(np.isin(piece.seq, rows))
            keys = [key.hex() for key in _keys(component, named)]
            key_of |= zip(named.seq.tolist(), keys, strict=True)
    stored = [
        {**finding, "rows": [], "keys": [key_of[row] for row in finding["rows"]]}
        for finding in findings
    ]
    return json.dumps(stored)


def _compare_with_table(
    read: ReadResult, table: ServedTable, known: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Return the finding that the file's measured rows differ from a table's answers, if they do.

    The list is empty if `known` has a wrong unit, sign or clock, which causes the difference.
    """
    good = read.report["rows"]["good"]
    wrong = any(item["cause"] in ("unit", "sign", "clock") for item in known)
    if not table.row_count or not good or wrong:
        return []
    stride = max(good // MAX_COMPARED_ROWS, 1)
    parts = [piece.take(np.arange(0, len(piece), stride)) for piece in read.pieces()]
    wrench = np.concatenate([part.wrench[~part.is_solved] for part in parts])
    moved = np.concatenate([part.displacement[~part.is_solved] for part in parts])
    inside = table.load_range.holds(wrench)
    replies = table.packed.batch(wrench[inside], without_rows=True)
    solves = set(table.sources) == {SOLVED}
    answers = moved[inside], replies.outputs, replies.errors
    return [item.body() for item in comparison_findings(*answers, solves=solves)]


def solved_compliance(component: Component, table: ServedTable) -> list[list[float]] | None:
    """Return the compliance (outputs, inputs), SI, of a component's solves, zero where unknown."""
    if not component.has_fea or not table.sources.get(SOLVED):
        return None
    # Rows are appended often, solves seldom: the compliance is cached by the numbers of the solves.
    packed = table.packed
    of_solves = [number for number, names in enumerate(packed.meta["sources"]) if SOLVED in names]
    solves = packed.arrays["g0/row/seq"][np.isin(packed.arrays["g0/row/source"], of_solves)]
    key = (component.fingerprint, solves.tobytes())
    cached = _compliances.get(component.name)
    if cached is None or cached[0] != key:
        rows = table.rows
        solved = rows.take(np.flatnonzero(rows.is_solved)[:MAX_ROWS])
        fit = fit_compliance(solved, component.load_range, linear=component.linear)
        cached = _compliances[component.name] = key, np.where(fit.known, fit.matrix, 0.0).tolist()
    return cached[1]


def _with_stored_numbers(
    ledger: Ledger, component: Component, read: ReadResult
) -> Iterator[ParsedTable]:
    """Yield the rows of a file; numbers that agree with a stored row become its numbers.

    Factors of units round. A row whose numbers all agree with those of a stored row to `SAME` gets
    that row's bits, so that an export in any unit is recognised as known rows.
    """
    if not read.report["converted"]:
        yield from read.pieces()
        return
    inputs, outputs = len(component.space.inputs), len(component.space.outputs)
    stored = ledger.stored_numbers(component.name, inputs, outputs)
    sums, _ = _sums(stored, inputs)
    order = np.argsort(sums, kind="stable")
    sums = sums[order]
    for piece in read.pieces():
        numbers = np.hstack((piece.wrench, piece.displacement, piece.uncertainty))
        total, size = _sums(numbers, inputs)
        # `unmatched`: rows with further stored rows of almost the same sum, none of them equal.
        first = np.searchsorted(sums, total - 2.0 * SAME * size)
        end = np.searchsorted(sums, total + 2.0 * SAME * size, side="right")
        unmatched = np.flatnonzero(first < end)
        for step in range(_MAX_TRIED):
            candidates = stored[order[first[unmatched] + step]]
            received = numbers[unmatched]
            same = np.abs(candidates - received) <= SAME * np.abs(received)
            same = np.all(same | (np.isnan(candidates) & np.isnan(received)), axis=1)
            numbers[unmatched[same]] = candidates[same]
            unmatched = unmatched[~same & (first[unmatched] + step + 1 < end[unmatched])]
        wrench, displacement, uncertainty = np.hsplit(numbers, [inputs, inputs + outputs])
        known = {"uncertainty": uncertainty} if any(piece.uncertainty.strides) else {}
        yield replace(piece, wrench=wrench, displacement=displacement, **known)


def _sums(numbers: np.ndarray, inputs: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a weighted sum of numbers (n, k), SI, and the same sum of their sizes, (n,) each.

    Different rows hardly have the same sum: random weights separate loads of opposite signs, and
    the weight of displacements separates different readings at one wrench.
    """
    columns = np.arange(numbers.shape[1])
    weights = np.random.default_rng(0).uniform(1.0, 2.0, len(columns))
    parts = numbers * weights * np.where(columns < inputs, 1.0, _DISPLACEMENT_WEIGHT)
    return np.nansum(parts, axis=1), np.nansum(np.abs(parts), axis=1)


def copy_rows(ledger: Ledger, source: Component, target: Component, origin: ImportOrigin) -> int:
    """Copy the rows of a component's present setup, all or none; return their number.

    Raises ImportRunningError or LedgerUnavailableError if they cannot be written now.
    """
    setup = {"space": source.space, "fingerprint": source.fingerprint}
    with ledger.table_at(source.name, **setup) as table:
        return ledger.import_rows(target.name, table.lots, origin).new
