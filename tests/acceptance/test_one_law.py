"""One table, one law, one kernel: whoever answers from a table says the same, bit by bit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from functools import cache

import numpy as np
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.acceptance.kinds import KINDS, load, prepare
from tests.acceptance.ways import (
    SUMS,
    WAYS,
    Kind,
    Question,
    Said,
    assert_same_bits,
    body_of,
    compiled,
    kernel,
)
from tests.service.fmu.made import need_compiler
from tests.service.live import served
from tests.service.test_workers import SeveralProcesses, clients_of_each
from tests.surrogate.kernel.kinds import SAME, SIGMA, asked_of, rounding_of, size_of
from wrenchbook.service.client import ProblemError, Scene, Table
from wrenchbook.service.fmu.export import make_fmu
from wrenchbook.service.ops.backup import back_up
from wrenchbook.service.ops.restore import restore
from wrenchbook.surrogate.build import build
from wrenchbook.surrogate.packed.writer import packed_of
from wrenchbook.surrogate.solver_error import SolverError
from wrenchbook.surrogate.table.hdf5 import read_table
from wrenchbook.surrogate.table.rows import Tolerance

SORTS = ("inside", "beyond", "far", "none", "none, negative", "single", "few")
SORTS += ("row", "first row", "near a row")


def wrench_of(sort: str, kind: Kind, random: np.random.Generator) -> np.ndarray:
    """A wrench (n,), SI, of a sort: of the table's range, or at a row of it."""
    span, row = kind.packed.arrays["space/range"], kind.rows
    scale = (span[1] - span[0]) / 2
    parts = random.uniform(-1, 1, len(scale))
    wrench = span.mean(axis=0) + parts * scale
    none = np.zeros(len(scale))
    if sort in ("beyond", "far"):
        return wrench + (4 if sort == "beyond" else 1e8) * parts * scale
    if sort.startswith("none"):
        return none if sort == "none" else -none
    if sort in ("single", "few"):
        acts = random.permutation(len(scale)) < (1 if sort == "single" else random.integers(2, 5))
        return np.where(acts, parts * span[1], random.choice([0.0, -0.0]))
    if len(row) and "row" in sort:
        near = row[0] if sort == "first row" else random.choice(row)
        return near + (1.5e-6 * parts * scale if sort == "near a row" else 0.0)
    return wrench


@pytest.fixture(scope="module")
def kinds(tmp_path_factory) -> Iterator[dict[str, Kind]]:
    """All kinds of table on a server, and on one of two processes with a backup of it."""
    folder = tmp_path_factory.mktemp("law")
    prepare(folder / "one")
    program = compiled(need_compiler(), folder)
    with ExitStack() as stack, ThreadPoolExecutor(1) as pool:
        plain = stack.enter_context(served(folder / "one"))
        load(plain)
        back_up(folder / "one", folder / "whole.backup")
        restore(folder / "whole.backup", folder / "several")
        workers = SeveralProcesses(folder / "several", solvers=0)
        stack.callback(workers.end)
        several = stack.enter_context(clients_of_each(workers))
        result = {name: Kind(name, plain, folder, several, program) for name in KINDS}
        pool.submit(make_fmu, "any", result["clean"].packed)  # which compiles what all have
        for name, one in result.items():
            (folder / name).mkdir()
            for client in several:
                version = client.component(name, wait_s=60)["table_version"]
                assert version == one.table.version
        yield result


@pytest.fixture(scope="module")
def asked(kinds):
    """Questions to a kind by its name, each with what the kernel says."""

    @cache
    def make(name: str) -> list[tuple[Question, Said]]:
        kind, random = kinds[name], np.random.default_rng(len(name))
        few = ("inside", "beyond", "few", "row")
        hows = [(None, None, SORTS), ((1e-6, 1e-5), None, SORTS), ((1e-3, 1e-2), None, few)]
        hows += [(None, method, few) for method in kind.own_methods]
        results = []
        for tolerance, method, sorts in hows:
            wrenches = [wrench_of(sort, kind, random) for sort in sorts]
            question = Question(np.array(wrenches), tolerance, method)
            results.append((question, kernel(kind, question)))
        return results

    return make


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", KINDS)
def test_each_way_to_ask_says_the_same_of_each_kind_of_table_to_the_bit(kinds, asked, name, way):
    for question, expected in asked(name):
        said = WAYS[way](kinds[name], question)
        if said is None:
            continue
        if way in SUMS:
            expected = replace(expected, derivatives=expected.derivatives + 0.0)
            said.derivatives = said.derivatives + 0.0
        assert_same_bits(expected, said)


def test_the_questions_reach_all_that_a_reply_can_say(asked):
    """Else the claim above would be one of few answers."""
    replies = [said for name in KINDS for _, said in asked(name)]
    said = {
        name: {item for reply in replies for item in getattr(reply, name)}
        for name in ("coverage", "within", "methods", "sources")
    }
    assert said["coverage"] == {"covered", "thin", "outside"}
    assert said["within"] == {True, False, None}
    assert said["methods"] >= {"griddata", "additive", "kriging", "linear", "row", "estimate"}
    assert said["sources"] >= {None, "table", "fea", "rig"}
    reasons = " ".join(reason for reply in replies for reason in reply.reasons)
    for words in ("20 degrees or 10 m", "has exactly this wrench", "not measured in any row: ry"):
        assert words in reasons
    for cause in ("table", "mesh", "linearity"):
        assert any(np.nan_to_num(p[cause]).any() for reply in replies for p in reply.parts), cause


