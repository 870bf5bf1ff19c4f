"""edge/twin/diagnosis/held_out.py: runs that had no part in fitting an effect, asked about it."""

import pytest
from simulated_runs import BOX, search_over, simulated

from edge.twin.diagnosis.candidates import Scored
from edge.twin.diagnosis.held_out import held_out_gains
from edge.twin.diagnosis.search import Search

LAG = {"heater_lag": {"tau_h": 200.0}}
ROWS = 60


def fitted(search: Search, *names: str) -> Scored:
    key = frozenset(names)
    [found] = search.sets.fitted({key: search.sets.as_usual(search.sets.base(), key)})
    return found


@pytest.fixture(scope="module")
def search() -> Search:
    return search_over([simulated({**BOX, **LAG}, seed, ROWS) for seed in range(1, 5)])[0]


def test_runs_left_out_confirm_what_is_there_and_nothing_else(search: Search) -> None:
    both = fitted(search, "heater_lag", "constant_heat")  # of which the box has the first
    gains = held_out_gains(search, both, ["heater_lag", "constant_heat"])
    assert gains["heater_lag"] > 100.0
    # An effect that is not there is fitted to the noise of one half: the other half has no use for it.
    assert -5.0 < gains["constant_heat"] < 1.0


def test_what_is_told_is_of_all_runs_once(search: Search) -> None:
    lag = fitted(search, "heater_lag")
    in_sample = lag.likelihood - search.sets.without(lag, "heater_lag").likelihood
    assert held_out_gains(search, lag, ["heater_lag"])["heater_lag"] == pytest.approx(in_sample, rel=0.3)


def test_a_single_run_leaves_none_out() -> None:
    search, _ = search_over([simulated({**BOX, **LAG}, 1, ROWS)])
    assert held_out_gains(search, fitted(search, "heater_lag"), ["heater_lag"]) == {}
    assert held_out_gains(search, search.sets.base(), []) == {}
