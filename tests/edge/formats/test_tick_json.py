import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.core.messages import Command, Decision
from edge.formats.tick_json import json_value, number, tick_json
from tests.support.mqtt_rig import record

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_null(value):
    assert number(value) is None


def test_a_why_with_numpy_values_and_without_finite_ones_is_still_json():
    why = {
        "cost": np.float64(1.5),
        "gap": math.inf,
        "nodes": np.int64(7),
        "proven": np.bool_(True),
        "plan": np.array([0.5, math.nan]),
        "split": (1.0, [math.nan, {"a": None}]),
        3: "text",
    }
    tick = tick_json(record(decision=Decision(Command(), "MPC", (math.nan, 24.0), why)))
    assert json.loads(json.dumps(tick, allow_nan=False))["why"] == {
        "cost": 1.5,
        "gap": None,
        "nodes": 7,
        "proven": True,
        "plan": [0.5, None],
        "split": [1.0, [None, {"a": None}]],
        "3": "text",
    }


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(), inner),
    )
)
def test_any_value_becomes_json(value):
    json.dumps(json_value(value), allow_nan=False)
