"""Bytes of wrenches and rows: canonical packing, content keys and seals, and records as arrays."""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from hashlib import blake2b
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from wrenchbook.service.ledger.records import LedgerRow, NotedRows, Vector
from wrenchbook.surrogate.table.rows import Rows
from wrenchbook.surrogate.table.space import Space

_log = logging.getLogger(__name__)

_NAN = np.float64(np.nan)
KEY_BYTES = 16  # of a row's key and a record's seal: 128 bits of BLAKE2b
# Rows of one record: 100 KB or so, read and written in well under a millisecond. To read a single
# row, its complete record is read.
MAX_COUNT = 1000
MIN_NUMBERS = 6  # of a packed vector: the loads of one interface
_COLUMNS = "wrench", "displacement", "compliance", "curvature", "uncertainty"


def pack_vector(values: Sequence[float]) -> bytes:
    """Return the canonical bytes of a wrench: little-endian float64, no minus zero.

    Raises ValueError if there are fewer than six numbers or one is not finite.
    """
    if len(values) < MIN_NUMBERS:
        raise ValueError(f"a wrench needs 6 or more numbers, not {len(values)}")
    floats = [float(value) + 0.0 for value in values]
    if not all(map(math.isfinite, floats)):
        raise ValueError(f"the wrench must be finite, not {floats}")
    return struct.pack(f"<{len(floats)}d", *floats)


def unpack_vector(packed: bytes) -> Vector:
    """Return the floats of `pack_vector`."""
    return struct.unpack(f"<{len(packed) // 8}d", packed)


def packed(wrenches: np.ndarray) -> list[bytes]:
    """Return the packed form of each wrench (n, inputs), N and N·m; every NaN is the same NaN."""
    return np.frombuffer(_plain(wrenches).tobytes(), f"V{8 * wrenches.shape[1]}").tolist()


def unpacked(wrenches: Iterable[bytes], inputs: int = MIN_NUMBERS) -> np.ndarray:
    """Return packed wrenches as an array of shape (n, inputs), N and N·m."""
    return np.frombuffer(b"".join(wrenches), dtype="<f8").reshape(-1, inputs).astype(float)


def content_key(*parts: bytes) -> bytes:
    """Return 16 bytes that are equal only for equal parts."""
    return blake2b(b"".join(map(_part, parts)), digest_size=KEY_BYTES).digest()


def key_hashes(keys: bytes) -> np.ndarray:
    """Return the first 8 bytes of each key as an integer, for `row_keys`, shape (n,)."""
    return np.frombuffer(keys, ">i8")[::2].astype(np.int64)


