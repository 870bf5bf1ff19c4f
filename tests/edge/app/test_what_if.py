"""The twin's answers to *what if*: directions, truths inside intervals, sentences, refusals."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge.app import what_if
from edge.app.what_if import (
    BENT_MAX,
    STORED_MAX,
    WALL_PLACES,
    Outlook,
    Quantity,
    Seen,
    TwinChange,
    WhatIf,
    other_walls,
    outlooks,
)
from edge.app.what_if_words import HeatLimits, settings_in_the_way, span, unknowns_of, verdict
from edge.config.settings import Settings
from edge.core.errors import RequestError
from edge.twin.draws import CORRELATION, drawn_twins
from edge.twin.effects.library import EFFECTS
from edge.twin.rollout import Commands
from edge.twin.twin_file import TwinFile, read_twin_file
from edge.twin.value import Value
from edge.twin.warm_start import at_rest

PACKAGED = read_twin_file(Path("edge/models/default_bundle/twin.yaml"))
ROOM_C, TARGET_C = 20.0, 35.0
LIMITS = HeatLimits.of(Settings())
WALL = {"wall_loss": {"UA": Value(4.0, low=3.8, high=4.2)}}
BARE = TwinFile(effects=WALL)


@pytest.fixture(autouse=True)
def fewer_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(what_if, "DRAWS", 80)


def question(change: TwinChange = TwinChange(), **other: float) -> WhatIf:  # noqa: B008 - it is frozen
    usual = {"target_c": TARGET_C, "room_c": ROOM_C, "start_c": ROOM_C, "hold_c": 28.0, "utc": 1.8e9}
    return WhatIf(change, **(usual | other))


def changed(change: TwinChange, file: TwinFile = PACKAGED) -> tuple[Outlook, Outlook]:
    now, other = outlooks(file, question(change), 1.0)
    assert other is not None
    return now, other


def test_a_larger_heater_reaches_more_sooner_and_holds_by_the_same_power() -> None:
    now, other = changed(TwinChange(heater_w=150.0))
    assert other.reach_c.low > now.reach_c.value
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
    # A third to all of the loss is conducted, so halved walls leave 0.5 to 0.83 of it.
    assert 0.5 * now.power_w.value < tight.power_w.value < 0.83 * now.power_w.value


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
    assert (wide.reach_c.low, wide.reach_c.high) == pytest.approx((45.0 - 0.822, 45.0 + 0.822), abs=0.04)
    assert (wide.power_w.low, wide.power_w.high) == pytest.approx((60.0 - 3.29, 60.0 + 3.29), abs=0.15)


EXACT = replace(BARE, effects={"wall_loss": {"UA": Value(4.0)}})
SEEN_10_K = {"validity": {"temp_air_c": [20.0, 30.0], "temp_ambient_c": [19.0, 21.0]}}


def test_beyond_the_warmest_air_of_the_fit_losses_may_grow() -> None:
    file = replace(EXACT, provenance=SEEN_10_K)
    assert Seen.of(file)[:2] == (30.0, 10.0)
    assert math.isnan(Seen.of(file).error_k)
    now, _ = outlooks(file, question(), 1.0)
    # 25 K by 4 W/K where they don't; 2.5 times the 10 K that were seen. Holding 35 °C takes 1.5 times 40 W.
    assert 20.0 + 10.0 * 2.5 ** (1.0 / (1.0 + BENT_MAX)) < now.reach_c.low < 40.0
    assert now.reach_c.high == pytest.approx(45.0, abs=0.1)
    assert now.power_w.low == pytest.approx(60.0, abs=0.1)
    assert 75.0 < now.power_w.high < 40.0 * 1.5 ** (1.0 + BENT_MAX)
    within, _ = outlooks(file, question(target_c=30.0, hold_c=25.0), 1.0)
    assert within.power_w == Quantity(*[pytest.approx(40.0)] * 3)


def test_an_error_goes_with_the_warmth_as_well() -> None:
    """An error of 0.5 K is 0.5 K of the room, and at 0.6 of the warmest air over it a share of the heat."""
    seen = {"validity": {"temp_air_c": [20.0, 60.0], "temp_ambient_c": [20.0, 20.0]}}
    file = replace(EXACT, provenance=seen | {"after": {"test": {"rmse_k": 0.5}}})
    now, _ = outlooks(file, question(), 1.0)
    both_k = 1.645 * math.hypot(0.5, 25.0 * 0.5 / 24.0)
    assert (now.reach_c.low, now.reach_c.high) == pytest.approx((45.0 - both_k, 45.0 + both_k), abs=0.2)


def nameless_file(amount: float, name: str = "unnamed_heat", turn_c: float = 22.0) -> TwinFile:
    key = next(iter(item.name for item in EFFECTS[name].parameters))
    own = {name: {key: Value(amount), "T_x": Value(turn_c), "w_x": Value(0.5)}}
    seen = {"validity": {"temp_air_c": [20.0, 40.0], "temp_ambient_c": [20.0, 20.0]}}
    return replace(EXACT, effects={**EXACT.effects, **own}, provenance=seen)


def test_heat_of_no_known_cause_may_have_been_there_in_all_rows() -> None:
    """Cool rows had 24 W, beside the 48 W that 32 °C lost; warm rows may have had none to all of it."""
    now, _ = outlooks(nameless_file(24.0), question(), 1.0)
    # 15 K by 4 W/K, and as much again as 24 W are of 12 K by 4 W/K
    assert (now.power_w.low, now.power_w.high) == pytest.approx((60.0 * 1.025, 60.0 * 1.475), rel=0.02)
    assert "heat of no known cause" in " ".join(unknowns_of(nameless_file(24.0), question(), now))


def test_heat_of_no_known_cause_may_have_ended() -> None:
    """Heat of 24 W that all rows had; a cut of a quarter of the heater's heat."""
    heat, _ = outlooks(nameless_file(24.0, turn_c=100.0), question(), 1.0)
    assert (heat.power_w.low, heat.power_w.high) == pytest.approx((60.0 - 22.8, 60.0 - 1.2), abs=0.2)
    cut, _ = outlooks(nameless_file(0.25, "unnamed_cut"), question(), 1.0)
    assert (cut.power_w.low, cut.power_w.high) == pytest.approx((60.0 / 0.9875, 60.0 / 0.7625), rel=0.01)


