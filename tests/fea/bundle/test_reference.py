"""The reference of the bundle in fea/README.md, held against the reader."""

import re
import tomllib
from dataclasses import MISSING, fields
from pathlib import Path

import pytest

from wrenchbook import fea
from wrenchbook.fea.bundle import read
from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.mesh.generators import GENERATORS
from wrenchbook.fea.readers import _BUILT_IN
from wrenchbook.fea.spec.problems import BundleError
from wrenchbook.fea.spec.toml_table import Keys

PAGE = (Path(fea.__file__).parent / "README.md").read_text(encoding="utf-8")
NAMED_BY_THE_USER = {"mesh.groups", "mesh.regions"}


def reference():
    """Return {table: {key: (unit, default, example)}} as the page has them."""
    text = PAGE.split("## Reference of the bundle", 1)[1].split("\n## ", 1)[0]
    tables = {}
    for part in text.split("\n### ")[1:]:
        title, body = part.split("\n", 1)
        name = title.strip("[]").replace(".NAME", ".*")
        rows = [re.split(r" *\| *", line)[1:-1] for line in body.splitlines() if line[:3] == "| `"]
        tables["" if name == "component.toml" else name] = {
            row[0].strip("`"): tuple(row[1:4]) for row in rows
        }
    return tables


def bundles():
    """Yield bundles that between them go every way through the reader."""
    common = {
        "name": "a",
        "title": "A",
        "supports": {"fixed": ["f"], "sliding": [{}], "bushing": [{}]},
        "interface": {"section": "s"},
        "analysis": {},
        "range": {},
        "tolerance": {},
        "inputs": {"temperature": {}, "acceleration": {}},
    }
    choice = {"near": [0, 0, 0], "plane": "x"}
    meshes = [{"generator": name} for name in GENERATORS]
    meshes += [{"file": "a.msh"}, {}]
    meshes += [{"file": "a.step", "groups": {"g": choice}, "regions": {"r": {"near": [0, 0, 0]}}}]
    for mesh in meshes:
        materials = [{"region": "all"}, {"region": "x", "law": "orthotropic"}]
        yield common | {"mesh": mesh, "material": materials}
    with_mesh = {"mesh": {"file": "a.msh"}, "material": [{"region": "all"}]}
    yield common | with_mesh | {"interface": [{"range": {}}, {}]}
    for reader in _BUILT_IN:
        yield common | {"deck": {"output": {"reader": reader}}}


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """{table: keys that the reader asks for}."""
    (tmp_path / "a.msh").touch()
    (tmp_path / "a.step").touch()
    made = []

    class Watched(Keys):
        def __init__(self, *told, **named):
            super().__init__(*told, **named)
            made.append(self)

        def table(self, key, required=True):
            found = super().table(key, required)
            return found and Watched(found._table, found.problems, found.where)

        def tables(self, key, required=True):
            found = super().tables(key, required)
            return [Watched(one._table, one.problems, one.where) for one in found]

    monkeypatch.setattr(read, "Keys", Watched)
    for bundle in bundles():
        with pytest.raises(BundleError):
            bundle_of(bundle, tmp_path)
    told = {}
    for keys in made:
        where = re.sub(r"\[\d+\]", "", keys.where)
        where = re.sub(r"^mesh\.(groups|regions)\..*", r"mesh.\1.*", where)
        if where not in NAMED_BY_THE_USER:
            told.setdefault(where, set()).update(keys._known)
    return told


def test_the_page_has_every_key_that_is_read_and_no_other(asked):
    page = {name: set(rows) for name, rows in reference().items()}
    assert page == asked


def test_every_example_is_toml():
    for name, rows in reference().items():
        for key, (_, _, example) in rows.items():
            assert re.fullmatch(r"`[^`]+`", example), (name, key)
            assert key in tomllib.loads(f"{key} = {example.strip('`')}")


def test_every_default_is_told_and_those_of_generators_are_theirs():
    tables = reference()
    assert all(default for rows in tables.values() for _, default, _ in rows.values())
    for generator in GENERATORS.values():
        for entry in fields(generator):
            unit, default, _ = tables["mesh"][entry.name]
            assert default == ("-" if entry.default is MISSING else f"`{entry.default}`")
            assert unit == entry.metadata.get("unit", "cells")


def test_what_the_page_says_must_be_there_is_missed(tmp_path):
    """Of the tables that every bundle with a mesh has."""
    tables = reference()
    told = {"mesh": {"generator": "bar"}, "material": [{}]}
    told |= {name: {} for name in ("supports", "interface", "analysis", "range", "tolerance")}
    with pytest.raises(BundleError) as caught:
        bundle_of(told, tmp_path)
    missed = {re.sub(r"\[\d+\]", "", one.where) for one in caught.value.problems}
    for name in ("material", "supports", "interface", "analysis", "range", "tolerance"):
        musts = {f"{name}.{key}" for key, row in tables[name].items() if row[1] == "-"}
        assert musts - {"material.shear_modulus"} <= missed
        assert not {f"{name}.{key}" for key, row in tables[name].items() if row[1] != "-"} & missed
