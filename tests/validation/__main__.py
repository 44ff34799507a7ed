"""Run the verification suite: ``python -m tests.validation [TOPIC]``.

Prints one line for each finding and ends with status 1 if one is beyond its tolerance. It runs in
a process of its own, as every solve does: the command line never imports the finite elements.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

from tests.validation import (
    bar,
    curved_beam,
    laminate,
    materials,
    patch,
    plate,
    rates,
    spring,
    supports,
    vibration,
)
from tests.validation.finding import CASES, TOPICS, Case, Finding

__all__ = ["MODULES", "main", "markdown", "replace_table", "run"]

MODULES = (patch, rates, supports, bar, plate, curved_beam, spring, laminate, materials, vibration)
"""Where the cases are; importing them enters them in `CASES`."""

BEGIN = "<!-- validation: begin (written by `make validate-table`) -->"
END = "<!-- validation: end -->"

_HEADINGS = ("quantity", "source", "reference", "computed", "error", "tolerance", "verdict")


def ordered() -> list[Case]:
    """Return the cases by topic, then in the order of `MODULES`, whichever was imported first."""
    places = {module.__name__: place for place, module in enumerate(MODULES)}
    return sorted(CASES, key=lambda c: (TOPICS.index(c.topic), places.get(c.check.__module__, 0)))


def run(topic: str) -> Iterator[tuple[Case, Finding]]:
    """Run the cases of a topic, or of ``"all"``, and yield their findings as they come."""
    for item in ordered():
        if topic in ("all", item.topic):
            for finding in item.check():
                yield item, finding


def cells(finding: Finding) -> tuple[str, ...]:
    """Return one finding as words, in the order of the table's columns."""
    if finding.missing:
        return finding.quantity, finding.source, "", "", "", "", f"not run: {finding.missing}"
    numbers = f"{finding.reference:.6g}", f"{finding.computed:.6g}", f"{finding.error:.1e}"
    allowed = "" if finding.tolerance is None else f"{finding.tolerance:.0e}"
    return finding.quantity, finding.source, *numbers, allowed, finding.verdict


def markdown(results: Iterable[tuple[Case, Finding]]) -> str:
    """Return findings as one Markdown table for each case."""
    lines: list[str] = []
    last: Case | None = None
    for one, finding in results:
        if one is not last:
            lines += ["", f"**{one.title}**", "", _row(_HEADINGS), _row(["---"] * len(_HEADINGS))]
            last = one
        lines.append(_row(cells(finding)))
    return "\n".join(lines[1:])


def headline(results: list[tuple[Case, Finding]], seconds: float) -> str:
    """Return one sentence on all findings: their verdicts, the largest error, the run time."""
    findings = [finding for _, finding in results]
    measured = [f for f in findings if f.tolerance and not f.missing]
    worst = max(measured, key=lambda f: f.error / (f.tolerance or 1.0))
    return (
        f"{len(findings)} quantities: {_summary([f.verdict for f in findings])}. The largest error "
        f"is {worst.error / (worst.tolerance or 1.0):.0%} of its tolerance ({worst.quantity}). The "
        f"run took {seconds:.0f} s of processor time."
    )


def by_topic(results: list[tuple[Case, Finding]]) -> str:
    """Return a Markdown table of verdicts and largest error over tolerance, by topic."""
    head = ("topic", "quantities", "pass", "reported", "largest error / tolerance")
    lines = [_row(head), _row(["---"] * len(head))]
    for topic in TOPICS:
        findings = [finding for one, finding in results if one.topic == topic]
        verdicts = [finding.verdict for finding in findings]
        ratios = [f.error / f.tolerance for f in findings if f.tolerance and not f.missing]
        counts = (str(verdicts.count(verdict)) for verdict in ("pass", "reported"))
        lines.append(_row([topic, str(len(findings)), *counts, f"{max(ratios, default=0.0):.2g}"]))
    return "\n".join(lines)


def replace_table(page: str, table: str) -> str:
    """Return a page with what is between its two markers replaced.

    Raises
    ------
    ValueError
        If the page has not both markers.
    """
    if BEGIN not in page or END not in page:
        raise ValueError(f"the page has not both markers {BEGIN} and {END}")
    above, rest = page.split(BEGIN, 1)
    return f"{above}{BEGIN}\n\n{table}\n\n{END}{rest.split(END, 1)[1]}"


def _row(text: Iterable[str]) -> str:
    return "| " + " | ".join(text) + " |"


def _lines(topic: str, results: list[tuple[Case, Finding]]) -> Iterator[str]:
    """Yield the plain table as the findings come; keep them in `found`."""
    last: Case | None = None
    for one, finding in run(topic):
        results.append((one, finding))
        if one is not last:
            yield f"\n{one.topic}: {one.title}"
            last = one
        quantity, source, *numbers = cells(finding)
        reference, computed, error, tolerance, verdict = numbers
        yield (
            f"  {verdict:<9} {quantity:<62} {computed:>13} {reference:>13} "
            f"{error:>9} {tolerance:>6}  {source}"
        )


def _plain(topic: str, result: list[tuple[Case, Finding]]) -> None:
    print(
        f"  {'verdict':<9} {'quantity':<62} {'computed':>13} {'reference':>13} "
        f"{'error':>9} {'most':>6}  source of the reference"
    )
    for line in _lines(topic, result):
        print(line, flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Run what the arguments ask for; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.validation", description=__doc__)
    parser.add_argument("topic", nargs="?", default="all", choices=(*TOPICS, "all"))
    shape = parser.add_mutually_exclusive_group()
    shape.add_argument("--markdown", action="store_true", help="print Markdown tables")
    shape.add_argument("--json", action="store_true", help="print one JSON array")
    shape.add_argument("--update", type=Path, metavar="PAGE", help="put the tables into a page")
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    results: list[tuple[Case, Finding]] = []
    if options.markdown or options.json:
        results.extend(run(options.topic))
        print(markdown(results) if options.markdown else _json(results))
    else:
        _plain(options.topic, results)
    if options.update is not None:
        page = options.update.read_text(encoding="utf-8")
        head = headline(results, time.process_time())
        table = f"{head}\n\n{by_topic(results)}\n\n{markdown(results)}"
        options.update.write_text(replace_table(page, table), encoding="utf-8")
    verdicts = [finding.verdict for _, finding in results]
    if not (options.markdown or options.json):
        print(f"\n{_summary(verdicts)}, {time.perf_counter() - started:.0f} s")
    return 1 if "FAIL" in verdicts else 0


def _summary(verdicts: list[str]) -> str:
    kinds = ("pass", "FAIL", "reported", "not run")
    return ", ".join(f"{verdicts.count(k)} {k}" for k in kinds if k in verdicts)


def _json(results: list[tuple[Case, Finding]]) -> str:
    rows = []
    for one, finding in results:
        row = {"topic": one.topic, "case": one.title, **asdict(finding)}
        rows.append(row | {"verdict": finding.verdict})
        if finding.missing:
            rows[-1] |= {"reference": None, "computed": None}
        else:
            rows[-1]["error"] = finding.error
    return json.dumps(rows, indent=2)


if __name__ == "__main__":
    sys.exit(main())