def test_losses_in_a_short_fit_may_be_heat_into_what_it_did_not_see() -> None:
    """Two thirds of 60 W at most, of which the square of 0.95 is in the interval; after days hardly any."""
    files = [replace(EXACT, provenance={"validity": {"hours": hours}}) for hours in (2.0, 100.0)]
    short, long = (outlooks(file, question(), 1.0)[0] for file in files)
    most_w = 60.0 * STORED_MAX * math.exp(-2.0 / 12.0) * 0.95**2
    assert (short.power_w.low, short.power_w.high) == pytest.approx((60.0 - most_w, 60.0), abs=0.6)
    assert short.reach_c.high == pytest.approx(20.0 + 25.0 * 60.0 / (60.0 - most_w), abs=0.8)
    assert (long.power_w.low, long.power_w.high) == pytest.approx((60.0, 60.0), abs=0.1)
    # The air of this box is warm in a minute, long before any store.
    assert short.warm_up_min.high == pytest.approx(long.warm_up_min.high, rel=0.02)


def test_a_time_is_known_to_a_step() -> None:
    slow = replace(EXACT, effects={**EXACT.effects, "extra_capacity": {"kC": Value(11.0)}})
    now, _ = outlooks(slow, question(), 1.0)
    width_min = now.warm_up_min.high - now.warm_up_min.low
    assert width_min == pytest.approx(0.9 * slow.sample_s / 60.0, abs=0.03)


def test_another_heater_leaves_the_bounds_of_the_other_values() -> None:
    """The mixing that is possible goes with the present heater, and this twin's is the least."""
    (mixing,) = EFFECTS["imperfect_mixing"].parameters
    least = Value(BARE.scale.possible(mixing).low)
    file = replace(BARE, effects={**EXACT.effects, "imperfect_mixing": {mixing.name: least}})
    _, more = changed(TwinChange(heater_w=1000.0), file)
    _, less = changed(TwinChange(heater_w=10.0), file)
    assert more.reach_c.value > less.reach_c.value


def test_a_slow_body_may_pass_its_heat_on_and_a_quick_one_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("edge.app.what_if.STORED_MAX", 0.0)

    def held_w(capacity_j_k: float, hours: float) -> Quantity:
        body = {"soil_mass": {"C_s": Value(capacity_j_k), "G_s": Value(2.0)}}
        seen = {"validity": {"hours": hours}}
        file = replace(EXACT, effects={**EXACT.effects, **body}, provenance=seen)
        return outlooks(file, question(), 1.0)[0].power_w

    slow, quick = held_w(720_000.0, 0.5), held_w(1_000.0, 2.0)  # time constants of 100 h and 8 min
    # 15 K by 4 W/K, and by 0 to 2 W/K through the body
    assert (slow.low, slow.high) == pytest.approx((61.5, 88.5), abs=0.5)
    assert quick == Quantity(*[pytest.approx(60.0, abs=1e-3)] * 3)
    assert held_w(720_000.0, 300.0).high == pytest.approx(61.5, abs=0.2)  # 0.95 exp(-3) of 2 W/K


