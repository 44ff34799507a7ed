"""The header of a table of columns: lines above it, and the meaning and unit of each column.

Names and spellings are those of `columns`. A number column has its unit in its label, in a row of
units below or in the preamble. An unknown column is a mistake unless the sender leaves it out: a
misspelt load would count as zero. The first of 31 lines that names two columns is the header;
without one the first line is read as the header, and its mistakes are reported. The sender may name
columns by their position, from 1, if no label is that number; then a file needs no header.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, islice

from wrenchbook.service.formats.cells import is_number, quoted
from wrenchbook.service.formats.columns import (
    ARRAYS,
    MAX_LABEL,
    ORIGIN,
    TEXTS,
    TIME_COLUMN,
    Columns,
    Reading,
    split,
)
from wrenchbook.service.formats.options import FileMistake, Options
from wrenchbook.service.formats.preamble import Preamble
from wrenchbook.service.formats.units import UnitError

MAX_TITLES = 30  # lines above a table: a page of a report
_SEVERAL = 2  # names of columns in a header: one word of a title may be a name ("Fx test, 3 mm")
_SLIP = 0.8  # similarity of a word with one letter of five or six wrong: notes, soruce
_MAX_LISTED = 200  # characters of the file's labels in a message
_SURE_DELIMITERS, _OTHER_DELIMITERS = ";\t", ",|"  # delimiters that no label contains, and others
POSITION = re.compile(r"[1-9]\d{0,3}")
_CLOCK_FORM = re.compile(r"(?i)h:mm?(:ss?)?")  # of times of day, in place of a unit
_BOOKKEEPING = re.compile(r"(status.*|rdt sequence|f/t sequence)", re.IGNORECASE)
_BY_MAPPING = "by mapping (--column)"
_ALONE = (
    ". If the file is a log of loads, also send the log of the displacements: displacements=FILE "
    "(--displacements FILE)"
)

Record = tuple[int, list[str]]  # the line of a record in its file, from 1, and its cells


def is_row(cells: Sequence[str]) -> bool:
    """Return whether cells are a row of two numbers or more, and nothing else."""
    filled = [cell for cell in cells if cell.strip()]
    return len(filled) >= _SEVERAL and all(map(is_number, filled))


def _split_titles(
    first: Record, rest: Iterator[Record], mapping: Mapping[str, str], columns: Columns
) -> tuple[list[str], Record, Iterator[Record]]:
    """Return the titles, the header and the records below it; keys of `mapping` count as names.

    If the keys are positions, the first row of numbers may replace a header.
    """
    if named_columns(first[1], columns, mapping) >= _SEVERAL or is_row(first[1]):
        return [], first, rest
    titles = [first]
    for record in islice(rest, MAX_TITLES):
        end = len(titles)
        titles.append(record)
        if is_row(record[1]):
            if not any(map(POSITION.fullmatch, mapping)):
                break
            while end and len(titles[end - 1][1]) == len(record[1]):
                end -= 1  # labels, maybe with units below them
        elif named_columns(record[1], columns, mapping) < _SEVERAL:
            continue
        joined = (
            " ".join(cell.strip() for cell in cells if cell.strip()) for _, cells in titles[:end]
        )
        below = chain(titles[end + 1 :], rest)
        return [title[:MAX_LABEL] for title in joined], titles[end], below
    return [], first, chain(titles[1:], rest)


def delimiter_in(lines: Iterator[str], bare: Callable[[str], str], options: Options) -> str:
    """Return the delimiter of the header, else of the first row of numbers, else of the first line.

    It is ``;`` or tab if the header has one, else ``,`` or ``|``, whichever gives more names. A
    blank stands for runs of blanks. `bare` removes brackets from a line, as units may contain
    delimiters.

    Raises ValueError if blanks and commas both make a row.
    """
    heads = [bare(line) for line in islice(lines, MAX_TITLES + 1)]
    columns = options.columns
    limit = columns.max_count
    marks = _SURE_DELIMITERS + _OTHER_DELIMITERS

    def names(line: str, mark: str) -> int:
        return named_columns(line.split(mark, limit), columns, options.mapping)

    for line in heads:
        if any(names(line, mark) >= _SEVERAL for mark in marks):
            return _mark_of_header(line, names)
    for line in heads:
        rows = [mark for mark in marks if is_row(line.split(mark, limit)[:limit])]
        cells = line.split(None, limit)[:limit]
        if is_row(cells) and not any(cell[0] in marks or cell[-1] in marks for cell in cells):
            rows += [" "]
        if len(rows) > 1 and rows[0] in _OTHER_DELIMITERS:
            raise ValueError(
                f"blanks or commas may separate the cells of {line.strip()[:80]}. For commas put "
                "the line sep=, before the first line; for blanks replace them by ;"
            )
        if rows:
            return rows[0]
    return _mark_of_header(heads[0], names)


def _mark_of_header(header: str, names: Callable[[str, str], int]) -> str:
    """Return a sure delimiter of a header, else the one with more `names`."""
    for mark in _SURE_DELIMITERS:
        if mark in header:
            return mark
    return max(_OTHER_DELIMITERS, key=lambda mark: names(header, mark))


def named_columns(cells: Sequence[str], columns: Columns, mapping: Mapping[str, str]) -> int:
    """Return the number of cells that name a column of a table or a key of the mapping."""
    mapped = {_key(name) for name in mapping} - {""}
    labels = (" ".join(cell.split()) for cell in cells[: columns.max_count])
    return sum(
        not mapped.isdisjoint((_key(label), _key(_parts(label)[0])))
        or bool(label and readings_of(label, columns))
        for label in labels
    )


@dataclass(frozen=True)
class HeaderColumn:
    """One column: its index in a record, label, name, and the factor and zero of its unit in SI."""

    index: int
    label: str
    name: str
    factor: float = 1.0
    unit: str = ""
    zero: float = 0.0


@dataclass
class Header:
    """The columns by name, the cells of a record, and the mistakes of the header.

    `unnamed` are indices without a label, whose cells must be empty; `titles` the lines above.
    `status` and `sequence` are columns of a logger.
    """

    width: int
    columns: dict[str, HeaderColumn] = field(default_factory=dict)
    mistakes: list[FileMistake] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    status: HeaderColumn | None = None
    sequence: HeaderColumn | None = None
    preamble: Preamble = field(default_factory=Preamble)
    unnamed: list[int] = field(default_factory=list)
    titles: list[str] = field(default_factory=list)
    named: bool = True  # whether the file has labels and units


def array_header(columns: Columns) -> Header:
    """Return the header of rows as arrays in SI: ``wrench[0]``, ``compliance[1][2]``."""
    header = Header(0, named=False)
    inputs = len(columns.wrench)
    for key in ARRAYS:
        for at, name in enumerate(getattr(columns, key)):
            place = f"[{at // inputs}][{at % inputs}]" if key == "compliance" else f"[{at}]"
            header.columns[name] = HeaderColumn(len(header.columns), f"{key}{place}", name)
    for name in TEXTS:
        header.columns[name] = HeaderColumn(len(header.columns), name, name)
    header.width = len(header.columns)
    return header


def read_head(records: Iterator[Record], options: Options) -> tuple[Header, Iterator[Record]]:
    """Return the header below preamble and titles, with its mistakes, and the records below it."""
    preamble = Preamble()
    columns = options.columns
    for line, cells in records:
        try:
            if preamble.add(cells):
                continue
        except ValueError as error:
            return _no_header(line, "line", str(error)), records
        break
    else:
        message = "the file is empty; export it again"
        if preamble:
            message = (
                "there is no header below the logger's lines; write the names of the columns there"
            )
        return _no_header(0, "file", message), records

    titles, (line, cells), records = _split_titles((line, cells), records, options.mapping, columns)
    if any(cell.strip() for cell in cells[columns.max_count :]):
        message = f"names {len(cells):,} columns, at most {columns.max_count} are read; remove some"
        return _no_header(line, "header", message), records

    positions = [int(key) for key in options.mapping if POSITION.fullmatch(key)]
    # Concatenated files have the mark of UTF-8 before a later label too.
    labels = [" ".join(cell.replace("\ufeff", "").split()) for cell in cells]
    if all(is_number(cell) for cell in cells if cell.strip()):
        if not positions or _counts_columns(cells):
            message = _COUNTS if positions else _NO_LABELS
            return _no_header(line, "header", message), records
        labels = [str(at) for at in range(1, len(cells) + 1)]
        records = chain([(line, cells)], records)
    while len(labels) > max(positions, default=0) and not labels[-1]:
        labels.pop()  # a spreadsheet's empty columns on the right

    below = next(records, None)
    units = below[1] if below and _is_units_row(labels, below[1], options) else []
    if below and not units:
        records = chain([below], records)
    header = Header(width=len(labels), preamble=preamble, titles=titles)
    _read_labels(header, labels, line, options, units)
    return header, records


_COUNTS = (
    "counts the columns, as data frames without names write it; remove this line, or write its "
    "first number with a decimal point if these are readings"
)
_NO_LABELS = (
    "there is no header. Name the columns with units in the first line, such as fx [N], ux [mm] "
    "(lines that begin with # are comments), or by position with mapping (--column '1=fx [N]')"
)


def _no_header(line: int, field: str, message: str) -> Header:
    return Header(0, mistakes=[FileMistake(line, field, message)])


def _is_units_row(labels: list[str], cells: list[str], options: Options) -> bool:
    """Return whether a record below labels without units is a row of units."""
    if any(is_number(cell) for cell in cells if cell.strip()):
        return False
    targets = _meanings(labels, options.mapping)
    for label, target, cell in zip(labels, targets, cells, strict=False):
        if not cell.strip():
            continue
        for reading in readings_of((target or label).removeprefix("-"), options.columns):
            unit = _parts(label)[1] if target else reading.unit
            if reading.column not in TEXTS and not unit:
                return True
    return False


def is_second_header(cells: Sequence[str], header: Header, options: Options) -> bool:
    """Return whether cells below a header are another header, or another row of units."""
    columns = options.columns
    filled = [cell for cell in cells if cell.strip()]
    if len(filled) < _SEVERAL or any(map(is_number, filled)):
        return False
    units = 0
    for column in header.columns.values():
        cell = cells[column.index] if column.index < len(cells) else ""
        if cell.strip() and column.name not in TEXTS:
            with suppress(UnitError):
                columns.factor(column.name, _parts(cell)[1] or _without_brackets(cell))
                units += 1
    return units >= _SEVERAL or named_columns(filled, columns, options.mapping) >= _SEVERAL


def _without_brackets(cell: str) -> str:
    """Return the unit in a cell of a row of units: ``kN`` of ``[kN]``."""
    unit = cell.strip()
    return unit[1:-1].strip() if unit[:1] + unit[-1:] in ("[]", "()") else unit


def _meanings(labels: Sequence[str], mapping: Mapping[str, str]) -> list[str]:
    """Return the mapping's value of each label, or an empty text.

    A key is a label, with or without the brackets, or the position of a column, from 1, if it is no
    label.
    """
    keys = [(_key(label), _key(_parts(label)[0])) for label in labels]
    known = {_key(key): value for key, value in mapping.items() if key}
    positions = known.keys() - {key for names in keys for key in names}
    return [
        known.get(names[0]) or known.get(names[1]) or (known[at] if at in positions else "")
        for names, at in zip(keys, map(str, range(1, len(labels) + 1)), strict=True)
    ]


def readings_of(label: str, columns: Columns) -> list[Reading]:
    """Return the meanings of a label; none if its brackets are broken."""
    try:
        return list(columns.readings(label))
    except UnitError:
        return []


def with_unit(name: str, unit: str, columns: Columns) -> str:
    """Return a label with the unit that the file states beside it, unless it has its own."""
    named = "[" in name or "(" in name or any(r.unit for r in readings_of(name, columns))
    return f"{name} [{unit}]" if unit and not named else name


def _read_labels(
    header: Header, labels: list[str], line: int, options: Options, units: Sequence[str]
) -> None:
    """Add the columns of the labels to the header, and all mistakes."""
    targets = _meanings(labels, options.mapping)
    ignored = _meanings(labels, {name: name for name in options.ignore})
    for index, (label, target) in enumerate(zip(labels, targets, strict=True)):
        place = str(index + 1)
        if not (label or target or ignored[index]):
            if not options.ignore_extra:
                header.unnamed.append(index)
        elif ignored[index] or label.lower() in ORIGIN:
            header.ignored.append(label or place)
        else:
            unit = _without_brackets(units[index]) if index < len(units) else ""
            unit = (target and _parts(label)[1]) or unit
            column = HeaderColumn(index, label or place, label, unit=unit)
            try:
                _add_column(header, column, target, options, line)
            except UnitError as error:
                message = str(error).replace(_BY_MAPPING, _author_of(label, options), 1)
                header.mistakes.append(FileMistake(line, column.label, message))

    if options.role == "table":
        present = _keys(labels).union(str(at) for at in range(1, len(labels) + 1))
        known = f"it has {len(labels)}: {', '.join(filter(None, labels))[:_MAX_LISTED]}"
        option_of = dict.fromkeys(options.mapping, "mapping (--column)")
        option_of |= dict.fromkeys(options.ignore, "ignore (--ignore)")
        for name, option in option_of.items():
            if _key(name) not in present and name not in options.optional:
                message = f"is in {option}, but the file has no such column; {known}"
                header.mistakes.append(FileMistake(line, name, message))
    meanings = [target or label for label, target in zip(labels, targets, strict=True)]
    for message in _missing_columns(header, labels, meanings, options):
        header.mistakes.append(FileMistake(line, "header", message))


def _author_of(label: str, options: Options) -> str:
    """Return whether the import or its rig gives a mapped label its meaning, for a message."""
    is_of_rig = not _keys([label]).isdisjoint(map(_key, options.optional))
    return "by the rig" if is_of_rig else _BY_MAPPING


def _counts_columns(cells: Sequence[str]) -> bool:
    """Return whether the cells are 0, 1, 2 and so on, or 1, 2, 3 and so on."""
    texts = [cell.strip() for cell in cells]
    counts = ([str(first + at) for at in range(len(texts))] for first in (0, 1))
    return len(texts) > 1 and texts in counts


def _add_column(
    header: Header, bare: HeaderColumn, target: str, options: Options, line: int
) -> None:
    """Add the column of a label, with the file's unit, or of its target in the mapping."""
    if header.preamble and (kind := _BOOKKEEPING.fullmatch(bare.label)):
        header.ignored.append(bare.label)
        if kind[0].lower().startswith("status"):
            header.status = bare
        elif kind[0].lower().startswith("rdt"):
            header.sequence = bare
        return

    columns = options.columns
    text = (target or bare.label).strip()
    sign = -1.0 if target and text.startswith("-") else 1.0
    text = text.removeprefix("-") if target else text
    if target and text.startswith("-"):
        raise UnitError(f"has two minus signs; write {text} for the opposite sign")
    if text.startswith("-") and readings_of(text, columns):
        name = text.lstrip("- ")
        raise UnitError(
            f"has a minus sign; map it with mapping (--column '{text}=-{name}' if its values have "
            f"the opposite sign of {name}, else --column '{text}={name}')"
        )

    try:
        name, unit, factor = _reading(
            text, bare.unit, header.preamble, columns, mapped=bare.label if target else ""
        )
    except _UnknownColumnError:
        if not options.ignore_extra or target:
            raise
        header.ignored.append(bare.label)
        return
    if sign < 0 and name not in (*columns.loads, *columns.displacement):
        raise UnitError(f"only loads and displacements take a minus sign, not {name}; write {text}")
    if name in header.columns:
        message = _repeated(name, header.columns[name], bare)
        header.mistakes.append(FileMistake(line, bare.label, message))
    zero = columns.zero(name, unit)
    header.columns[name] = HeaderColumn(bare.index, bare.label, name, factor * sign, unit, zero)


