"""The count of boxes for which an hour with the prior is worth six without."""

from types import MappingProxyType

import numpy as np

from bench.boxes.fleet import FleetBox, NewBoxRow, table
from bench.boxes.thirty_hours import LongRow, lines


def _rows(name, costs=MappingProxyType({}), **errors):
    ways = {"hour": "1 h", "six": "6 h", "prior": "1 h and prior"}
    return [NewBoxRow(name, "", ways[key], error, costs.get(key, error)) for key, error in errors.items()]


def test_a_box_of_which_nothing_was_learnt_is_worth_nothing():
    rows = [
        *_rows("better", hour=3.0, six=1.0, prior=0.9),
        *_rows("near", hour=3.0, six=1.0, prior=1.04),
        *_rows("worse", hour=3.0, six=1.0, prior=1.1),
        *_rows("neither", hour=None, six=None, prior=None),
        *_rows("only six", hour=None, six=1.0, prior=None),
    ]
    (told,) = (line for line in table(rows) if line.startswith("error_k:"))
    assert "is as good as 6 h without in 1 of 5 boxes, and no more than 5% worse in 2" in told


def test_a_box_counts_for_both_where_each_is_as_good():
    rows = [
        *_rows("dearer", {"prior": 1.2}, hour=3.0, six=1.0, prior=0.9),
        *_rows("a little dearer", {"prior": 1.05}, hour=3.0, six=1.0, prior=0.9),
        *_rows("cheaper", {"prior": 0.7}, hour=3.0, six=1.0, prior=0.9),
    ]
    *_, told = table(rows)
    assert told.startswith("error_k and cost: 1 h with the prior is as good as 6 h without in 1 of 3 boxes")
    assert told.endswith("no more than 5% worse in 2")


def test_thirty_hours_are_counted_as_an_hour_is():
    rows = [
        LongRow(FleetBox(5, 1), (1.0, 0.9, 1.04, np.nan), (100.0, 120.0, 80.0, 103.0)),
        LongRow(FleetBox(5, 2), (1.0, 1.0, 1.2, np.nan), (100.0, 104.0, 100.0, 90.0)),
    ]
    assert [*lines(rows)][-5:] == [
        "error_k: 1 h and prior is as good as 6 h in 2 of 2, no more than 5% worse in 2",
        "error_k: 30 h is as good as 6 h in 0 of 2, no more than 5% worse in 1",
        "cost: 1 h and prior is as good as 6 h in 0 of 2, no more than 5% worse in 1",
        "cost: 30 h is as good as 6 h in 2 of 2, no more than 5% worse in 2",
        "cost: own equations is as good as 6 h in 1 of 2, no more than 5% worse in 2",
    ]
