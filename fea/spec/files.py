"""Files that a bundle names: each must exist and lie within its folder."""

from __future__ import annotations

from pathlib import Path

from wrenchbook.fea.spec.toml_table import Keys


def bundle_file(keys: Keys, key: str, folder: Path, required: bool = True) -> Path | None:
    """Return the path of a file of the bundle that exists and lies within its folder."""
    name = keys.text(key, required)
    if name is None:
        return None
    path = folder / name
    # Resolved, so that a symbolic link out of the folder is refused too.
    if Path(name).is_absolute() or not path.resolve().is_relative_to(folder.resolve()):
        keys.wrong(key, f'"{name}" is outside the bundle; put the file into its folder')
        return None
    try:
        there = path.is_file()
    except OSError as error:  # a name that no disk takes
        keys.wrong(key, f'"{name[:100]}" cannot be a file ({error.strerror})')
        return None
    if not there:
        known = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
        keys.wrong(key, f'there is no file "{name}" in the bundle (it has {", ".join(known)})')
        return None
    return path
