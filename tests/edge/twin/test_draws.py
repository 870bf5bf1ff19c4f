"""Twins drawn from a file's intervals and correlations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.twin.draws import CORRELATION, correlation_document, drawn_twins, even_normals, uncertain
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from edge.twin.value import Value

UA, KC = ("effects", "wall_loss", "UA"), ("effects", "extra_capacity", "kC")
EFFECTS = {
    "wall_loss": {"UA": Value(4.0, low=3.0, high=5.0)},
    "extra_capacity": {"kC": Value(5.0, low=2.5, high=10.0)},
}
FILE = TwinFile(effects=EFFECTS)


def drawn(file: TwinFile, count: int = 400) -> dict[tuple[str, ...], np.ndarray]:
    twins = drawn_twins(file, count)
    return {place: np.array([twin.values()[place].value for twin in twins]) for place in file.values()}


def test_the_intervals_of_a_file_hold_95_percent_of_the_draws() -> None:
    found = drawn(FILE)
    assert np.quantile(found[UA], [0.025, 0.5, 0.975]) == pytest.approx([3.0, 4.0, 5.0], abs=0.02)
    # Even in the logarithm, as the interval is.
    assert np.quantile(found[KC], [0.025, 0.5, 0.975]) == pytest.approx([2.5, 5.0, 10.0], rel=0.02)


def test_exact_values_stay_and_equal_questions_get_equal_draws() -> None:
    found = drawn(FILE)
    assert set(found["geometry", "heater_max_w"]) == {100.0}
    assert (drawn(FILE)[UA] == found[UA]).all()
    exact = replace(FILE, effects={"wall_loss": {"UA": Value(4.0)}})
    assert uncertain(exact) == {}
    assert drawn_twins(exact, 3) == [exact] * 3


def test_a_value_stays_in_its_physical_range() -> None:
    wide = replace(FILE, effects={"fan_effectiveness": {"eps_f": Value(0.1, low=-2.0, high=2.0)}})
    found = drawn(wide)["effects", "fan_effectiveness", "eps_f"]
    assert found.min() == 0.0
    assert found.max() <= 2.0


def test_a_prior_is_drawn_and_a_replaced_effect_is_not() -> None:
    walls = {"wall_mass": {"C_w": Value(9e3), "G_in": Value(8.0, rel_sd=0.1), "G_out": Value(8.0)}}
    found = uncertain(replace(FILE, effects=EFFECTS | walls))
    assert set(found) == {KC, ("effects", "wall_mass", "G_in")}
    assert found["effects", "wall_mass", "G_in"].at(1.0) == pytest.approx(8.8)


@pytest.mark.parametrize("together", [-0.95, 0.0, 0.6])
def test_correlations_go_through_a_file(tmp_path: Path, together: float) -> None:
    covariance = np.array([[4.0, together * 6.0, 9.9], [together * 6.0, 9.0, 9.9], [9.9, 9.9, 99.0]])
    origin = {CORRELATION: correlation_document([UA, KC], covariance)}
    write_twin_file(replace(FILE, provenance=origin), tmp_path / "twin.yaml")
    found = drawn(read_twin_file(tmp_path / "twin.yaml"))
    assert np.corrcoef(found[UA], np.log(found[KC]))[0, 1] == pytest.approx(together, abs=0.1)


def test_two_films_that_only_their_sum_is_known_of_give_a_narrow_loss() -> None:
    """Each is known to a factor of two, and their sum to some percent."""
    films = {
        "C_w": Value(9e3),
        "G_in": Value(8.0, low=4.0, high=16.0),
        "G_out": Value(8.0, low=4.0, high=16.0),
    }
    file = replace(FILE, effects={"wall_mass": films})
    places = [("effects", "wall_mass", name) for name in ("G_in", "G_out")]
    known = replace(
        file, provenance={CORRELATION: correlation_document(places, np.array([[1.0, -0.98], [-0.98, 1.0]]))}
    )

    def width(own: TwinFile) -> float:
        losses = [
            1.0 / sum(1.0 / twin.values()[place].value for place in places) for twin in drawn_twins(own, 200)
        ]
        low, high = np.quantile(losses, [0.05, 0.95])
        return float(high / low)

    assert width(known) < 1.4
    assert width(file) > 1.8


@pytest.mark.parametrize(
    "bad",
    [
        [],
        {"values": ["a"]},
        {"values": ["a", "b"], "rows": [[1.0], [0.5]]},
        {"values": ["a"], "rows": [["x"]]},
        3,
    ],
)
def test_correlations_that_are_none_are_refused(bad: object) -> None:
    with pytest.raises(DataError, match=r"provenance\.correlation"):
        drawn_twins(replace(FILE, provenance={CORRELATION: bad}), 10)


def test_correlations_that_cannot_be_are_made_possible() -> None:
    names = [".".join(place) for place in (UA, KC)]
    twins = drawn_twins(replace(FILE, provenance={CORRELATION: {"values": names, "rows": [[1], [7, 1]]}}), 50)
    assert all(np.isfinite(twin.values()[UA].value) for twin in twins)


def test_even_normals_hit_every_part_once() -> None:
    found = even_normals(100, 3)
    assert (np.sort(found, axis=0) == np.sort(found, axis=0)[:, :1]).all()
    assert found.std(axis=0) == pytest.approx(np.ones(3), abs=0.03)
