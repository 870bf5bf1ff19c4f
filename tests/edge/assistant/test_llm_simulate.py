"""llm/simulate_tool.py: what is simulated is what the board would do, and a citation is proven."""

from typing import Any

import numpy as np
import pytest
from contexts import context
from hypothesis import given
from hypothesis import strategies as st

from edge.assistant.llm.answer import ModelAnswer
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.ledger import Ledger, ToolError
from edge.assistant.llm.simulate_tool import SAME_K, SimulateTool, Simulator, cited_forecast
from edge.controllers.mpc import pad
from edge.core.messages import Command
from edge.forecasts.scorer import ahead_of
from edge.models.arx_file import read_arx

ARX = read_arx()
HORIZON = 10
TARGETS = np.full(HORIZON, 26.0)


def simulator(offset: float = 0.0) -> Simulator:
    return Simulator(ARX, context(), HORIZON, offset)


def tool() -> SimulateTool:
    return SimulateTool(simulator(), TARGETS)


def asked(duties: list[Any], fans: list[Any]) -> dict[str, Any]:
    return tool().call({"heater_duty": duties, "fan_on": fans})


def answer(duty: float = 0.5, fan: bool = False, cites: str = "simulate-1") -> ModelAnswer:
    return ModelAnswer(Command(heater_duty=duty, fan_on=fan), "", cites)


def ledger(*calls: tuple[list[float], list[bool]]) -> Ledger:
    made = Ledger()
    for duties, fans in calls:
        arguments = {"heater_duty": duties, "fan_on": fans}
        made.record("simulate", arguments, tool().call(arguments))
    return made


def kind_of(given: ModelAnswer, calls: Ledger, by: Simulator | None = None) -> str:
    with pytest.raises(LlmFailure) as caught:
        cited_forecast(given, calls, by or simulator())
    return caught.value.kind


def test_a_simulation_is_the_predictors_rollout() -> None:
    found = asked([0.5, 0.5, 0.0], [False, True, False])
    here = context()
    controls = np.array([[[0.5, 0.0], [0.5, 1.0], *[[0.0, 0.0]] * 8]])
    ahead = ahead_of(here.history, HORIZON, here.step_s) | {"offset": np.zeros(HORIZON)}
    expected = ARX.rollout(pad(here.history, ARX.rows_needed), controls, ahead)[0]
    np.testing.assert_allclose(found["temp_air_c"], expected, atol=SAME_K)
    assert found["mean_abs_error_k"] == pytest.approx(np.abs(expected - 26.0).mean(), abs=1e-4)
    assert found["target_c"] == [26.0] * HORIZON


def test_heat_warms_and_the_fan_cools() -> None:
    idle, heated, cooled = (asked([duty] * 5, [fan] * 5)["temp_air_c"][-1] for duty, fan in
                            ((0.0, False), (1.0, False), (0.0, True)))  # fmt: skip
    assert cooled < idle < heated


def test_the_offset_of_the_estimator_is_added_each_step() -> None:
    controls = np.zeros((HORIZON, 2))
    warmer = simulator(0.05).temperatures(controls) - simulator().temperatures(controls)
    assert warmer[0] == pytest.approx(0.05)
    assert (np.diff(warmer) > 0.0).all()


def test_a_duty_between_levels_is_simulated_as_the_board_takes_it() -> None:
    found = asked([0.52], [False])
    assert found["heater_duty"] == [0.5] * HORIZON
    assert found["temp_air_c"] == asked([0.5], [False])["temp_air_c"]


@pytest.mark.parametrize(
    ("duties", "fans", "same"),
    [
        ([0.5], [False, True], ([0.5] * HORIZON, [False] + [True] * 9)),
        ([0.5, 0.2, 0.0], [True], ([0.5, 0.2] + [0.0] * 8, [True] * HORIZON)),
    ],
)
def test_the_last_value_of_a_list_holds_to_the_horizon(duties: Any, fans: Any, same: tuple[Any, Any]) -> None:
    assert asked(duties, fans) == asked(*same)


@pytest.mark.parametrize(
    ("duties", "fans"),
    [
        *(([], []), ([0.5], []), ([0.5] * 11, [False] * 11), ([0.5], [False] * 11), (0.5, False)),
        *(([1.01], [False]), ([-0.01], [False]), ([0.5], [1])),
    ],
)
def test_controls_that_the_rig_does_not_have_go_back_to_the_model(duties: Any, fans: Any) -> None:
    with pytest.raises(ToolError):
        asked(duties, fans)


def test_a_predictor_that_fails_is_told_of() -> None:
    class Broken:
        name, version, step_s, rows_needed = "broken", "1", 60.0, 1

        def rollout(self, *_: Any) -> Any:
            raise ZeroDivisionError("no")

    with pytest.raises(ToolError, match="broken 1: no"):
        SimulateTool(Simulator(Broken(), context(), HORIZON), TARGETS).call(
            {"heater_duty": [0.5], "fan_on": [False]}
        )


def test_a_cited_simulation_that_begins_with_the_chosen_controls_is_the_forecast() -> None:
    calls = ledger(([0.2, 0.2], [False, False]), ([0.5, 0.1], [True, False]))
    forecast = cited_forecast(answer(0.5, True, "simulate-2"), calls, simulator())
    np.testing.assert_allclose(forecast, calls.entries[1].result["temp_air_c"], atol=SAME_K)


@pytest.mark.parametrize("cites", ["", "simulate-2", "simulate-0", "sql-1", "call_1", "SIMULATE-1"])
def test_a_simulation_that_was_never_asked_for_is_uncited(cites: str) -> None:
    assert kind_of(answer(cites=cites), ledger(([0.5], [False]))) == "uncited"


def test_a_call_of_another_tool_is_no_citation() -> None:
    calls = Ledger()
    calls.record(
        "sql", {"query": "SELECT 1"}, {"heater_duty": [0.5], "fan_on": [False], "temp_air_c": [26.0]}
    )
    assert kind_of(answer(cites="sql-1"), calls) == "uncited"


@pytest.mark.parametrize(("duty", "fan"), [(0.45, False), (0.5, True), (0.0, False)])
def test_controls_other_than_the_simulated_ones_are_unfaithful(duty: float, fan: bool) -> None:
    assert kind_of(answer(duty, fan), ledger(([0.5], [False]))) == "unfaithful"


@pytest.mark.parametrize("wrong", [2 * SAME_K, float("nan")])
def test_a_result_that_does_not_come_out_again_is_unfaithful(wrong: float) -> None:
    calls = ledger(([0.5], [False]))
    calls.entries[0].result["temp_air_c"][0] += wrong
    assert kind_of(answer(), calls) == "unfaithful"


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.booleans()), min_size=1, max_size=HORIZON))
def test_every_simulation_of_real_controls_can_be_cited(steps: list[tuple[float, bool]]) -> None:
    duties, fans = [duty for duty, _ in steps], [fan for _, fan in steps]
    calls = ledger((duties, fans))
    first = calls.entries[0].result["heater_duty"][0]
    assert len(cited_forecast(answer(first, fans[0]), calls, simulator())) == HORIZON