class Record(NamedTuple):
    """A record of the ledger's table `rows`: consecutive rows of one setup, source and note.

    Bytes of `wrench` to `uncertainty` and of `key` are those of the rows, one after the other; None
    where no row has the column. The key of a row leaves out columns that a table file may lack; the
    seal covers them too.
    """

    seq: int  # number of the first row
    count: int  # number of rows, named as the column  # pyright: ignore[reportIncompatibleMethodOverride]
    component: str
    fingerprint: str
    source: str
    wrench: bytes
    displacement: bytes
    compliance: bytes | None
    curvature: bytes | None
    uncertainty: bytes | None
    job: int | None
    created: float
    origin: str
    key: bytes
    seal: bytes

    def part(self, first: int, end: int) -> Record:
        """Return the rows from position `first` to `end`; a wrong seal stays wrong."""
        part = self._slice(first, end)
        return part._replace(seal=part.computed_seal()) if self.is_sealed() else part

    def _slice(self, first: int, end: int) -> Record:
        """Return the rows from position `first` to `end` under the seal of all."""
        columns = {}
        for name in (*_COLUMNS, "key"):
            content = getattr(self, name)
            if isinstance(content, bytes):  # not so in a damaged record, and where no row has any
                content = _cut(content, first, end, self.count)
            columns[name] = content
        return self._replace(seq=self.seq + first, count=end - first, **columns)

    def computed_seal(self) -> bytes:
        """Return 16 bytes over the keys and the columns that keys leave out."""
        parts = [self.key, self.compliance or b"", self.origin.encode()]
        if self.curvature is not None:  # rows of version 0.2 have none
            parts.append(self.curvature)
        return content_key(*parts)

    def is_sealed(self) -> bool:
        """Return whether keys, compliance, curvature and note are as they were written."""
        try:
            return self.computed_seal() == self.seal
        except (ValueError, TypeError, AttributeError):  # values of another type
            return False

    def rekeyed(self) -> Record:
        """Return the record with recomputed keys, if the seal confirms them, else unchanged."""
        if self.is_sealed():
            return self
        try:
            record = self._replace(key=b"".join(self._computed_keys()))
        # Values of another type, or a wrong length.
        except (ValueError, TypeError, AttributeError, ArithmeticError):
            return self
        return record if record.is_sealed() else self

    def _computed_keys(self) -> list[bytes]:
        texts = [(self.fingerprint, self.source)] * self.count
        return _keys(self.component, texts, self.wrench, self.displacement, self.uncertainty)

    def keys(self) -> list[bytes]:
        """Return the stored key of each row."""
        return [self.key[at : at + KEY_BYTES] for at in range(0, len(self.key), KEY_BYTES)]

    def sound(self) -> list[bool]:
        """Return for each row whether it is as it was written."""
        try:
            if self.is_sealed():
                pairs = zip(self._computed_keys(), self.keys(), strict=True)
                return [present == written for present, written in pairs]
        except (ValueError, TypeError, AttributeError):
            pass  # a value of another type or length
        return [False] * self.count

    def row(self, seq: int) -> LedgerRow:
        """Return one of the rows, undamaged."""
        row = self._slice(seq - self.seq, seq - self.seq + 1)
        wrench = unpack_vector(row.wrench)
        flat = _unpacked_if_known(row.compliance) or ()
        lines = [flat[k : k + len(wrench)] for k in range(0, len(flat), len(wrench))]
        return LedgerRow(
            seq=seq,
            component=row.component,
            fingerprint=row.fingerprint,
            source=row.source,
            wrench=wrench,
            displacement=unpack_vector(row.displacement),
            compliance=tuple(lines) or None,
            uncertainty=_unpacked_if_known(row.uncertainty),
            job=row.job,
            created=row.created,
            origin=row.origin,
            curvature=_unpacked_if_known(row.curvature),
        )


def row_keys(component: str, block: NotedRows) -> list[bytes]:
    """Return the content key of each row.

    Compliance and curvature are left out: a table that comes back from a file without them is still
    the same table.

    Raises ValueError for an infinite tangent.
    """
    rows = block.rows
    if any(rows.compliance.strides) and (infinite := np.isinf(rows.compliance)).any():
        at, output, load = np.argwhere(infinite)[0].tolist()
        entry = f"compliance[{output}][{load}] of row {at + 1} of {len(rows)}"
        raise ValueError(f"{entry} is infinite; write NaN where it is unknown")
    texts = list(zip(rows.fingerprint.tolist(), rows.source.tolist(), strict=True))
    numbers = _plain(rows.wrench).tobytes(), _plain(rows.displacement).tobytes()
    return _keys(component, texts, *numbers, _known(rows.uncertainty, np.any))


def records_of(
    component: str,
    block: NotedRows,
    keys: Sequence[bytes],
    first: int,
    now: float,
    job: int | None = None,
) -> Iterator[Record]:
    """Yield rows as records, numbered from `first`."""
    rows, total = block.rows, len(block.rows)
    texts = list(zip(rows.fingerprint.tolist(), rows.source.tolist(), block.note, strict=True))
    wrench, displacement = _plain(rows.wrench).tobytes(), _plain(rows.displacement).tobytes()
    compliance, curvature = _known(rows.compliance, np.all), _known(rows.curvature, np.all)
    uncertainty = _known(rows.uncertainty, np.any)
    for start, end in _stretches(texts):
        fingerprint, source, note = texts[start]
        record = Record(
            seq=first + start,
            count=end - start,
            component=component,
            fingerprint=fingerprint,
            source=source,
            wrench=_cut(wrench, start, end, total),
            displacement=_cut(displacement, start, end, total),
            compliance=_cut_if_known(compliance, start, end, total),
            curvature=_cut_if_known(curvature, start, end, total),
            uncertainty=_cut_if_known(uncertainty, start, end, total),
            job=job,
            created=now,
            origin=note,
            key=b"".join(keys[start:end]),
            seal=b"",
        )
        yield record._replace(seal=record.computed_seal())