@pytest.mark.parametrize("name", KINDS)
def test_a_table_made_of_a_servers_rows_says_what_the_servers_does_to_rounding(kinds, name):
    one = kinds[name]
    path = one.folder / "rows.h5"
    path.write_bytes(one.client.export_table(name, "hdf5"))
    rows, meta = read_table(path)
    again = build(
        rows,
        meta.load_range,
        tolerance=one.table.tolerance and Tolerance(**one.table.tolerance),
        linear=one.packed.meta["provenance"]["linear"],
        solver_error=SolverError.read(one.packed.meta["solver_error"]),
        locked=np.flatnonzero(one.packed.arrays["space/locked"]).tolist(),
    )
    assert again.bars_are_complete == one.packed.arrays["solver/flags"][4]
    near, packed = SAME * size_of(again) + rounding_of(again), packed_of(again)
    for method in (None, *one.own_methods):
        asked = np.concatenate([asked_of(again, 10, 1, span) for span in (0.4, 1.0, 1.3, 4.0)])
        own, result = (table.batch(asked, None, method) for table in (packed, one.packed))
        np.testing.assert_array_equal(result.coverage, own.coverage)
        for ours, theirs, part in ((own[0], result[0], SAME), (own[1], result[1], SIGMA)):
            np.testing.assert_array_equal(np.isnan(theirs), np.isnan(ours))
            apart = np.nan_to_num(np.abs(theirs - ours))
            assert (apart <= near + part * np.nan_to_num(np.abs(ours))).all()


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=3)
@given(part=st.floats(0.1, 1.0), seed=st.integers(0, 2**32 - 1))
def test_a_table_cut_to_a_scene_says_the_same_at_its_wrenches(kinds, name, part, seed):
    one, random = kinds[name], np.random.default_rng(seed)
    span = one.packed.arrays["space/range"]
    acts = random.random(len(span[0])) < 0.6
    acts[random.integers(6)] = True
    low, high = np.minimum(span[0], 0.0) * acts, np.maximum(span[1], 0.0) * acts
    ends = np.stack((low, high)) * part
    need = [one.loads(end) for end in ends]
    scene = Scene({name: needed(*need)})
    cut = one.client.download(name, scene=scene)
    path = one.folder / "scene.wbt"
    cut.save(path)
    opened = Table.open(path)
    for place in random.uniform(0, 1, (4, len(low))):
        wrench = ends[0] + place * (ends[1] - ends[0])
        expected = vars(one.table.answer(**one.loads(wrench))) | {"elapsed_us": None}
        for result in (cut.answer(**one.loads(wrench)), opened.answer(**one.loads(wrench))):
            # repr tells a negative zero, and all digits
            assert strip(repr(vars(result) | {"elapsed_us": None})) == strip(repr(expected))


def needed(low, high):
    """What a scene needs of a component whose loads lie between two."""
    if isinstance(low, dict):
        return {name: needed(low[name], high[name]) for name in low}
    if isinstance(low, list):
        pairs = [list(pair) for pair in zip(low, high, strict=True)]
        return pairs if len(pairs) == 3 else {"force": pairs[:3], "moment": pairs[3:]}
    return [low, high]


def strip(text: str) -> str:
    """A representation without the times that answers took."""
    return re.sub(r"elapsed_us=[\d.]+", "", text)


OTHER_SPELLING = re.compile(r"(?<![A-Za-z0-9])(?:[FM]_[xyz]|[ur]_[xyz]|[FMU][xyz])(?![A-Za-z0-9_])")


@pytest.mark.parametrize("name", KINDS)
def test_every_reply_spells_loads_and_outputs_as_fx_to_mz_and_ux_to_rz(kinds, asked, name):
    kind, url = kinds[name], f"/v1/components/{name}"

    def post(question: Question, place: int, **more: object) -> str:
        body = body_of(kind, question.wrenches[place], question) | more
        return kind.client.call("POST", f"{url}/displacement", orjson.dumps(body)).content.decode()

    texts = [post(one, k, detail=True) for one, _ in asked(name) for k in range(len(one.wrenches))]
    ends = ("", "/coverage", "/compliance")
    texts += [kind.client.call("GET", url + end).content.decode() for end in ends]
    with pytest.raises(ProblemError) as caught:
        post(asked(name)[0][0], SORTS.index("beyond"), on_thin="reject")
    texts.append(str(caught.value.body))
    assert all(OTHER_SPELLING.search(other) for other in ("r_z of M_y", "Fx"))
    for text in texts:
        assert (result := OTHER_SPELLING.search(text)) is None, result


def test_one_bit_a_zeros_sign_or_a_word_is_a_difference():
    """Else the property above would say nothing."""
    said = Said(np.array([[0.0, 1.0, np.nan]]), ["thin"], held=[False], reasons=["few rows"])
    said.parts = [{"mesh": np.array([1.0])}]
    assert_same_bits(said, replace(said))
    for other in (
        {"outputs": np.array([[-0.0, 1.0, np.nan]])},
        {"outputs": np.array([[0.0, np.nextafter(1.0, 2.0), np.nan]])},
        {"outputs": np.array([[0.0, 1.0, 0.0]])},
        {"coverage": ["covered"]},
        {"held": [True]},
        {"reasons": ["no rows"]},
        {"parts": [{"mesh": np.array([2.0])}]},
    ):
        with pytest.raises(AssertionError):
            assert_same_bits(said, replace(said, **other))
