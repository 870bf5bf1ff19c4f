"""Change the safety supervisor one operator, number or rule at a time: its tests must notice every change."""

import mutation
import pytest
import test_fan_parts
import test_safety

from edge.safety import memory as safety_state
from edge.safety import rules as safety_rules
from edge.safety import supervisor as safety

pytestmark = pytest.mark.slow

MODULES = [safety, safety_rules, safety_state]
TABLES = [
    "HEATER_OFF", "HEATER_LIMITS", "FAN_FORCED", "FAN_LIMITS",
    "LED_OFF", "LED_LIMITS", "VALVE_SHUT", "VALVE_LIMITS",
]  # fmt: skip
CONSTANTS = ["CLOCK_SLACK_S", "HOUR_S", "DAY_S", "HEAT_BUCKET_S", "LEASE_S", "CLEAR_BELOW_K", "ROUNDING"]
CONSTANTS += ["RISE_OVER_S", "RISE_GAP_S", "RISE_FADES_S", "RISE_MARGIN", "HELD_OVER_S", "DOUBT_S"]
MUTANTS_AT_LEAST = 200  # fewer would mean that the search finds no functions any more

EQUIVALENT = {
    "edge.safety.supervisor: value < largest  in  if not value <= largest:":
        "at the limit itself the limited value is the wanted one, and an equal value makes no change",
    "edge.safety.supervisor: abs(wanted - sent) >= ROUNDING  in  if abs(wanted - sent) > ROUNDING:":
        "a difference of exactly 1e-9 is rounding either way",
}  # fmt: skip


def test_every_change_of_the_supervisor_makes_a_test_fail():
    tests = [*mutation.cases(test_safety), *mutation.cases(test_fan_parts)]
    mutants = [
        *(mutant for module in MODULES for mutant in mutation.function_mutants(module)),
        *mutation.row_mutants(MODULES, TABLES),
        *mutation.constant_mutants(MODULES, CONSTANTS),
    ]
    assert len(mutants) >= MUTANTS_AT_LEAST
    survivors = [mutant.name for mutant in mutants if mutation.survives(mutant, tests)]
    assert [name for name in survivors if name not in EQUIVALENT] == []


def test_without_a_change_every_test_passes():
    for test in mutation.cases(test_safety):
        test()
