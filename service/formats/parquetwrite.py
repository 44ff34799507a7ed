"""Write a table as Parquet: float64 in SI, the unit of each column in its name and its metadata."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from service.formats.layout import Layout
from service.formats.parsed import TableRows


def write_parquet(
    path: Path, pieces: Iterable[TableRows], layout: Layout, about: Mapping[str, str]
) -> None:
    """Write pieces of a table, a row group each; `about` becomes the file's metadata."""
    # Imported when it is needed, as in `parquetread`.
    import pyarrow as arrow
    import pyarrow.parquet as parquet

    fields = [
        arrow.field(column.label, arrow.float64(), metadata={"unit": column.unit})
        for column in layout.numbers
    ]
    fields += [arrow.field(name, arrow.string()) for name in layout.texts]
    schema = arrow.schema(fields, metadata={f"wrenchbook:{key}": v for key, v in about.items()})
    with parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        for piece in pieces:
            columns = [
                arrow.array(np.ascontiguousarray(column.values(piece)), from_pandas=True)
                for column in layout.numbers
            ]
            columns += [arrow.array(words, arrow.string()) for words in layout.words(piece)]
            writer.write_table(arrow.Table.from_arrays(columns, schema=schema))
