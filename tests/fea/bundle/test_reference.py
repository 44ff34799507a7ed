"""The reference of component.toml: the page's tables and the JSON schema, made of the models."""

import json
import re
import tomllib

import jsonschema
import pytest

from wrenchbook.fea.bundle.read import bundle_of
from wrenchbook.fea.bundle.reference import PAGE, json_schema, page, tables
from wrenchbook.fea.bundle.shipped import SHIPPED
from wrenchbook.fea.check.commands import main
from wrenchbook.fea.readers import _BUILT_IN
from wrenchbook.fea.spec.keys import extra_of, keys_of
from wrenchbook.fea.spec.problems import BundleError

TEXT = PAGE.read_text(encoding="utf-8")
FIELDS = [
    (heading, key, info)
    for heading, classes in tables().items()
    for cls in classes
    for key, info in keys_of(cls).items()
]


def test_the_page_is_as_the_models_are():
    assert page(TEXT) == TEXT, "not current: run make reference"


def test_the_page_has_the_keys_of_every_reader():
    text = TEXT.split("\n## [deck.output]\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)`", text, re.M)
    assert set(rows) == {"reader"}.union(*(reader.keys for reader in _BUILT_IN.values()))


@pytest.mark.parametrize(("heading", "key", "info"), FIELDS)
def test_each_key_has_an_example_that_its_type_takes(heading, key, info):
    assert key in tomllib.loads(f"{key} = {extra_of(info)['example']}")


def test_what_the_models_require_is_missed(tmp_path):
    reported = {"mesh": {"generator": "bar"}, "material": [{}]}
    names = ("supports", "interface", "analysis", "range", "tolerance")
    with pytest.raises(BundleError) as caught:
        bundle_of(reported | {name: {} for name in names}, tmp_path)
    missed = {re.sub(r"\[\d+\]", "", problem.where) for problem in caught.value.problems}
    for name in ("material", *names):
        cls = tables().get(f"[{name}]", tables().get(f"[[{name}]]"))[0]
        for key, info in keys_of(cls).items():
            assert (f"{name}.{key}" in missed) == info.is_required(), key


SCHEMA = json_schema()


@pytest.mark.parametrize("name", sorted(path.name for path in SHIPPED.iterdir() if path.is_dir()))
def test_the_shipped_components_follow_the_schema(name):
    table = tomllib.loads((SHIPPED / name / "component.toml").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.Draft202012Validator(SCHEMA).validate(table)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"titel": "A"}, "titel"),
        ({"tolerance": {"translation": -1.0, "rotation": 1.0}}, "minimum"),
        ({"material": [{"region": "all", "youngs_modulus": 1.0}]}, "poisson_ratio|not valid under"),
        ({"analysis": {"nonlinear": 1}}, "boolean"),
    ],
)
def test_a_mistake_does_not_follow_the_schema(change, words):
    table = tomllib.loads((SHIPPED / "bar" / "component.toml").read_text(encoding="utf-8"))
    with pytest.raises(jsonschema.ValidationError, match=words):
        jsonschema.Draft202012Validator(SCHEMA).validate(table | change)


def test_check_prints_the_schema_with_descriptions_and_units(capsys):
    assert main(["check", "--schema"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == SCHEMA
    modulus = printed["$defs"]["Material"]["properties"]["youngs_modulus"]
    assert modulus["unit"] == "Pa"
    assert modulus["examples"] == [70e9]
    assert all(
        "description" in value or "$ref" in value or not value.get("examples")
        for each in printed["$defs"].values()
        for value in each.get("properties", {}).values()
    )