def test_losses_grow_beside_heat_that_more_than_holds_the_air() -> None:
    """Heat of 50 W is more than the 40 W that 30 °C loses, and losses still grow beyond."""
    heat = {"constant_heat": {"P0": Value(50.0)}}
    file = replace(BARE, effects={**EXACT.effects, **heat}, provenance=SEEN_10_K)
    now, _ = outlooks(file, question(), 1.0)
    assert now.power_w.low == pytest.approx(10.0, abs=0.1)
    assert 25.0 < now.power_w.high < 40.0 * 1.5 ** (1.0 + BENT_MAX) - 50.0


def test_a_box_that_may_lose_nothing_has_no_upper_end() -> None:
    hardly = replace(BARE, effects={"wall_loss": {"UA": Value(4.0, low=-1.0, high=9.0)}})
    now, _ = outlooks(hardly, question(), 1.0)
    assert now.reach_c.value == pytest.approx(45.0, abs=0.5)
    assert now.reach_c.high == math.inf
    nothing, _ = outlooks(replace(BARE, effects={"wall_loss": {"UA": Value(0.0)}}), question(), 1.0)
    assert nothing.reach_c == Quantity(*[math.inf] * 3)


def test_a_heater_that_sags_takes_the_duty_that_it_is_given() -> None:
    """At full duty it gives 80 W of 100; u (1 - 0.2 u) is 0.6 at 0.6972."""
    sag = replace(EXACT, effects={**EXACT.effects, "heater_sag": {"sag": Value(0.2)}})
    now, _ = outlooks(sag, question(), 1.0)
    assert now.power_w == Quantity(*[pytest.approx(69.72, abs=0.02)] * 3)
    assert outlooks(sag, question(target_c=39.0), 1.0)[0].sure == 1.0
    assert outlooks(sag, question(target_c=41.0), 1.0)[0].sure == 0.0  # 84 W


def test_thicker_walls_may_store_more() -> None:
    stored = {"wall_loss": {"UA": Value(4.0)}, "extra_capacity": {"kC": Value(11.0)}}
    file = replace(BARE, effects=stored)
    _, thin = changed(TwinChange(wall_factor=1.0), file)
    _, thick = changed(TwinChange(wall_factor=1.0, wall_thickness=2.0), file)
    # 11 times the air's capacity, of which 10 may be in the walls
    times = thick.warm_up_min.value / thin.warm_up_min.value
    assert times == pytest.approx(1.0 + 0.5 * 10.0 / 11.0, rel=0.02)
    assert thick.warm_up_min.high > 1.8 * thin.warm_up_min.value
    assert thick.power_w.value == pytest.approx(thin.power_w.value)


def test_walls_of_twice_the_thickness_follow_iso_6946() -> None:
    # 0.26 of both films, 8 mm / 0.20 W/(m K)
    factor = (0.26 + 0.04) / (0.26 + 0.08)
    assert other_walls("polycarbonate:8mm", 16.0) == pytest.approx((factor, 2.0))
    with pytest.raises(RequestError, match="none of"):
        other_walls("paper:8mm", 16.0)


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
    # 160 times the air stores 29 kJ/K, so 35 °C takes 110 min; 100 W for 54 min are 90 Wh.
    heavy = replace(BARE, effects=WALL | {"extra_capacity": {"kC": Value(160.0)}})
    slow = limits_told(question(), replace(LIMITS, hour_max_wh=90.0), heavy)
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
        "The walls conduct 0.50 times as much and keep their mass",
        "does not say how many hours its fit saw",
        "If the sun shone in",
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
    assert "The fit saw 2.0 h at a time. Up to 56% of what it takes for losses" in said
    assert "no correlations" not in said and "no error" not in said


def test_an_interval_in_words() -> None:
    assert span(Quantity(65.0, 61.7, 74.2), "W") == "62 to 74 W"
    assert span(Quantity(65.0, 64.9, 65.1), "W") == "about 65 W"
    assert span(Quantity(7.0, 6.04, 8.21), "min") == "6.0 to 8.2 min"
    assert span(Quantity(50.0, 40.2, math.inf), "min") == "40 min to never"
    assert span(Quantity(*[math.inf] * 3), "min") == "never"
    assert span(Quantity(50.0, 40.2, math.inf), "°C") == "40.2 °C or more"
    assert span(Quantity(*[math.inf] * 3), "°C") == "without limit"