def _stretches(texts: Sequence[tuple[str, ...]]) -> Iterator[tuple[int, int]]:
    """Yield start and end of each stretch of equal texts, at most `MAX_COUNT` long."""
    start = 0
    for end in range(1, len(texts) + 1):
        if end == len(texts) or end == start + MAX_COUNT or texts[end] != texts[start]:
            yield start, end
            start = end


def numbers_of(records: Sequence[Record]) -> np.ndarray:
    """Return the seq of each row of the records."""
    firsts = np.array([record.seq for record in records], dtype=np.int64)
    counts = np.array([record.count for record in records], dtype=np.int64)
    before = np.cumsum(counts) - counts
    return np.repeat(firsts - before, counts) + np.arange(counts.sum())


def noted_rows(
    records: Sequence[Record],
    wanted: np.ndarray,
    space: Space,
    fingerprint: str | None,
    damaged: dict[int, str],
) -> NotedRows:
    """Return the `wanted` of the rows of the records, without damaged ones.

    `fingerprint`: the setup whose rows and measured rows are returned; all rows if None. Damaged
    rows are added to `damaged`, by number with their component, and logged once.

    Raises ValueError if a row is of another space.
    """
    sound = np.array([*chain.from_iterable(record.sound() for record in records)], dtype=bool)
    _note_damaged(records, wanted & ~sound, damaged)
    counts = [record.count for record in records]
    setup = [fingerprint is None or record.fingerprint in ("", fingerprint) for record in records]
    wanted = wanted & sound & np.repeat(np.array(setup, dtype=bool), counts)
    # Records without a wanted row may be of an earlier space: they are left out.
    before = np.concatenate(([0], np.cumsum(wanted)))
    remaining = np.diff(before[[0, *np.cumsum(counts)]]).tolist()
    wanted = wanted[np.repeat(remaining, counts) > 0]
    records = [record for record, number in zip(records, remaining, strict=True) if number]
    _check_space(records, space)
    return _unpacked_rows(records, wanted, [number for number in remaining if number], space)


def _note_damaged(
    records: Sequence[Record], damaged_rows: np.ndarray, damaged: dict[int, str]
) -> None:
    """Add the rows of the mask `damaged_rows` to `damaged`, and log the new ones."""
    if not damaged_rows.any():
        return
    components = np.array([record.component for record in records], dtype=object)
    names = np.repeat(components, [record.count for record in records])[damaged_rows]
    for seq, name in zip(numbers_of(records)[damaged_rows].tolist(), names, strict=True):
        if seq not in damaged:
            _log.error("row %d of %s is damaged on the disk and left out", seq, name)
        damaged[seq] = name


def _check_space(records: Sequence[Record], space: Space) -> None:
    """Raise ValueError if a record's rows are of another space."""
    inputs, outputs = len(space.inputs), len(space.outputs)
    for record in records:
        loads = len(record.wrench) // 8 // record.count
        moves = len(record.displacement) // 8 // record.count
        if (loads, moves) != (inputs, outputs):
            raise ValueError(
                f"row {record.seq} of {record.component!r} has {loads} loads and {moves} "
                f"displacements, but the component now has {inputs} and {outputs}. Put the "
                f"component's earlier files back, or DELETE /v1/components/{record.component}"
                f"/table/{record.seq}"
            )


