"""The twin's answers to *what if*: directions, truths inside intervals, sentences, refusals."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.app.what_if import (
    BENT_MAX,
    WALL_PLACES,
    Outlook,
    Quantity,
    TwinChange,
    Unseen,
    WhatIf,
    outlooks,
    wall_factor,
)
from edge.app.what_if_words import HeatLimits, settings_in_the_way, span, unknowns_of, verdict
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.twin.draws import CORRELATION, drawn_twins
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile, read_twin_file
from edge.twin.value import Value
from edge.twin.warm_start import at_rest

PACKAGED = read_twin_file(Path("edge/models/default_bundle/twin.yaml"))
ROOM_C, TARGET_C = 20.0, 35.0
LIMITS = HeatLimits.of(Settings())
WALL = {"wall_loss": {"UA": Value(4.0, low=3.8, high=4.2)}}
BARE = TwinFile(effects=WALL)


def question(change: TwinChange = TwinChange(), **other: float) -> WhatIf:  # noqa: B008 - it is frozen
    usual = {"target_c": TARGET_C, "room_c": ROOM_C, "start_c": ROOM_C, "hold_c": 28.0, "utc": 1.8e9}
    return WhatIf(change, **(usual | other))


def changed(change: TwinChange, file: TwinFile = PACKAGED) -> tuple[Outlook, Outlook]:
    now, other = outlooks(file, question(change), 1.0)
    assert other is not None
    return now, other


def test_a_larger_heater_reaches_more_sooner_and_holds_by_the_same_power() -> None:
    now, other = changed(TwinChange(heater_w=150.0))
    assert other.reach_c.low > now.reach_c.high
    assert other.warm_up_min.high < now.warm_up_min.low
    assert other.power_w.value == pytest.approx(now.power_w.value)
    assert other.energy_kwh_day.value == pytest.approx(now.energy_kwh_day.value)


def test_tighter_walls_take_less_energy_and_thinner_ones_more() -> None:
    now, tight = changed(TwinChange(wall_factor=0.5))
    _, thin = changed(TwinChange(wall_factor=1.5))
    assert tight.energy_kwh_day.high < now.energy_kwh_day.low
    assert thin.energy_kwh_day.low > now.energy_kwh_day.high
    assert tight.power_w.value < now.power_w.value < thin.power_w.value
    assert tight.reach_c.value > now.reach_c.value > thin.reach_c.value
    # Half to all of the loss is conducted, so halved walls leave 0.5 to 0.75 of it.
    assert 0.5 * now.power_w.value < tight.power_w.value < 0.75 * now.power_w.value


def test_half_a_fan_cools_more_slowly_and_no_fan_hardly() -> None:
    now, half = changed(TwinChange(fan=0.5))
    _, none = changed(TwinChange(fan=0.0))
    assert now.cooling_min is not None and half.cooling_min is not None and none.cooling_min is not None
    assert half.cooling_min.low > now.cooling_min.high
    assert none.cooling_min.low > 5.0 * half.cooling_min.high
    assert half.reach_c == now.reach_c


def test_without_a_change_there_is_no_second_column_and_the_energy_is_that_of_the_power() -> None:
    now, other = outlooks(PACKAGED, question(hold_c=TARGET_C), 1.0)
    assert other is None
    assert now.energy_kwh_day.value == pytest.approx(0.024 * now.power_w.value)
    idle, _ = outlooks(PACKAGED, question(hold_c=ROOM_C - 3.0), 1.0)
    assert idle.energy_kwh_day.high == 0.0
    capped, _ = outlooks(PACKAGED, question(hold_c=59.0), 0.5)
    assert capped.energy_kwh_day == Quantity(1.2, 1.2, 1.2)  # half of 100 W all day


@pytest.mark.parametrize("heater_w", [60.0, 100.0, 150.0])
def test_nine_of_ten_boxes_within_the_fit_are_inside_the_intervals(heater_w: float) -> None:
    """Boxes drawn from the file, with other random numbers, are simulated step by step with that heater."""
    boxes = drawn_twins(replace(PACKAGED, effects=dict(reversed(PACKAGED.effects.items()))), 40)
    within = replace(PACKAGED, provenance={})  # so that nothing beyond the fit is added
    now, other = outlooks(within, question(TwinChange(heater_w=heater_w)), 1.0)
    told = other or now
    inside = {"reach_c": 0, "warm_up_min": 0}
    for box in boxes:
        twin = box.with_values({("geometry", "heater_max_w"): Value(heater_w)}).twin()
        steps = 1500
        air = twin.rollout(
            at_rest(twin, ROOM_C, ROOM_C), *Commands(np.ones((1, steps)), np.zeros((1, steps))), ROOM_C
        )[0]
        there = air >= TARGET_C
        minutes = float(np.argmax(there)) + 0.5 if there.any() else math.inf  # to half a step
        time, reach = told.warm_up_min, told.reach_c
        inside["warm_up_min"] += time.low - 0.5 <= minutes <= time.high + 0.5
        inside["reach_c"] += reach.low <= air[-1] <= reach.high
    assert inside["reach_c"] >= 32  # of 40; 36 are expected, 31 or less have a chance of 0.02
    assert inside["warm_up_min"] >= 32


def test_an_error_over_unseen_rows_widens_every_interval() -> None:
    exact = replace(BARE, effects={"wall_loss": {"UA": Value(4.0)}})
    off = replace(exact, provenance={"after": {"test": {"rmse_k": 0.5}}})
    now, _ = outlooks(exact, question(), 1.0)
    wide, _ = outlooks(off, question(), 1.0)
    assert now.reach_c == Quantity(*[pytest.approx(45.0)] * 3)  # 20 + 100 W / 4 W/K
    assert (wide.reach_c.low, wide.reach_c.high) == pytest.approx((45.0 - 0.822, 45.0 + 0.822), abs=0.02)
    assert (wide.power_w.low, wide.power_w.high) == pytest.approx((60.0 - 3.29, 60.0 + 3.29), abs=0.1)


def test_beyond_the_warmest_air_of_the_fit_losses_may_grow() -> None:
    seen = {"validity": {"temp_air_c": [20.0, 30.0], "temp_ambient_c": [19.0, 21.0]}}
    exact = replace(BARE, effects={"wall_loss": {"UA": Value(4.0)}}, provenance=seen)
    unseen = Unseen.of(exact)
    assert (unseen.seen_c, unseen.seen_k) == (30.0, 10.0)
    assert math.isnan(unseen.error_k)
    for temp_c in (15.0, 25.0, 30.0):
        assert unseen.twin_c(temp_c, 20.0, BENT_MAX) == temp_c
    # Twice the excess of the fit: 2^(4/3) of its loss.
    assert unseen.twin_c(40.0, 20.0, 1.0 / 3.0) == pytest.approx(20.0 + 10.0 * 2.0 ** (4.0 / 3.0))
    assert unseen.box_c(unseen.twin_c(47.0, 20.0, 0.2), 20.0, 0.2) == pytest.approx(47.0)
    now, _ = outlooks(exact, question(), 1.0)
    assert 20.0 + 10.0 * 2.5**0.75 <= now.reach_c.low < now.reach_c.high <= 45.0 + 1e-6
    assert 60.0 - 1e-6 <= now.power_w.low < now.power_w.high <= 40.0 * 1.5 ** (4.0 / 3.0)


def test_walls_of_twice_the_thickness_follow_iso_6946() -> None:
    # 0.26 of both films, 8 mm / 0.20 W/(m K)
    assert wall_factor("polycarbonate:8mm", 16.0) == pytest.approx((0.26 + 0.04) / (0.26 + 0.08))
    with pytest.raises(RequestError, match="none of"):
        wall_factor("paper:8mm", 16.0)


def test_what_the_twin_has_not_is_refused() -> None:
    others = [
        (
            replace(BARE, effects={"infiltration": {"F_inf": Value(0.002)}}),
            "the twin has none of its own, but infil",
        ),
        (replace(BARE, effects={"wall_loss": {"UA": Value(4.0, low=0.5, high=30.0)}}), "which is too little"),
        (replace(BARE, effects={"wall_loss": {"UA": Value(1.0, low=-3.0, high=5.0)}}), "which is too little"),
    ]
    for file, reason in others:
        with pytest.raises(RequestError, match=f"walls: .*{reason}"):
            outlooks(file, question(TwinChange(wall_factor=0.5)), 1.0)
    with pytest.raises(RequestError, match="fan: the twin has no fan"):
        outlooks(replace(BARE, fan_role="stirring"), question(TwinChange(fan=0.5)), 1.0)
    stirred, _ = outlooks(replace(BARE, fan_role="stirring"), question(), 1.0)
    assert stirred.fanned_c is None and stirred.cooling_min is None


def test_both_films_of_a_wall_that_stores_change_alike() -> None:
    assert {place[-1] for place in WALL_PLACES} == {"G_in", "G_out", "UA"}
    films = {"C_w": Value(9e3), "G_in": Value(8.0), "G_out": Value(8.0)}
    mass = replace(BARE, effects={"wall_mass": films})
    straight = replace(BARE, effects={"wall_loss": {"UA": Value(4.0)}})
    for factor in (0.4, 1.7):
        found = [changed(TwinChange(wall_factor=factor), file)[1] for file in (mass, straight)]
        assert found[0].power_w.value == pytest.approx(found[1].power_w.value)


def told(heater_w: float = 100.0, file: TwinFile = BARE, **other: float) -> str:
    asked = question(TwinChange(heater_w=heater_w), **other)
    now, changed = outlooks(file, asked, 1.0)
    return verdict(asked, now, changed, LIMITS)


def test_the_verdict_is_yes_no_or_perhaps() -> None:
    # 15 K times 3.83 to 4.17 W/K, the 90 % of an interval of 95 %
    assert (
        "Yes: 35 °C takes 58 to 62 W of the 100 W at a room of 20 °C; from 20 °C it gets there in" in told()
    )
    no = told(50.0)
    assert "No: at full heat the air reaches 32.0 to 33.0 °C at a room of 20 °C." in no
    assert "35 °C takes 58 to 62 W; a heater of 63 W would do." in no
    assert "Perhaps (" in told(60.0)
    assert "it gets there" not in told(start_c=36.0)


def test_a_target_that_needs_no_heat_is_reached_by_none() -> None:
    assert told(target_c=15.0) == "With the change: Yes: 15 °C takes no heat at a room of 20 °C."


@pytest.mark.parametrize("heater_w", [100.0, 1000.0])
def test_no_heater_is_big_enough_for_what_safety_does_not_allow(heater_w: float) -> None:
    assert told(heater_w, target_c=40.0) == (
        "With the change: No: the safety limit of 40 °C is below: heat is turned off there."
    )


def limits_told(asked: WhatIf, limits: HeatLimits = LIMITS, file: TwinFile = BARE) -> str:
    now, changed = outlooks(file, asked, limits.duty_max)
    return " ".join(settings_in_the_way(asked, changed or now, limits))


def test_settings_in_the_way_are_named() -> None:
    assert "(safety.temp_air_max_c)" in limits_told(question())  # 45 °C at full heat
    assert limits_told(question(TwinChange(heater_w=50.0))) == ""
    assert "(reference.max_c)" in limits_told(question(target_c=39.0))
    small = replace(LIMITS, duty_max=0.5)
    assert "Full heat is 50% of the heater" in limits_told(question(), small)
    assert "60 W in the mean of an hour" in limits_told(
        question(target_c=37.0), replace(LIMITS, hour_max_wh=60.0)
    )
    # The packaged box takes about an hour to 38.5 °C; 100 W for 54 min are 90 Wh.
    slow = limits_told(question(target_c=38.5), replace(LIMITS, hour_max_wh=90.0), PACKAGED)
    assert "54 min of full heat in an hour" in slow
    assert "Safety allows 0.5 kWh a day" in limits_told(question(), replace(LIMITS, day_max_wh=500.0))


def test_what_the_answer_rests_on_is_said() -> None:
    asked = question(TwinChange(heater_w=150.0, wall_factor=0.5, fan=0.5))
    now, changed = outlooks(PACKAGED, asked, 1.0)
    said = " ".join(unknowns_of(PACKAGED, asked, changed or now))
    for words in (
        "has no correlations",
        "no error over rows that no fit saw",
        "The fit saw air up to 36.7 °C, 15 K over the room",
        "taken to give 100 W",
        "as slow as the present one",
        "The walls conduct 0.50 times as much",
        "The fan's share is of its flow",
    ):
        assert words in said
    assert "Taken as exact" not in said
    known = {
        "after": {"test": {"rmse_k": 0.2}},
        CORRELATION: {"values": [], "rows": []},
        "validity": {"hours": 2.0},
    }
    effects = {"wall_loss": {"UA": Value(4.0)}, "led_gain": {"P_led": Value(10.0, low=8.0, high=12.0)}}
    file = replace(BARE, effects=effects, provenance=known)
    now, _ = outlooks(file, question(), 1.0)
    said = " ".join(unknowns_of(file, question(), now))
    assert "no interval: wall_loss.UA." in said and "needs light: taken are darkness" in said
    assert "The fit saw 2.0 h at a time" in said
    assert "no correlations" not in said and "no error" not in said


def test_an_interval_in_words() -> None:
    assert span(Quantity(65.0, 61.7, 74.2), "W") == "62 to 74 W"
    assert span(Quantity(65.0, 64.9, 65.1), "W") == "about 65 W"
    assert span(Quantity(7.0, 6.04, 8.21), "min") == "6.0 to 8.2 min"
    assert span(Quantity(50.0, 40.2, math.inf), "min") == "40 min to never"
    assert span(Quantity(*[math.inf] * 3), "min") == "never"
