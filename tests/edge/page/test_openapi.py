"""static/openapi.json: every route and order, as the page and the daemon take them."""

import inspect
import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from edge.core.errors import RequestError
from edge.page.access import NEEDS
from edge.page.app import API, STATIC
from edge.page.openapi import BODIES, DOCUMENTS, PARAMETERS, openapi
from edge.tick.orders import ORDERS, Desk, Operation, operate
from tests.support.page_process import page_of

FILE = STATIC / "openapi.json"
DESK = Desk(0.0, ("MPC",), 15.0, 38.0)


def orders_schema() -> dict[str, Any]:
    found: dict[str, Any] = openapi()["paths"]["/api/order"]["post"]["requestBody"]
    return dict(found["content"]["application/json"]["schema"])


def test_the_file_is_the_one_that_the_routes_give() -> None:
    written = "python -m edge.page.openapi > edge/page/static/openapi.json"
    assert json.loads(FILE.read_text()) == json.loads(json.dumps(openapi())), written


def test_it_names_every_parameter_and_every_value_of_a_body() -> None:
    for _, path, _, handler in API:
        if path == "/api/order":
            continue  # has its own test
        source = inspect.getsource(handler)
        asked = set(re.findall(r'(?:number|text)\(.*?"(\w+)"', source))
        asked |= set(re.findall(r'given\.get\("(\w+)"', source))
        assert asked <= PARAMETERS.get(path, {}).keys() | BODIES.get(path, {}).keys(), path


def test_every_order_that_the_page_passes_on_is_described_once() -> None:
    kinds = [each["properties"]["do"]["const"] for each in orders_schema()["oneOf"]]
    assert kinds == list(NEEDS)


@pytest.mark.parametrize(
    ("order", "is_good"),
    [
        ({"do": "set_mode", "mode": "heat"}, True),
        ({"do": "set_mode", "mode": "bake"}, False),
        ({"do": "set_reference", "reference_c": None}, True),
        ({"do": "set_manual", "heater_duty": 1.5}, False),
        ({"do": "maintenance"}, False),
        ({"do": "maintenance", "minutes": 15}, True),
        ({"do": "start_profile", "profile": {"name": "a", "times_s": [0], "targets_c": [20]}}, True),
        ({"do": "start_profile", "profile": {"name": "a", "times_s": [0], "targets_c": [200]}}, False),
        ({"do": "start_profile", "profile": {"times_s": [0], "targets_c": [20]}}, False),
    ],
)
def test_schema_and_daemon_agree_on_an_order(order: dict[str, Any], is_good: bool) -> None:
    try:
        jsonschema.validate(order, orders_schema())
        described = True
    except jsonschema.ValidationError:
        described = False
    try:
        operate(Operation("MPC"), order, DESK)
        obeyed = True
    except RequestError:
        obeyed = False
    assert (described, obeyed) == (is_good, is_good)


def test_the_keys_of_orders_are_those_of_their_documents() -> None:
    for each in orders_schema()["oneOf"]:
        kind = each["properties"]["do"]["const"]
        document = DOCUMENTS.get(kind) or (ORDERS[kind].keys if kind in ORDERS else None)
        if document is not None:
            assert len(each["properties"]) == 1 + len(document.__dataclass_fields__)


def test_a_page_serves_it_to_anybody(tmp_path: Path) -> None:
    with page_of(tmp_path) as page:
        assert page.client(None).get("/openapi.json").json()["openapi"] == "3.1.0"
