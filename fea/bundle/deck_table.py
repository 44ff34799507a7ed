"""Reading ``[deck]`` of ``component.toml``.

[deck]
file = "plate.inp"               # has $FX $FY $FZ $MX $MY $MZ; its axes are the interface's
command = ["ccx", "{job}"]       # {job} is the deck's name without its ending
output = {reader = "calculix-dat", point = "REF", rotation = "ROT"}
files = ["mesh.inp"]             # optional: other files of the bundle that it needs
unit = "mm"                      # optional: the deck's length unit; "m" if left out
timeout = 600                    # optional: seconds a run may take; 3600 if left out
moment = "conjugate"             # optional: or "spatial"; what the reader's solver takes
"""

from __future__ import annotations

from pathlib import Path

from wrenchbook.fea.readers.reader import DeckReader
from wrenchbook.fea.readers.registry import reader_named, reader_names
from wrenchbook.fea.spec.schema import MOMENTS, UNITS, Deck
from wrenchbook.fea.spec.toml_table import Keys, bundle_file

_LONGEST = 1e7  # seconds


def read_deck(keys: Keys | None, folder: Path) -> Deck | None:
    """Return ``[deck]``."""
    if keys is None:
        return None
    file = bundle_file(keys, "file", folder)
    command = keys.texts("command", least=1, repeats=True)
    output = keys.table("output")
    reader, options = (None, {}) if output is None else _output(output)
    # The further files; all are put into one folder, so none may be in a subfolder.
    names = keys.texts("files", required=False) or ()
    found = []
    for i, name in enumerate(names):
        key = f"files[{i}]"
        if Path(name).name != name:
            keys.wrong(key, f'"{name}" is not directly in the bundle\'s folder; put it there')
        elif file is not None and name == file.name:
            keys.wrong(key, "is the deck itself; leave it out")
        else:
            each = bundle_file(Keys({key: name}, keys.problems, keys.where), key, folder)
            found += [] if each is None else [each]
    files = tuple(found)
    unit = keys.choice("unit", tuple(UNITS), required=False) or "m"
    timeout = keys.number("timeout", "s", above=0.0, below=_LONGEST, required=False)
    moment = keys.choice("moment", MOMENTS, required=False)
    keys.close()
    if file is None or command is None or reader is None:
        return None
    moment = moment or reader.moment
    return Deck(file, command, options, files, unit, timeout or 3600.0, moment)


def _output(keys: Keys) -> tuple[DeckReader | None, dict[str, str]]:
    name = keys.choice("reader", reader_names())
    if name is None:
        return None, {}
    reader = reader_named(name)
    read = {key: keys.text(key) for key in reader.keys}
    keys.close()
    return reader, {"reader": name} | {key: each for key, each in read.items() if each is not None}
