"""What an export holds of a table that the ledger tells in parts."""

from tests.service.ledger_rows import NewRow, insert
from wrenchbook.service.ledger import Ledger
from wrenchbook.service.ledger.rows import MAX_CHANGES
from wrenchbook.service.library.library import Library
from wrenchbook.service.tables.exporting import ExportRequest, export_table

RANGE = [[-10.0, 10.0]] * 3


def test_an_export_holds_all_rows_of_a_table_larger_than_one_part_of_the_news(tmp_path):
    ledger = Ledger(tmp_path / "ledger.sqlite")
    library = Library(tmp_path / "components", tmp_path / "none")
    library.add_table_only(name="rig", title="rig", range={"force": RANGE, "moment": RANGE})
    count = MAX_CHANGES + 2
    rows = (NewRow((load / count, 0, 0, 0, 0, 0), (load,) * 6) for load in range(count))
    insert(ledger, "rig", "", rows)
    path = tmp_path / "rig.csv"
    version = export_table(ledger, library["rig"], ExportRequest("csv", {}), path)
    assert len(path.read_text().splitlines()) == 1 + count
    assert version == ledger.last_seq("rig")
    ledger.close()
