"""Descriptions of fields and parameters whose name has one meaning in all calls.

The OpenAPI document takes them where a schema has no description of its own. A name with another
meaning in one schema stands as ``Schema.name``.
"""

from __future__ import annotations

from typing import Any, Final

_LOADS: Final = "[low, high] of x, y and z; one number means plus and minus"
MEANINGS: Final = {
    "archived": "whether the library's list leaves the component out",
    "beyond_range": "number of measured rows outside the load range",
    "budget": "largest number of new solves",
    "client": "name of the sender, 1 to 64 characters. With `sequence` it marks a block, so that a "
    "repeated block counts once",
    "columns": "names of the matrix's columns: the inputs",
    "compared": "number of measured values that are compared",
    "component": "name of the component",
    "config": "options of the call",
    "coverage": "covered, thin or outside; see the description of the call",
    "detail": "true adds the parts of the error bar, and the answer of each axis",
    "derivatives": "du/dw of each wrench, a line an output, m and rad over N and N·m; null where "
    "it is not known",
    "dry_run": "true: the file was checked, and nothing was loaded",
    "filename": "name of the file at the sender",
    "force": "force on the component, x, y and z, N; zero if left out",
    "format": "file format; by default that of the file's content, or JSON",
    "gzip": "whether the file was compressed with gzip",
    "id": "number of the entry; jobs and imports are numbered from 1",
    "if-none-match": "ETag of the copy that the caller has: 304 if it is still right",
    "ignored": "labels of columns that were not read",
    "import": "number of the import, from 1",
    "imports": "the imports, newest first",
    "index": "number of the wrench in the batch, from 0",
    "inputs": "further inputs by name, such as the temperature",
    "inserted": "number of rows that were added, or would be in a dry run",
    "interface": "interfaces by name, each with its load range",
    "job": "the job of this wrench; null without one",
    "known_loads": "loads of which rows show the effect",
    "limit": "largest number of entries of a page",
    "load": "name of the load that varies, such as fz",
    "loads": "force and moment of each interface, by its name",
    "loc": "place of the mistake in the request or file",
    "measured": "number of measured rows",
    "message": "cause of the error, with its remedy",
    "method": "interpolation method; null: the default of the table",
    "moment": "moment on the component about the interface point, x, y and z, N·m; zero if left "
    "out",
    "most": "largest number of rows to draw",
    "msg": "the mistake and its remedy",
    "name": "name of the component: 1 to 64 of a-z, 0-9, _ and -",
    "note": "text that the sender keeps with the rows",
    "notes": "remarks on the component; the search reads them",
    "number": "number of the import, from 1",
    "ok": "whether all checks hold; null where none can be made",
    "on_thin": "reply where the table does not cover the wrench: queue a solve, wait for it, "
    "estimate or reject",
    "outside": "number of values outside the error bar",
    "overlap_hours": "hours for which the old secret is still valid",
    "partial": "true: the good rows are loaded and the others left out",
    "points": "number of points along the load",
    "preview": "the first rows as they would be loaded, in SI",
    "range": f"load range: force (N) and moment (N·m), each {_LOADS}",
    "recorded": "number of wrenches that are stored now",
    "rows": "number of rows",
    "rows_checked": "number of rows with all outputs, which the checks use",
    "scope": "the rights of the key: read, write or admin",
    "sequence": "number of the block, rising from 0; with `client`",
    "sha256": "SHA-256 of the file, hexadecimal",
    "simplified": "triangles before and after a simplification; null: the surface is complete",
    "solved": "number of solved rows",
    "status": "state of the job: waiting, running, done, failed or cancelled",
    "table_version": "version of the table that answers: the number of the last change of its rows",
    "title": "short description of the component",
    "tolerance": "error that the user accepts, m and rad; null: that of the component",
    "translation": "tolerance of translations, m",
    "rotation": "tolerance of rotations, rad",
    "units": "units of the numbers",
    "url": "path of the job",
    "wait_s": "seconds that the call waits, at most",
    "when": "time of the entry, ISO 8601, UTC",
    "who": "name of the sender's key; empty without keys",
    "wrench": "force (N) and moment (N·m) on the component",
    "wrenches": "wrenches, a line each: force (N), then moment (N·m), then further inputs",
    "Comparison.inputs": "names of the columns of `wrench`",
    "Comparison.row": "ids of the rows",
    "Compliance.rows": "names of the matrix's lines: the outputs",
    "CopyBody.name": "name of the copy",
    "CopyBody.rows": "whether the copy gets the rows too",
    "DeformedShape.frame": "pose of the undeformed interface in the mesh: point, m, and axes",
    "Demand.cells": "parts of the load range with queries that were not covered",
    "Demand.latest": "the latest of these queries, with their time",
    "DemandCell.count": "number of these queries in the cell",
    "DemandCell.outside": "number of queries outside the table",
    "DemandCell.thin": "number of queries where the table is thin",
    "DisagreeingRow.bar": "error bar of the solved rows' answer, m or rad",
    "DisagreeingRow.expected": "answer of the solved rows, m or rad",
    "DisagreeingRow.measured": "measured value, m or rad",
    "DisagreeingRow.output": "name of the output, such as uz",
    "DisagreeingRow.ratio": "difference divided by the error bar",
    "DisagreeingRow.row": "id of the row",
    "Disagreement.rows": "the rows that differ most from the solves",
    "Failure.type": "class of the error in the protocol",
    "GradientBody.sens": "weights of the outputs",
    "ImportEdited.status": "the change: withdrawn or restored",
    "JacobianBody.vec": "direction of the loads, N and N·m",
    "KeyBody.name": "name of the key",
    "NotesBody.text": "remarks on the component",
    "Plan.reason": "reason of the decision",
    "Plans.components": "plan of each component, by its name",
    "PreviewRow.row": "line or place in the file, from 1",
    "Problem.errors": "each mistake with its place",
    "Problem.status": "HTTP status",
    "Problem.title": "short name of the problem",
    "RenameBody.name": "new name",
    "RowMistake.field": "column or option",
    "RowMistakes.field": "column or option",
    "RowMistakes.count": "number of these mistakes",
    "SceneBody.components": "the needs of each component, by its name",
    "TableRows.rows": "the rows",
    "TemperatureBody.range": "lowest and highest temperature",
    "TemperatureBody.reference": "temperature without effect",
    "TemperatureBody.unit": "unit of the temperature",
    "AccelerationBody.range": "largest acceleration along x, y and z, m/s^2, plus and minus",
    "MeasuredInputs.acceleration": "acceleration as three inputs",
    "MeasuredInputs.temperature": "temperature as an input",
    "MeasuredInterface.name": "name of the interface",
    "inWrt": "number of the input vector: 0",
    "outWrt": "number of the output vector: 0",
}


def describe(document: dict[str, Any]) -> None:
    """Write a description into each field and parameter of an OpenAPI document that has none."""
    for schema, content in document["components"]["schemas"].items():
        for name, field in content.get("properties", {}).items():
            _describe(field, MEANINGS.get(f"{schema}.{name}", MEANINGS.get(name)))
    for operations in document["paths"].values():
        for operation in operations.values():
            for parameter in operation.get("parameters", ()):
                if "description" not in parameter["schema"]:
                    _describe(parameter, MEANINGS.get(parameter["name"]))


def _describe(entry: dict[str, Any], meaning: str | None) -> None:
    if meaning is not None:
        entry.setdefault("description", meaning)
