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
KEY_BYTES = 16
# Rows of one record: 100 KB or so, read and written in well under a millisecond. To read a single
# row, its complete record is read.
MAX_COUNT = 1000
MIN_NUMBERS = 6
"""Smallest number of a packed vector's numbers: those of one interface."""


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
    """Return the first 8 bytes of each of the keys as a number, for `row_keys`."""
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

        def cut(content: Any) -> Any:
            if not isinstance(content, bytes):
                return content
            return content[len(content) * first // self.count : len(content) * end // self.count]

        columns = {name: cut(getattr(self, name)) for name in (*_COLUMNS, "key")}
        return self._replace(seq=self.seq + first, count=end - first, **columns)

    def computed_seal(self) -> bytes:
        """Return 16 bytes over the keys and the columns that keys leave out."""
        parts = self.key, self.compliance or b"", self.origin.encode()
        third = () if self.curvature is None else (self.curvature,)  # rows of version 0.2 have none
        return content_key(*parts, *third)

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
        # In a record of several rows a missing column of this row is NaN.
        compliance, curvature, uncertainty = (
            None if not column or np.isnan(np.frombuffer(column)).all() else unpack_vector(column)
            for column in (row.compliance, row.curvature, row.uncertainty)
        )
        loads, flat = unpack_vector(row.wrench), compliance or ()
        return LedgerRow(
            seq,
            row.component,
            row.fingerprint,
            row.source,
            loads,
            unpack_vector(row.displacement),
            tuple(flat[k : k + len(loads)] for k in range(0, len(flat), len(loads))) or None,
            uncertainty,
            row.job,
            row.created,
            row.origin,
            curvature,
        )


_COLUMNS = "wrench", "displacement", "compliance", "curvature", "uncertainty"


def row_keys(component: str, block: NotedRows) -> list[bytes]:
    """Return the content key of each row.

    Compliance and curvature are left out: a table that comes back from a file without them is still
    the same table.

    Raises ValueError for an infinite tangent.
    """
    rows = block.rows
    if any(rows.compliance.strides) and (infinite := np.isinf(rows.compliance)).any():
        at, output, load = np.argwhere(infinite)[0].tolist()
        place = f"compliance[{output}][{load}] of row {at + 1} of {len(rows)}"
        raise ValueError(f"{place} is infinite; write NaN where it is unknown")
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
    rows, at = block.rows, 0
    texts = list(zip(rows.fingerprint.tolist(), rows.source.tolist(), block.note, strict=True))
    wrench, displacement = _plain(rows.wrench).tobytes(), _plain(rows.displacement).tobytes()
    compliance, curvature = _known(rows.compliance, np.all), _known(rows.curvature, np.all)
    uncertainty = _known(rows.uncertainty, np.any)

    def part(column: bytes) -> bytes:
        width = len(column) // len(rows)
        return column[width * at : width * end]

    def known_part(column: bytes | None) -> bytes | None:
        some = b"" if column is None else part(column)
        return None if some == _NAN.tobytes() * (len(some) // 8) else some

    while at < len(rows):
        last = min(len(rows), at + MAX_COUNT)
        end = next((k for k in range(at, last) if texts[k] != texts[at]), last)
        fingerprint, source, note = texts[at]
        record = Record(
            first + at,
            end - at,
            component,
            fingerprint,
            source,
            part(wrench),
            part(displacement),
            known_part(compliance),
            known_part(curvature),
            known_part(uncertainty),
            job,
            now,
            note,
            b"".join(keys[at:end]),
            b"",
        )
        yield record._replace(seal=record.computed_seal())
        at = end


def numbers_of(records: Sequence[Record]) -> np.ndarray:
    """Return the seq of each row of some records."""
    firsts, counts = (
        np.array([getattr(record, name) for record in records], dtype=np.int64)
        for name in ("seq", "count")
    )
    before = np.cumsum(counts) - counts
    return np.repeat(firsts - before, counts) + np.arange(counts.sum())


def noted_rows(
    records: Sequence[Record],
    wanted: np.ndarray,
    space: Space,
    fingerprint: str | None,
    damaged: dict[int, str],
) -> NotedRows:
    """Return the `wanted` of the rows of some records, without damaged ones.

    `fingerprint`: the setup whose rows and measured rows are returned; all rows if None. Damaged
    rows are added to `damaged`, by number with their component, and logged once.

    Raises ValueError if a row is of another space.
    """
    counts = [record.count for record in records]
    sound = np.array([*chain.from_iterable(record.sound() for record in records)], dtype=bool)
    for seq in numbers_of(records)[wanted & ~sound].tolist():
        record = next(record for record in records if 0 <= seq - record.seq < record.count)
        if seq not in damaged:
            _log.error("row %d of %s is damaged on the disk and left out", seq, record.component)
        damaged[seq] = record.component
    setup = [fingerprint is None or record.fingerprint in ("", fingerprint) for record in records]
    wanted = wanted & sound & np.repeat(np.array(setup, dtype=bool), counts)
    ends = np.cumsum(counts)
    remaining = np.diff(np.concatenate(([0], np.cumsum(wanted)))[[0, *ends]]).tolist()
    wanted = wanted[np.repeat(remaining, counts) > 0]
    records = [record for record, number in zip(records, remaining, strict=True) if number]
    remaining = [number for number in remaining if number]
    inputs, outputs = len(space.inputs), len(space.outputs)
    for record in records:
        loads, moves = (
            len(column) // 8 // record.count for column in (record.wrench, record.displacement)
        )
        if (loads, moves) != (inputs, outputs):
            raise ValueError(
                f"row {record.seq} of {record.component!r} has {loads} loads and {moves} "
                f"displacements, but the component now has {inputs} and {outputs}. Put the "
                f"component's earlier files back, or DELETE /v1/components/{record.component}"
                f"/table/{record.seq}"
            )

    def numbers(name: str, width: int) -> np.ndarray:
        blank = np.full(width, np.nan).tobytes()
        columns = ((getattr(record, name) or blank * record.count) for record in records)
        return unpacked(columns, width)[wanted]

    def texts(name: str) -> list[Any]:
        pairs = zip(records, remaining, strict=True)
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
    rows = Rows.of(
        numbers("wrench", inputs),
        numbers("displacement", outputs),
        space,
        seq=numbers_of(records)[wanted],
        fingerprint=texts("fingerprint"),
        source=texts("source"),
        session=(created := texts("created")),
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
    middle, unknown = _length(size), _part(b"")
    hashers = {
        pair: blake2b(
            name + _part(pair[0].encode()) + _part(pair[1].encode()) + _length(width),
            digest_size=KEY_BYTES,
        )
        for pair in dict.fromkeys(texts)
    }
    loads, moves = (
        np.frombuffer(numbers, f"V{length}").tolist()
        for numbers, length in ((wrenches, width), (displacements, size))
    )
    tails = [unknown] * len(texts)
    if uncertainties is not None:
        # An output with unknown uncertainty is NaN; 0 would mean exact.
        blank = _NAN.tobytes() * (size // 8)
        each = np.frombuffer(uncertainties, f"V{size}").tolist()
        tails = [unknown if tail == blank else _part(tail) for tail in each]
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


def _part(content: bytes) -> bytes:
    return _length(len(content)) + content


def _length(size: int) -> bytes:
    return size.to_bytes(4, "little")