def _repeated(name: str, first: HeaderColumn, second: HeaderColumn) -> str:
    """Return a message on two columns of one meaning."""
    if _key(first.label) != _key(second.label):
        also = quoted(first.label)
        return f"{name} is there twice, also as {also}; leave one out with ignore (--ignore)"
    return (  # the label would leave both out
        f"columns {first.index + 1} and {second.index + 1} are both {second.label}; rename one of "
        "them in the file, or leave one out by its number with ignore "
        f"(--ignore {second.index + 1})"
    )


def _reading(
    label: str, below: str, preamble: Preamble, columns: Columns, mapped: str = ""
) -> Reading:
    """Return name, unit and factor of a label with a unit below it; raises UnitError.

    `mapped`: the file's label to which the mapping gives `label` as meaning.
    """
    problem: UnitError | None = None
    fits: dict[str, Reading] = {}
    meanings = list(columns.readings(label))
    for name, written, factor in meanings:
        if name in TEXTS:
            return Reading(name, "", 1.0)
        unit, count = _unit_and_count(name, written or below, preamble)
        if not unit and name != TIME_COLUMN:
            example = columns.examples(name)
            if mapped:
                example += f" (--column '{_parts(mapped)[0]}={example.split(', ')[0]}')"
            problem = problem or UnitError(f"has no unit; write for example {example}")
            continue
        try:
            si = columns.factor(name, unit) if unit else 1.0
        except UnitError as error:
            problem = problem or error
            continue
        fits.setdefault(name, Reading(name, unit, si / count * factor))

    if len(fits) == 1:
        return next(iter(fits.values()))
    if len(fits) > 1:
        names = sorted(fits)
        example = f"--column '{label}={names[0]} [{fits[names[0]].unit}]'"
        raise UnitError(f"can mean {' or '.join(names)}; choose one, for example with {example}")
    # With brackets, or as a bare name, the label is a column and its unit is the mistake.
    if problem and (split(label)[1] or any(not meaning.unit for meaning in meanings)):
        raise problem
    name, unit = _parts(label)
    if mapped:
        unknown = _unknown_meaning(label, mapped, columns)
    else:
        unknown = _unknown(name, unit or below, columns)
    raise _UnknownColumnError(columns.interface_problem(name) or unknown)


