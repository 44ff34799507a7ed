"""UM-Bridge at /umbridge: the protocol's public conformity suite, its own client, and attacks.

The first part follows, check by check, `testing/protocol_conformity_1.0/test_model_schema.py` of
https://github.com/UM-Bridge/umbridge (MIT license; 22 tests, of which those on features that a
server does not support ask for `UnsupportedFeature`), written anew from what it asks. That the
numbers are those of the other ways to ask is in tests/acceptance/test_one_law.py.
"""

import numpy as np
import orjson
import pytest
from starlette.testclient import TestClient

from tests.service.document import document
from tests.service.live import FULL, add_table, as_rows, full_wrenches, moved, served, tangents
from tests.service.test_http_displacement import load
from wrenchbook.service.http.app import create_app
from wrenchbook.service.workspace import Settings

LOADS = [10.0, 3.0, -20.0, 1.0, 3.0, -2.0]
PRODUCTS = ("Gradient", "ApplyJacobian")
ANSWERS = ("Evaluate", *PRODUCTS)


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A server without solvers whose table nobody makes thicker: one for all that only ask."""
    wrenches = full_wrenches(30)
    with TestClient(create_app(Settings(tmp_path_factory.mktemp("rig"), solvers=0))) as client:
        load(client, "rig", as_rows(wrenches, moved(wrenches), tangents(wrenches)))
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
    reported = reply.json()
    assert reported.keys() == {"error"}
    assert reported["error"].keys() == {"type", "message"}
    assert reported["error"]["type"] == kind
    assert isinstance(reported["error"]["message"], str)
    return reported["error"]["message"]


# --- the public suite


def test_the_suites_model_is_the_first_that_has_rows(rig):
    reply = rig.get("/umbridge/Info")
    assert reply.status_code == 200
    reported = reply.json()
    assert reported.keys() == {"protocolVersion", "models"}
    assert reported["protocolVersion"] == 1.0
    assert reported["models"][0] == "rig"
    assert {"bar", "plate_thin"} <= set(reported["models"])


def test_model_info_names_all_four_features_as_truths(rig):
    features = {"Evaluate": True, "Gradient": True, "ApplyJacobian": True, "ApplyHessian": False}
    assert ask(rig, "ModelInfo", name="rig").json() == {"support": features}


def test_sizes_are_one_vector_of_six_in_and_out(rig):
    assert ask(rig, "InputSizes", name="rig", config={}).json() == {"inputSizes": [6]}
    assert ask(rig, "OutputSizes", name="rig", config={}).json() == {"outputSizes": [6]}


@pytest.mark.parametrize(("call", "shape"), [("Evaluate", (1, 6)), *((p, (6,)) for p in PRODUCTS)])
def test_an_answer_is_lists_of_numbers_and_nothing_else(rig, call, shape):
    reply = ask(rig, call, **body(call))
    assert (reply.status_code, reply.json().keys()) == (200, {"output"})
    assert np.shape(reply.json()["output"]) == shape
    assert all(isinstance(number, int | float) for number in np.ravel(reply.json()["output"]))


CALLS = ("ModelInfo", "InputSizes", "OutputSizes", *ANSWERS, "ApplyHessian")


@pytest.mark.parametrize("call", CALLS)
def test_a_wrong_name_is_told_before_anything_else_is_looked_at(rig, call):
    refused(ask(rig, call, name="wrong_model_name"), "ModelNotFound")
    refused(ask(rig, call, input="?"), "ModelNotFound")


def test_the_hessian_is_told_to_be_unsupported_before_its_fields_are_looked_at(rig):
    refused(ask(rig, "ApplyHessian", name="rig"), "UnsupportedFeature")


WRONG = [  # the call, what is wrong in its fields, and the word of the message
    *(
        (call, {"input": x}, "input")
        for call in ANSWERS
        for x in ([[0.0] * 7], [[0.0] * 5], [], [[0.0] * 6] * 2, [0.0] * 6)
    ),
    *(
        (call, {key: place}, key)
        for call in PRODUCTS
        for key in ("outWrt", "inWrt")
        for place in (1, -1, 0.5, "0", None, True)
    ),
    *(
        (call, {key: vector}, key)
        for call, key in zip(PRODUCTS, ("sens", "vec"), strict=True)
        for vector in ([0.0] * 5, [0.0] * 7, None, "000000", [[0.0] * 6])
    ),
    *(
        ("Evaluate", {"input": [[0.0] * 5 + [x]]}, "input[0][5]")
        for x in ("1", None, True, [1.0], {"a": 1})
    ),
    *(
        ("Evaluate", {"config": x}, "config")
        for x in (
            {"onthin": "wait"},
            {"method": "magic"},
            {"on_thin": "queue"},
            [],
            {"wait_s": -1},
            {"tolerance": 1},
        )
    ),
    (
        "Evaluate",
        {"config": {"tolerance": {"translation": 1e-12, "rotation": 1e-12}}, "input": [[3.0] * 6]},
        "finite-element",
    ),
]


@pytest.mark.parametrize(("call", "fields", "word"), WRONG)
def test_a_field_that_is_wrong_is_invalid_input_and_named(rig, call, fields, word):
    assert word in refused(ask(rig, call, **body(call, **fields)), "InvalidInput")


@pytest.mark.parametrize(
    "raw",
    [b"", b"{", b"[]", b"null", b'{"name":NaN}', b"\xff\xfe", b"[" * 9000, b" " * 70_000],
    ids=["empty", "open", "list", "null", "NaN", "binary", "deep", "huge"],
)
def test_a_body_that_is_no_json_object_is_invalid_input(rig, raw):
    refused(rig.post("/umbridge/Evaluate", content=raw), "InvalidInput")


def test_a_null_config_or_none_is_an_empty_one(rig):
    assert ask(rig, "Evaluate", **body("Evaluate", config=None)).status_code == 200
    fields = body("Evaluate")
    del fields["config"]
    assert ask(rig, "Evaluate", **fields).status_code == 200


@pytest.mark.parametrize("value", [1e300, -1e300, 1e-320, 1.7e308])
def test_a_huge_wrench_or_direction_never_answers_null(rig, value):
    for call in ("Evaluate", "ApplyJacobian"):
        reply = ask(rig, call, **body(call, value, config={"on_thin": "estimate"}))
        assert "null" not in reply.text
        assert reply.status_code in (200, 400, 500)
    reply = ask(rig, "ApplyJacobian", **body("ApplyJacobian", 1.0, vec=[value] * 6))
    assert reply.status_code == 200 or refused(reply, "InvalidInput")
    assert "null" not in reply.text


def test_gradient_is_the_product_with_the_columns_of_the_jacobian(rig):
    """ApplyJacobian's are compared with the kernel's; no other way to ask has this one."""
    fields = {"input": [LOADS], "config": {"on_thin": "estimate"}}
    sens, vec = np.arange(1.0, 7.0).tolist(), np.arange(2.0, 8.0).tolist()
    up = ask(rig, "Gradient", **body("Gradient", sens=sens, **fields)).json()["output"]
    along = ask(rig, "ApplyJacobian", **body("ApplyJacobian", vec=vec, **fields)).json()["output"]
    np.testing.assert_allclose(np.dot(up, vec), np.dot(along, sens), rtol=1e-13)


def test_the_public_client_evaluates_and_differentiates(tmp_path):
    umbridge = pytest.importorskip("umbridge")
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


def test_a_thin_answer_is_solved_by_default_and_never_guessed(http):
    reply = ask(http, "Evaluate", name="plate", input=[[0.0, 0, -8, 0, 0, 0]])
    assert reply.status_code == 200
    np.testing.assert_allclose(reply.json()["output"], [[0, 0, -8e-6, 0, 0, 0]])
    assert reply.headers["Wrenchbook-Coverage"] == "covered"


def test_reject_refuses_it_and_estimate_flags_it_in_a_header(rig):
    fields = {"input": [[9.0, 9, -9, 0.9, 0.9, -0.9]]}  # near the rows: there errors are known
    tolerance = {"translation": 1e-12, "rotation": 1e-12}
    config = {"tolerance": tolerance, "on_thin": "reject"}
    reported = refused(
        ask(rig, "Evaluate", **body("Evaluate", config=config, **fields)), "InvalidInput"
    )
    assert "tolerance" in reported
    config["on_thin"] = "estimate"
    reply = ask(rig, "Evaluate", **body("Evaluate", config=config, **fields))
    assert reply.status_code == 200
    assert reply.headers["Wrenchbook-Coverage"] == "thin"


def test_a_solve_that_outlasts_wait_s_or_fails_is_no_output(http, stand_in):
    fields = {"name": "plate", "input": [[0.0, 0, -8, 0, 0, 0]]}
    stand_in("endless")
    reported = refused(ask(http, "Evaluate", **fields, config={"wait_s": 0}), "InvalidOutput", 500)
    assert "job 1" in reported
    fields["input"][0][2] = -700.0
    assert http.delete("/v1/jobs/1").status_code == 200  # it may not have begun yet
    stand_in("diverges")
    reported = refused(ask(http, "Evaluate", **fields), "InvalidOutput", 500)
    assert "equilibrium" in reported


def test_beyond_the_load_range_nothing_is_solved_unasked(http):
    far = {"name": "plate", "input": [[0.0, 0, -1e9, 0, 0, 0]]}
    assert "load range" in refused(ask(http, "Evaluate", **far), "InvalidInput")
    assert http.get("/v1/jobs").json()["jobs"] == []


def test_a_row_without_a_tangent_has_no_derivative_to_give(http):
    fields = {"name": "plate", "input": [[0.0, 0, -8, 0, 0, 0]], "outWrt": 0, "inWrt": 0}
    reply = ask(http, "Gradient", **fields, sens=[1.0] * 6)
    assert "derivative" in refused(reply, "InvalidOutput", 500)


def test_the_calls_are_in_the_openapi_document_with_their_errors(http):
    paths = document(http)["paths"]
    result = paths["/umbridge/Evaluate"]["post"]
    assert "requestBody" in result
    assert {"200", "400", "500"} == result["responses"].keys()
    assert "ModelNotFound" in str(result["responses"]["400"])
