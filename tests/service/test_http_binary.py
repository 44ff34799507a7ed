"""The batch call's binary form, over a real socket and against the JSON form."""

import numpy as np

from tests.service.test_http_displacement import load_plane_table
from wrenchbook.surrogate.kernel.binding import PackedTable

CALL = "/v1/components/plane/displacements"
BINARY = {"content-type": "application/octet-stream"}


def post(http, wrenches, **options):
    content = np.asarray(wrenches, dtype="<f8").tobytes()
    return http.post(
        CALL, params={"on_thin": "estimate", **options}, content=content, headers=BINARY
    )


def test_the_binary_batch_has_the_numbers_of_the_json_batch(http):
    load_plane_table(http)
    wrenches = np.random.default_rng(3).uniform(-14, 14, (50, 6))
    reply = post(http, wrenches)
    assert reply.status_code == 200
    assert reply.headers["content-type"] == "application/octet-stream"
    block = np.frombuffer(reply.content, dtype="<f8").reshape(-1, 13)
    body = {"wrenches": wrenches.tolist(), "on_thin": "estimate"}
    plain = http.post(CALL, json=body).json()
    assert block[:, :6].tolist() == plain["displacements"]
    words = ["covered", "thin", "outside"]
    assert [words[int(code)] for code in block[:, 12]] == plain["coverage"]
    assert set(plain["coverage"]) >= {"covered", "outside"}
    assert int(reply.headers["wrenchbook-table-version"]) == plain["table_version"]


def test_single_answers_both_batches_and_the_downloaded_table_have_the_same_bits(http):
    load_plane_table(http)
    content = http.get("/v1/components/plane/table", params={"format": "packed"}).content
    table = PackedTable.from_bytes(content)
    wrenches = np.random.default_rng(3).uniform(-1.1, 1.1, (21, 6)) * np.repeat([100, 10], 3)
    block = np.frombuffer(post(http, wrenches).content, dtype="<f8").reshape(-1, 13)
    np.testing.assert_array_equal(block, np.column_stack(table.batch(wrenches)))
    plain = http.post(CALL, json={"wrenches": wrenches.tolist(), "on_thin": "estimate"}).json()
    assert plain["displacements"] == block[:, :6].tolist()
    for wrench, expected in zip(wrenches.tolist(), block[:, :6].tolist(), strict=True):
        query = {"force": wrench[:3], "moment": wrench[3:], "on_thin": "estimate"}
        reply = http.post(CALL[:-1], json=query).json()
        assert reply["translation"] + reply["rotation"] == expected


def test_tolerance_and_method_are_query_parameters(http):
    load_plane_table(http)
    wrenches = np.random.default_rng(4).uniform(-5, 5, (20, 6))
    strict = np.frombuffer(post(http, wrenches, translation=1e-30, rotation=1e-30).content).reshape(
        -1, 13
    )
    additive = np.frombuffer(post(http, wrenches, method="additive").content).reshape(-1, 13)
    plain = np.frombuffer(post(http, wrenches).content).reshape(-1, 13)
    assert (strict[:, 12] == 1).any()
    assert not np.array_equal(additive[:, :6], plain[:, :6])


def test_an_empty_binary_batch_is_answered_with_nothing(http):
    load_plane_table(http)
    assert post(http, np.empty((0, 6))).content == b""


def test_what_is_not_covered_can_be_refused(http):
    load_plane_table(http)
    reply = post(http, [[1e6, 0, 0, 0, 0, 0]], on_thin="reject")
    assert reply.status_code == 409
    assert reply.json()["uncovered"] == [0]