class _UnknownColumnError(UnitError):
    """The label names no column of a table."""


def _parts(label: str) -> tuple[str, str]:
    """Return the name of a label and the unit in brackets at its end; empty if there is none."""
    try:
        return split(label)
    except UnitError:
        return label, ""


def _key(label: str) -> str:
    return " ".join(label.split()).lower()


def _unit_and_count(name: str, unit: str, preamble: Preamble) -> tuple[str, float]:
    """Return a column's unit, by the preamble if it has none, and the counts in a unit.

    The form of a clock's times, such as hh:mm:ss, is no unit.
    """
    if not unit:
        return preamble.unit_of(name) or ("", 1.0)
    is_clock = name == TIME_COLUMN and _CLOCK_FORM.search(unit)
    return "" if is_clock else unit, 1.0


def _keys(labels: Sequence[str]) -> set[str]:
    """Return the keys of labels, with and without their units."""
    return {_key(key) for label in labels for key in (label, _parts(label)[0])}


def _unknown(name: str, unit: str, columns: Columns) -> str:
    """Return a message on an unknown column with the nearest known one and an example of its unit.

    A text column is near only by a slip of letters: Force is no source.
    """
    near = difflib.get_close_matches(name.lower(), columns.numbers, n=1, cutoff=0.6)
    near = near or difflib.get_close_matches(name.lower(), TEXTS, n=1, cutoff=_SLIP)
    hint = f"; did you mean {near[0]}?" if near else ""
    if near and not unit and near[0] not in TEXTS:
        hint += f" Write units in brackets: {columns.examples(near[0]).split(', ')[0]}"
    return (
        f"is not a known column{hint}. Rename it, map it with mapping (--column "
        f"'{name}={columns.example_in(unit, name)}'), or skip it with ignore (--ignore "
        f"'{name}'). Known are {' '.join(columns.wrench)} {' '.join(columns.displacement)}"
    )


