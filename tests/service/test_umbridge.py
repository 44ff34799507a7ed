"""UM-Bridge at /umbridge: the protocol's public conformity suite, its own client, and attacks.

The first part follows, check by check, `testing/protocol_conformity_1.0/test_model_schema.py` of
https://github.com/UM-Bridge/umbridge (MIT license; 22 tests, of which those on features that a
server does not support ask for `UnsupportedFeature`), written anew from what it asks.
"""

import numpy as np
import orjson
import pytest
from starlette.testclient import TestClient

from tests.service.document import document
from tests.service.following import wait_for_version
from tests.service.live import FULL, as_rows, full_wrenches, moved, served, tangents
from tests.service.spaces import SPACE, M, N, add_link
from tests.service.test_http_derivative import load
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

LOADS = [10.0, 3.0, -20.0, 1.0, 3.0, -2.0]


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A server without solvers whose table nobody makes thicker: one for all that only ask."""
    wrenches = full_wrenches(30)
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("rig"), solvers=0))) as client:
        load(client, "rig", wrenches, tangents(wrenches))
        yield client


def ask(http, call, /, **fields):
    """Send a body as the suite does: without a content type."""
    return http.post(f"/umbridge/{call}", content=orjson.dumps(fields))


def body(call, value=0.0, /, **changed):
    fields = {"name": "rig", "input": [[value] * 6], "config": {}}
    if call != "Evaluate":
        fields |= {"outWrt": 0, "inWrt": 0, "sens" if call == "Gradient" else "vec": [value] * 6}
    return fields | changed


def refused(reply, kind, status=400):
    assert reply.status_code == status, reply.text
    told = reply.json()
    assert told.keys() == {"error"}
    assert told["error"].keys() == {"type", "message"}
    assert told["error"]["type"] == kind
    assert isinstance(told["error"]["message"], str)
    return told["error"]["message"]


# --- the public suite


def test_the_suites_model_is_the_first_that_has_rows(rig):
    reply = rig.get("/umbridge/Info")
    assert reply.status_code == 200
    told = reply.json()
    assert told.keys() == {"protocolVersion", "models"}
    assert told["protocolVersion"] == 1.0
    assert told["models"][0] == "rig"
    assert {"bar", "plate_thin"} <= set(told["models"])


def test_model_info_names_all_four_features_as_truths(rig):
    told = ask(rig, "ModelInfo", name="rig").json()
    assert told == {
        "support": {
            "Evaluate": True,
            "Gradient": True,
            "ApplyJacobian": True,
            "ApplyHessian": False,
        }
    }


def test_sizes_are_one_vector_of_six_in_and_out(rig):
    assert ask(rig, "InputSizes", name="rig", config={}).json() == {"inputSizes": [6]}
    assert ask(rig, "OutputSizes", name="rig", config={}).json() == {"outputSizes": [6]}


def test_evaluate_answers_lists_of_numbers_and_nothing_else(rig):
    reply = ask(rig, "Evaluate", **body("Evaluate"))
    assert reply.status_code == 200
    told = reply.json()
    assert told.keys() == {"output"}
    assert np.shape(told["output"]) == (1, 6)
    assert all(type(number) in (int, float) for number in told["output"][0])


@pytest.mark.parametrize("call", ["Gradient", "ApplyJacobian"])
def test_products_answer_one_list_of_numbers_and_nothing_else(rig, call):
    reply = ask(rig, call, **body(call))
    assert reply.status_code == 200
    assert reply.json().keys() == {"output"}
    assert np.shape(reply.json()["output"]) == (6,)


@pytest.mark.parametrize(
    "call",
    [
        "ModelInfo",
        "InputSizes",
        "OutputSizes",
        "Evaluate",
        "Gradient",
        "ApplyJacobian",
        "ApplyHessian",
    ],
)
def test_a_wrong_name_is_told_before_anything_else_is_looked_at(rig, call):
    refused(ask(rig, call, name="wrong_model_name"), "ModelNotFound")
    refused(ask(rig, call, input="?"), "ModelNotFound")


def test_the_hessian_is_told_to_be_unsupported_before_its_fields_are_looked_at(rig):
    refused(ask(rig, "ApplyHessian", name="rig"), "UnsupportedFeature")


@pytest.mark.parametrize("call", ["Evaluate", "Gradient", "ApplyJacobian"])
@pytest.mark.parametrize("input_", [[[0.0] * 7], [[0.0] * 5], [], [[0.0] * 6] * 2, [0.0] * 6])
def test_wrong_dimensions_are_invalid_input(rig, call, input_):
    refused(ask(rig, call, **body(call, input=input_)), "InvalidInput")


@pytest.mark.parametrize("call", ["Gradient", "ApplyJacobian"])
@pytest.mark.parametrize("key", ["outWrt", "inWrt"])
@pytest.mark.parametrize("place", [1, -1, 0.5, "0", None, True])
def test_a_wrong_place_is_invalid_input(rig, call, key, place):
    assert key in refused(ask(rig, call, **body(call, **{key: place})), "InvalidInput")


@pytest.mark.parametrize(("call", "key"), [("Gradient", "sens"), ("ApplyJacobian", "vec")])
@pytest.mark.parametrize("vector", [[0.0] * 5, [0.0] * 7, None, "000000", [[0.0] * 6]])
def test_a_vector_of_wrong_length_is_invalid_input(rig, call, key, vector):
    assert key in refused(ask(rig, call, **body(call, **{key: vector})), "InvalidInput")


# --- what the numbers are


def test_evaluate_and_both_products_are_the_main_calls_numbers(rig):
    asked = {"force": LOADS[:3], "moment": LOADS[3:], "derivatives": True}
    main = rig.post("/v1/components/rig/displacement", json=asked | {"on_thin": "estimate"}).json()
    jacobian, vector = np.array(main["derivative"]), np.arange(1.0, 7.0)
    fields = {"input": [LOADS], "config": {"on_thin": "estimate"}}
    told = ask(rig, "Evaluate", **body("Evaluate", **fields)).json()["output"]
    assert told == [main["translation"] + main["rotation"]]
    up = ask(rig, "Gradient", **body("Gradient", sens=vector.tolist(), **fields)).json()["output"]
    np.testing.assert_allclose(up, jacobian.T @ vector, rtol=1e-14)
    along = ask(rig, "ApplyJacobian", **body("ApplyJacobian", vec=vector.tolist(), **fields)).json()
    np.testing.assert_allclose(along["output"], jacobian @ vector, rtol=1e-14)


def test_the_public_client_evaluates_and_differentiates(tmp_path):
    umbridge = pytest.importorskip("umbridge")
    from tests.service.live import add_table

    wrenches = full_wrenches(30)
    with served(tmp_path) as client:
        add_table(client, "rig", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
        config = {"on_thin": "estimate"}
        url = f"{client.url}/umbridge"
        assert umbridge.supported_models(url)[0] == "rig"
        model = umbridge.HTTPModel(url, "rig")
        assert model.get_input_sizes() == model.get_output_sizes() == [6]
        assert model.supports_gradient()
        assert not model.supports_apply_hessian()
        there = client.displacement("rig", LOADS[:3], LOADS[3:], on_thin="estimate")
        assert model([LOADS], config) == [there.vector.tolist()]
        step = 1e-2 * FULL
        along = model.apply_jacobian(0, 0, [LOADS], step.tolist(), config)
        low, high = (np.array(model([(LOADS + s * step).tolist()], config)[0]) for s in (-1, 1))
        np.testing.assert_allclose(along, (high - low) / 2, atol=1e-3 * np.abs(along).max())
        up = model.gradient(0, 0, [LOADS], [1.0] * 6, config)
        np.testing.assert_allclose(np.dot(up, step), np.sum(along), rtol=1e-12)
        with pytest.raises(Exception, match=r"InvalidInput.*input\[0\]"):
            model([[1.0]])


# --- where the table is too thin


def test_a_thin_answer_is_solved_by_default_and_never_guessed(http):
    reply = ask(http, "Evaluate", name="plate", input=[[0.0, 0, -8, 0, 0, 0]])
    assert reply.status_code == 200
    np.testing.assert_allclose(reply.json()["output"], [[0, 0, -8e-6, 0, 0, 0]])
    assert reply.headers["Wrenchbook-Coverage"] == "covered"


def test_reject_refuses_it_and_estimate_flags_it_in_a_header(rig):
    fields = {"input": [[9.0, 9, -9, 0.9, 0.9, -0.9]]}  # near the rows: there errors are known
    tolerance = {"translation": 1e-12, "rotation": 1e-12}
    config = {"tolerance": tolerance, "on_thin": "reject"}
    told = refused(
        ask(rig, "Evaluate", **body("Evaluate", config=config, **fields)), "InvalidInput"
    )
    assert "tolerance" in told
    config["on_thin"] = "estimate"
    reply = ask(rig, "Evaluate", **body("Evaluate", config=config, **fields))
    assert reply.status_code == 200
    assert reply.headers["Wrenchbook-Coverage"] == "thin"


def test_a_table_that_nobody_can_solve_says_so(rig):
    config = {"tolerance": {"translation": 1e-12, "rotation": 1e-12}}
    told = refused(ask(rig, "Evaluate", **body("Evaluate", 3.0, config=config)), "InvalidInput")
    assert "finite-element" in told


def test_a_solve_that_outlasts_wait_s_or_fails_is_no_output(http, stand_in):
    fields = {"name": "plate", "input": [[0.0, 0, -8, 0, 0, 0]]}
    stand_in("endless")
    told = refused(ask(http, "Evaluate", **fields, config={"wait_s": 0}), "InvalidOutput", 500)
    assert "job 1" in told
    fields["input"][0][2] = -700.0
    assert http.delete("/v1/jobs/1").status_code == 200  # it may not have begun yet
    stand_in("diverges")
    told = refused(ask(http, "Evaluate", **fields), "InvalidOutput", 500)
    assert "equilibrium" in told


def test_beyond_the_load_range_nothing_is_solved_unasked(http):
    far = {"name": "plate", "input": [[0.0, 0, -1e9, 0, 0, 0]]}
    assert "load range" in refused(ask(http, "Evaluate", **far), "InvalidInput")
    assert http.get("/v1/jobs").json()["jobs"] == []


def test_a_row_without_a_tangent_has_no_derivative_to_give(http):
    fields = {"name": "plate", "input": [[0.0, 0, -8, 0, 0, 0]], "outWrt": 0, "inWrt": 0}
    reply = ask(http, "Gradient", **fields, sens=[1.0] * 6)
    assert "derivative" in refused(reply, "InvalidOutput", 500)


def test_an_output_that_was_never_measured_is_named_and_not_guessed(http):
    wrenches = full_wrenches(8)
    told = moved(wrenches)
    told[:, 4] = np.nan
    definition = {"name": "part", "title": "p", "range": {"force": [100] * 3, "moment": [10] * 3}}
    assert http.post("/v1/components", json=definition).status_code == 201
    rows = as_rows(wrenches, told)
    reply = http.post("/v1/components/part/table", json={"rows": rows})
    wait_for_version(http, "part", reply.json()["table_version"])
    config = {"on_thin": "estimate"}
    reply = ask(http, "Evaluate", name="part", input=[LOADS], config=config)
    assert "ry" in refused(reply, "InvalidOutput", 500)


# --- attacks


@pytest.mark.parametrize("number", ["1", None, True, [1.0], {"a": 1}])
def test_what_is_no_number_is_invalid_input(rig, number):
    told = refused(
        ask(rig, "Evaluate", **body("Evaluate", input=[[0.0] * 5 + [number]])), "InvalidInput"
    )
    assert "input[0][5]" in told


@pytest.mark.parametrize(
    "raw", [b"", b"{", b"[]", b"null", b'{"name":NaN}', b"\xff\xfe", b"[" * 9000]
)
def test_a_body_that_is_no_json_object_is_invalid_input(rig, raw):
    refused(rig.post("/umbridge/Evaluate", content=raw), "InvalidInput")


@pytest.mark.parametrize(
    "config",
    [
        {"onthin": "wait"},
        {"method": "magic"},
        {"on_thin": "queue"},
        [],
        {"wait_s": -1},
        {"tolerance": 1},
    ],
)
def test_a_config_that_is_not_understood_is_not_ignored(rig, config):
    assert "config" in refused(
        ask(rig, "Evaluate", **body("Evaluate", config=config)), "InvalidInput"
    )


def test_a_null_config_or_none_is_an_empty_one(rig):
    assert ask(rig, "Evaluate", **body("Evaluate", config=None)).status_code == 200
    fields = body("Evaluate")
    del fields["config"]
    assert ask(rig, "Evaluate", **fields).status_code == 200


def test_a_huge_body_is_refused_in_the_protocols_words(rig):
    refused(rig.post("/umbridge/Evaluate", content=b" " * 70_000), "InvalidInput")


def test_a_product_that_overflows_is_refused(rig):
    fields = body("ApplyJacobian", vec=[1.7e308] * 6, input=[[1.0] * 6])
    reply = ask(
        rig,
        "ApplyJacobian",
        **fields,
    )
    assert reply.status_code == 200 or refused(reply, "InvalidInput")
    assert "null" not in reply.text


def test_a_huge_wrench_never_answers_null(rig):
    for value in (1e300, -1e300, 1e-320):
        reply = ask(rig, "Evaluate", **body("Evaluate", value, config={"on_thin": "estimate"}))
        assert "null" not in reply.text
        assert reply.status_code in (200, 500)


def test_the_calls_are_in_the_openapi_document_with_their_errors(http):
    paths = document(http)["paths"]
    found = paths["/umbridge/Evaluate"]["post"]
    assert "requestBody" in found
    assert {"200", "400", "500"} == found["responses"].keys()
    assert "ModelNotFound" in str(found["responses"]["400"])


WHERE = np.linspace(-0.5, 0.5, N).tolist()
QUERY = {"name": "two_ends", "input": [WHERE], "config": {"on_thin": "estimate"}}
PLACES = {"outWrt": 0, "inWrt": 0}


@pytest.fixture(scope="module")
def link(tmp_path_factory):
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("two_ends"), solvers=0))) as client:
        add_link(client)
        yield client


@pytest.fixture
def table(link):
    return link.app.state.workspace.surrogate("two_ends").packed


def test_sizes_are_the_numbers_of_inputs_and_outputs(link):
    assert ask(link, "InputSizes", name="two_ends").json() == {"inputSizes": [len(SPACE.inputs)]}
    assert ask(link, "OutputSizes", name="two_ends").json() == {"outputSizes": [len(SPACE.outputs)]}


def test_evaluate_gives_the_tables_outputs(link, table):
    found = ask(link, "Evaluate", **QUERY).json()["output"]
    assert found == [list(table.answer(WHERE).outputs)]


def test_products_are_those_with_the_whole_jacobian(link, table):
    jacobian, sens, vec = table.derivative(WHERE), np.arange(1.0, M + 1), np.arange(1.0, N + 1)
    found = ask(link, "Gradient", **QUERY, **PLACES, sens=sens.tolist()).json()["output"]
    np.testing.assert_allclose(found, jacobian.T @ sens, rtol=1e-12)
    found = ask(link, "ApplyJacobian", **QUERY, **PLACES, vec=vec.tolist()).json()["output"]
    np.testing.assert_allclose(found, jacobian @ vec, rtol=1e-12)


@pytest.mark.parametrize("count", [6, N - 1, N + 1])
def test_a_vector_of_another_length_is_invalid_input_with_the_length(link, count):
    query = {**QUERY, "input": [[0.0] * count]}
    message = refused(ask(link, "Evaluate", **query), "InvalidInput")
    assert "input[0]" in message
    assert str(N) in message
