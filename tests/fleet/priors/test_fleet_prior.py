"""The start of a new box: the values of its kind, the effects that its kind has."""

from dataclasses import replace

import numpy as np
import pytest

from edge.core.errors import DataError
from edge.diagnosis.baselines import bare
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from edge.twin.value import Value
from fleet.priors.fleet_prior import BoxSheet, FleetPrior, fit_prior


def sheets() -> list[BoxSheet]:
    """Return three tents, in one of which the slow part is a wall, and two cases without one."""
    rng, found = np.random.default_rng(1), []
    for number in range(5):
        is_tent = number < 3

        def about(value: float) -> Value:
            return Value(float(value * np.exp(0.1 * rng.normal())))

        effects = {"extra_capacity": {"kC": about(4.0)}, "heater_lag": {"tau_h": about(120.0)}}
        if is_tent and number % 2:
            effects["wall_mass"] = {"C_w": about(9000.0), "G_in": about(6.0), "G_out": about(4.0)}
        else:
            effects["wall_loss"] = {"UA": about(2.4)}
        if is_tent and not number % 2:
            effects["soil_mass"] = {"C_s": about(3240.0), "G_s": about(3.6)}
        twin = replace(TwinFile(), effects=effects, fan_role="none")
        found.append(BoxSheet(f"box-{number}", "tent" if is_tent else "case", twin))
    return found


@pytest.fixture(scope="module")
def prior() -> FleetPrior:
    return fit_prior(sheets())


def test_a_new_box_starts_with_the_values_of_its_kind(prior: FleetPrior, tmp_path) -> None:  # type: ignore[no-untyped-def]
    start = prior.start(bare(replace(TwinFile(), fan_role="none")), "tent")
    assert set(start.effects) == {"wall_loss", "extra_capacity", "soil_mass", "heater_lag"}
    assert start.to_fit() == []
    assert start.effects["soil_mass"]["C_s"].value == pytest.approx(3240.0, rel=0.2)
    assert 0.05 < (start.effects["soil_mass"]["C_s"].rel_sd or 0.0) < 0.4
    write_twin_file(start, tmp_path / "start.yaml")
    assert read_twin_file(tmp_path / "start.yaml").effects == start.effects


def test_an_effect_that_its_kind_has_not_is_not_begun_with(prior: FleetPrior) -> None:
    assert prior.structure("case") == ("heater_lag",)
    assert prior.structure("tent") == ("soil_mass", "heater_lag")


def test_a_kind_whose_boxes_lag_somewhere_lags() -> None:
    names = {"heater_lag": {"tau_h": Value(120.0)}, "sensor_lag": {"tau_s": Value(90.0)}}
    told = []
    for name, own in names.items():
        effects = {"wall_loss": {"UA": Value(2.4)}, "extra_capacity": {"kC": Value(4.0)}, name: own}
        told.append(BoxSheet(name, "tent", replace(TwinFile(), effects=effects, fan_role="none")))
    # Half of them have each, which alone is not enough for either.
    assert fit_prior(told).structure("tent") == ("heater_lag",)


def test_a_kind_whose_boxes_bend_somehow_bends() -> None:
    bends = {
        "natural_convection": {"G_nc": Value(1.0)},
        "heater_derating": {"k_P": Value(0.02)},
        "unnamed_cut": {"f_x": Value(0.2), "T_x": Value(45.0), "w_x": Value(2.0)},
    }
    told = []
    for name, own in bends.items():
        effects = {"wall_loss": {"UA": Value(2.4)}, "extra_capacity": {"kC": Value(4.0)}, name: own}
        told.append(BoxSheet(name, "tent", replace(TwinFile(), effects=effects, fan_role="none")))
    # A cut in warm air is told as a heater that fades there, so two of three have that.
    assert fit_prior(told).structure("tent") == ("heater_derating",)