def _unknown_meaning(meaning: str, mapped: str, columns: Columns) -> str:
    """Return a message on a mapping's meaning that is not a known column, with the nearest one."""
    name, unit = _parts(meaning)
    near = difflib.get_close_matches(name.lower(), (*columns.numbers, *TEXTS), n=1, cutoff=0.6)
    column = near[0] if near else columns.loads[0]
    written = f"{column} [{unit}]" if unit else column
    hint = "Did you mean" if near else "Write for example"
    return (
        f"has the meaning '{meaning}' {_BY_MAPPING}, which is not a known column. {hint} "
        f"--column '{_parts(mapped)[0]}={written}'{'?' if near else ''}"
    )


def _missing_of_profile(named: set[str], labels: Sequence[str], options: Options) -> Iterator[str]:
    """Yield a message on each load that a profile names and the file lacks: it is not zero."""
    present = _keys(labels)
    columns = options.columns
    for load in columns.loads:
        others = [
            label
            for label in options.mapping.keys() & {*options.optional}
            if load in (r.column for r in readings_of(options.mapping[label].lstrip("- "), columns))
        ]
        if others and load not in named and present.isdisjoint(map(_key, others)):
            yield (
                f"there is no column for {load}, called {' or '.join(sorted(others))} by the rig; "
                f"name it with mapping (--column 'LABEL={load}'), or choose another profile"
            )