def _unpacked_rows(
    records: Sequence[Record], wanted: np.ndarray, counts: Sequence[int], space: Space
) -> NotedRows:
    """Return the `wanted` of the rows of the records, `counts` of each."""
    inputs, outputs = len(space.inputs), len(space.outputs)

    def numbers(name: str, width: int) -> np.ndarray:
        blank = np.full(width, np.nan).tobytes()
        columns = ((getattr(record, name) or blank * record.count) for record in records)
        return unpacked(columns, width)[wanted]

    def texts(name: str) -> list[Any]:
        pairs = zip(records, counts, strict=True)
        return [*chain.from_iterable([getattr(record, name)] * count for record, count in pairs)]

    shapes = {
        "compliance": (outputs, inputs),
        "curvature": (space.curvatures,),
        "uncertainty": (outputs,),
    }
    more = {
        name: numbers(name, math.prod(shape)).reshape(-1, *shape)
        for name, shape in shapes.items()
        if any(getattr(record, name) is not None for record in records)
    }
    created = texts("created")
    rows = Rows.of(
        numbers("wrench", inputs),
        numbers("displacement", outputs),
        space,
        seq=numbers_of(records)[wanted],
        fingerprint=texts("fingerprint"),
        source=texts("source"),
        session=created,
        **more,
    )
    return NotedRows(rows, texts("origin"), created)


def _keys(
    component: str,
    texts: Sequence[tuple[str, str]],
    wrenches: bytes,
    displacements: bytes,
    uncertainties: bytes | None,
) -> list[bytes]:
    """Return the key of each row: of component, fingerprint and source, and its numbers."""
    if not texts:
        return []
    name = _part(component.encode())
    width, size = len(wrenches) // len(texts), len(displacements) // len(texts)  # bytes a row
    middle = _length(size)
    unknown = _part(b"")
    hashers = {}
    for fingerprint, source in dict.fromkeys(texts):
        start = name + _part(fingerprint.encode()) + _part(source.encode()) + _length(width)
        hashers[fingerprint, source] = blake2b(start, digest_size=KEY_BYTES)
    loads = np.frombuffer(wrenches, f"V{width}").tolist()
    moves = np.frombuffer(displacements, f"V{size}").tolist()
    tails = [unknown] * len(texts)
    if uncertainties is not None:
        # NaN for an output with unknown uncertainty; 0 would mean exact.
        columns = np.frombuffer(uncertainties, f"V{size}").tolist()
        tails = [unknown if _is_unknown(column) else _part(column) for column in columns]
    keys = []
    for pair, load, move, tail in zip(texts, loads, moves, tails, strict=True):
        hasher = hashers[pair].copy()  # half the time of a new one
        hasher.update(load + middle + move + tail)
        keys.append(hasher.digest())
    return keys


def _plain(numbers: np.ndarray) -> np.ndarray:
    """Return numbers in their stored form: little-endian, no minus zero, one NaN."""
    return np.where(np.isnan(numbers), _NAN, np.asarray(numbers) + 0.0).astype("<f8")


def _known(column: np.ndarray, needed: Callable[..., np.ndarray]) -> bytes | None:
    """Return the bytes of a column, NaN in rows without the numbers `needed`: any, or all.

    None if no row has them.
    """
    if not column.size or (not any(column.strides) and np.isnan(column.flat[0])):
        return None  # a single NaN stands for all
    flat = column.reshape(len(column), -1)
    known = needed(np.isfinite(flat), axis=1)
    return _plain(np.where(known[:, None], flat, _NAN)).tobytes() if known.any() else None


def _cut(column: bytes, start: int, end: int, count: int) -> bytes:
    """Return the rows from position `start` to `end` of a column of `count` rows."""
    return column[len(column) * start // count : len(column) * end // count]


def _cut_if_known(column: bytes | None, start: int, end: int, count: int) -> bytes | None:
    """Return a cut of a column, None where all of its numbers are unknown."""
    cut = b"" if column is None else _cut(column, start, end, count)
    return None if _is_unknown(cut) else cut


def _is_unknown(numbers: bytes) -> bool:
    """Return whether all of the stored numbers are NaN."""
    return numbers == _NAN.tobytes() * (len(numbers) // 8)


def _unpacked_if_known(column: bytes | None) -> Vector | None:
    """Return a row's numbers; None if all are NaN, as in a record of which other rows have some."""
    if not column or np.isnan(np.frombuffer(column)).all():
        return None
    return unpack_vector(column)


def _part(content: bytes) -> bytes:
    """Return the content after its length, so that joined parts are unambiguous."""
    return _length(len(content)) + content


def _length(size: int) -> bytes:
    return size.to_bytes(4, "little")