def test_a_kind_whose_boxes_lag_twice_lags_twice() -> None:
    lags = {
        "heater_lag": {"tau_h": Value(120.0)},
        "sensor_lag": {"tau_s": Value(40.0)},
        "heater_deadtime": {"d_h": Value(20.0)},
    }
    told = []
    for names in (
        ("heater_lag", "sensor_lag"),
        ("heater_lag", "heater_deadtime"),
        ("heater_lag", "sensor_lag"),
    ):
        effects = {"wall_loss": {"UA": Value(2.4)}, "extra_capacity": {"kC": Value(4.0)}}
        effects |= {name: lags[name] for name in names}
        told.append(BoxSheet("+".join(names), "tent", replace(TwinFile(), effects=effects, fan_role="none")))
    assert fit_prior(told).structure("tent") == ("heater_lag", "sensor_lag")
    # One that lags once has put the other lag into its values: it tells none.
    once = replace(TwinFile(), effects={**told[0].twin.effects}, fan_role="none")
    del once.effects["sensor_lag"]
    once.effects["extra_capacity"]["kC"] = Value(40.0)
    start = fit_prior([*told, BoxSheet("once", "tent", once)]).start(
        bare(replace(TwinFile(), fan_role="none")), "tent"
    )
    assert start.effects["extra_capacity"]["kC"].value == pytest.approx(4.0, rel=0.2)


def told(rig: str, miss_k: float, loss_w_k: float = 2.4, *, has_soil: bool = False) -> BoxSheet:
    effects = {"wall_loss": {"UA": Value(loss_w_k)}, "extra_capacity": {"kC": Value(4.0)}}
    if has_soil:
        effects["soil_mass"] = {"C_s": Value(3240.0), "G_s": Value(3.6)}
    twin = replace(TwinFile(), effects=effects, fan_role="none")
    return BoxSheet(rig, "tent", replace(twin, provenance={"after": {"train": {"rmse_k": miss_k}}}))


def test_twins_that_miss_much_hardly_count() -> None:
    found = fit_prior([told("a", 0.3, has_soil=True), told("b", 0.6, 3.6), told("c", 1.2, 3.6)])
    assert found.structure("tent") == ("soil_mass",)
    # What they lack is in their losses, which are not the kind's.
    start = found.start(bare(replace(TwinFile(), fan_role="none")), "tent")
    assert start.effects["wall_loss"]["UA"].value == pytest.approx(2.4, rel=0.05)


def test_a_box_that_claims_to_miss_nothing_outvotes_no_three() -> None:
    others = [told(str(number), 0.3) for number in range(3)]
    assert fit_prior([*others, told("liar", 1e-9, has_soil=True)]).structure("tent") == ()


@pytest.mark.parametrize("miss_k", [1.7e308, -3.0])
def test_no_word_of_a_rig_breaks_the_prior_of_others(miss_k: float) -> None:
    found = fit_prior([told("a", 0.3), told("liar", miss_k)])
    assert all(np.isfinite([*shares.values()]).all() for shares in found.shares.values())


def test_a_new_kind_is_told_less(prior: FleetPrior) -> None:
    box = bare(replace(TwinFile(), fan_role="none"))
    known, new = (prior.start(box, kind).effects["wall_loss"]["UA"] for kind in ("tent", "never seen"))
    assert (new.rel_sd or 0.0) > 1.5 * (known.rel_sd or 0.0)


def test_a_larger_box_is_told_what_suits_its_heater(prior: FleetPrior) -> None:
    box = bare(replace(TwinFile(), fan_role="none"))
    large = replace(box, geometry={**box.geometry, "heater_max_w": Value(300.0)})
    one, three = (prior.start(item, "tent").effects["wall_loss"]["UA"].value for item in (box, large))
    assert three == pytest.approx(3.0 * one, rel=1e-4)


def test_no_box_is_no_prior() -> None:
    with pytest.raises(DataError, match="no box"):
        fit_prior([])