def _missing_outputs(header: Header, named: set[str], columns: Columns) -> Iterator[str]:
    """Yield a message on each uncertainty of an output without a column, if others have one."""
    if named.isdisjoint(columns.displacement):
        return
    for name, error in zip(columns.displacement, columns.uncertainty, strict=True):
        if error in header.columns and name not in named:
            label = header.columns[error].label
            yield (
                f"there is no column for {name}, whose uncertainty is in {quoted(label)}; add it, "
                f"or skip the uncertainty with ignore (--ignore '{label}')"
            )


def _missing_columns(
    header: Header, labels: list[str], meanings: list[str], options: Options
) -> Iterator[str]:
    """Yield messages on missing columns: a load, a displacement, a time.

    `meanings`: of each label, by the mapping or the label itself.
    """
    columns = options.columns
    # A column with a mistake in its unit is not missing.
    known = {*header.ignored, *(column.label for column in header.columns.values())}
    pairs = [pair for pair in zip(labels, meanings, strict=True) if pair[0] not in known]
    read = [readings_of(meaning.lstrip("- "), columns) for _, meaning in pairs]
    mistaken = {reading.column for readings in read for reading in readings}
    # A meaning with a slip may be any column.
    has_slip = any(
        label != meaning and not readings
        for (label, meaning), readings in zip(pairs, read, strict=True)
    )
    named = mistaken | set(header.columns)

    has_loads = options.role != "displacements"
    needed = []
    if options.role != "loads":
        needed.append(("displacement", columns.displacement))
        yield from _missing_outputs(header, named, columns)
    if has_loads:
        needed.append(("load", columns.loads))
    for quantity, names in needed:
        if not (named & set(names) or has_slip):
            units = (columns.quantity(name).examples[0] for name in names)
            named_so = ", ".join(map("{} [{}]".format, names, units))
            alone = _ALONE if quantity == "displacement" and options.role == "table" else ""
            yield f"there is no {quantity} column; name at least one of {named_so}{alone}"

    absent = [name for name in columns.loads if name not in named]
    is_partial = 0 < len(absent) < len(columns.loads)
    if is_partial and has_loads and options.missing_loads != "zero":
        out = f" (left out: {', '.join(header.ignored)})" if header.ignored else ""
        yield (
            f"there is no column for {', '.join(absent)}{out}; add one, or if these loads were "
            "zero, set missing_loads=zero (--missing-loads-zero)"
        )
    if has_loads:
        yield from _missing_of_profile(named, labels, options)
        for name in columns.further:
            if name not in named:
                example = f"{name} [{columns.quantity(name).si}]"
                yield f"there is no column for {name}, which every row needs; name it {example}"
    if options.role != "table" and TIME_COLUMN not in named and header.sequence is None:
        yield "there is no column time [s], by which two logs are joined; add it"
