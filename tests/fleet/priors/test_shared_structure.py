"""Twins of other structure that answer alike have the same values in the shared one."""

from dataclasses import replace

import pytest

from edge.diagnosis.baselines import bare
from edge.twin.twin_file import TwinFile
from edge.twin.value import Value
from fleet.priors.shared_structure import in_structure

WALL = {"C_w": Value(9000.0), "G_in": Value(6.0), "G_out": Value(4.0)}
COMMON = {"extra_capacity": {"kC": Value(4.0)}, "heater_lag": {"tau_h": Value(120.0)}}
NAMES = ("soil_mass", "heater_lag")


def box(**effects: dict[str, Value]) -> TwinFile:
    return replace(TwinFile(), effects={**COMMON, **effects}, fan_role="none")


def values(twin: TwinFile) -> dict[str, float]:
    shared = in_structure(twin, bare(twin), NAMES)
    assert shared.miss_k < 0.01
    return {place[2]: value.value for place, value in shared.file.values().items() if place[0] == "effects"}


def test_a_wall_that_stores_is_told_as_a_loss_and_a_mass() -> None:
    found = values(box(wall_mass=WALL))
    # Two films in series lose UA = G_in G_out / (G_in + G_out); the mass is seen through their ratio.
    assert found["UA"] == pytest.approx(2.4, rel=0.01)
    assert found["G_s"] == pytest.approx(6.0 * 6.0 / (6.0 + 4.0), rel=0.01)
    assert found["C_s"] == pytest.approx(9000.0 * (6.0 / 10.0) ** 2, rel=0.01)
    assert found["kC"] == pytest.approx(4.0, rel=0.01)


def test_what_is_of_the_place_plays_no_part() -> None:
    mass = {"wall_loss": {"UA": Value(2.4)}, "soil_mass": {"C_s": Value(3240.0), "G_s": Value(3.6)}}
    sunny = box(**mass, constant_heat={"P0": Value(20.0)}, ambient_offset={"b_amb": Value(3.0)})
    assert values(sunny) == pytest.approx(values(box(**mass)), rel=1e-6)


def test_an_effect_that_the_structure_lacks_shows_in_the_miss() -> None:
    mass = {"wall_loss": {"UA": Value(2.4)}, "soil_mass": {"C_s": Value(3240.0), "G_s": Value(3.6)}}
    twin = box(**mass, heater_saturation={"u_sat": Value(0.5)})
    assert in_structure(twin, bare(twin), NAMES).miss_k > 0.2


def test_a_fast_box_behind_a_slow_sensor_is_told_as_the_slow_box_that_answers_alike() -> None:
    air_j_k = TwinFile().values()["geometry", "volume_m3"].value * 1.2 * 1005.0

    def behind(box_s: float, sensor_s: float) -> TwinFile:
        return replace(
            TwinFile(),
            effects={
                "wall_loss": {"UA": Value(2.4)},
                "extra_capacity": {"kC": Value(2.4 * box_s / air_j_k)},
                "sensor_lag": {"tau_s": Value(sensor_s)},
            },
            fan_role="none",
        )

    names = ("sensor_lag",)
    slow, fast = (
        in_structure(twin, bare(twin), names) for twin in (behind(1500.0, 300.0), behind(300.0, 1500.0))
    )
    for shared in (slow, fast):
        found = {place[-1]: value.value for place, value in shared.file.values().items()}
        assert found["tau_s"] == pytest.approx(300.0, rel=0.02)
        assert found["kC"] == pytest.approx(2.4 * 1500.0 / air_j_k, rel=0.02)
