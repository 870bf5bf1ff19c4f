"""Which predictor a configuration gets, which is refused, and what is done in the asker's thread."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from history_records import store, tick

from edge.__main__ import main
from edge.app.active_models import ActiveModels, configured_model
from edge.app.daemon import Daemon
from edge.app.request_routes import resend
from edge.bundle.keeper import Serving
from edge.bundle.predictors import loader
from edge.bundle.store import PACKAGED_FOLDER, BundleStore
from edge.config import loading as config
from edge.config.settings import ControlSettings, HistorySettings, Settings
from edge.controllers.rules import Rules
from edge.core.clock import RealClock
from edge.core.controller_names import EXTERNAL, MPC, RL
from edge.core.errors import ConfigError, DataError, RequestError
from edge.forecasts.skill import SkillState
from edge.formats.atomic_file import write_document
from edge.models.arx_file import DEFAULT_PATH, read_arx, write_arx
from edge.models.persistence import Persistence
from edge.mqtt.commands import Resend, parse
from edge.safety.supervisor import SafetyMemory
from edge.state.codecs import StandingState, encode_standing
from edge.tick.orders import Operation, operate


def test_the_packaged_model_serves_the_default_step() -> None:
    assert configured_model(ControlSettings()).version == read_arx(DEFAULT_PATH).version


def test_a_model_file_of_ones_own_comes_first(tmp_path: Path) -> None:
    write_arx(read_arx(DEFAULT_PATH), tmp_path / "own.json", {"source": "a copy"})
    model = configured_model(ControlSettings(model=str(tmp_path / "own.json")))
    assert model.version == read_arx(tmp_path / "own.json").version != read_arx(DEFAULT_PATH).version


@pytest.mark.parametrize("step_s", [1.0, 59.9, 60.1, 600.0])
@pytest.mark.parametrize("controller", ["MPC", "MPC-BFGS-P"])
def test_a_model_for_another_step_is_refused(step_s: float, controller: str) -> None:
    settings = ControlSettings(step_s=step_s, controller=controller)
    with pytest.raises(ConfigError, match=rf"made for steps of 60 s, control\.step_s is {step_s:g}"):
        configured_model(settings)


@pytest.mark.parametrize("step_s", [1.0, 59.9, 60.1, 600.0])
def test_rules_run_at_any_step(step_s: float) -> None:
    model = configured_model(ControlSettings(step_s=step_s, controller="rules"))
    assert isinstance(model, Persistence)
    assert model.step_s == step_s


def test_rules_at_the_models_own_step_keep_the_model() -> None:
    assert configured_model(ControlSettings(controller="rules")).name == "arx"


def test_a_named_model_for_another_step_is_refused_even_to_rules() -> None:
    with pytest.raises(ConfigError, match=r"default_arx\.json is made for steps of 60 s"):
        configured_model(ControlSettings(step_s=1.0, controller="rules", model=str(DEFAULT_PATH)))


def test_a_missing_model_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="none\\.json"):
        configured_model(ControlSettings(model=str(tmp_path / "none.json")))


def test_persistence_forecasts_the_newest_temperature_whatever_the_inputs() -> None:
    controls = np.random.default_rng(1).random((3, 5, 2))
    forecast = Persistence(1.0).rollout({"temp_air": np.array([20.0, 24.5])}, controls, {})
    assert forecast.shape == (3, 5)
    assert (forecast == 24.5).all()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("control: {step_s: 5}", "control.model"),
        ("reference: {kind: csv, csv: /nowhere/profile.csv}", "/nowhere/profile.csv"),
        ("control: {model: /nowhere/arx.json}", "/nowhere/arx.json"),
    ],
)
def test_check_config_refuses_what_the_daemon_would(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, reason: str
) -> None:
    (tmp_path / "edge.yaml").write_text(text)
    assert main(["check-config", str(tmp_path / "edge.yaml")]) == 2
    assert reason in capsys.readouterr().err


def test_check_config_takes_rules_at_another_step(tmp_path: Path) -> None:
    (tmp_path / "edge.yaml").write_text("control: {step_s: 5, controller: rules}")
    assert main(["check-config", str(tmp_path / "edge.yaml")]) == 0


PLACES = """
state_file: {folder}/state.json
control_socket: {{path: {folder}/daemon.sock}}
history: {{path: {folder}/history.db}}
bundle: {{path: {folder}/bundles, trusted_keys: {folder}/keys}}
board: {{port: {folder}/no-board}}
control: {{step_s: 5, controller: rules}}
"""


def test_a_controller_chosen_when_there_was_a_model_gives_way_to_the_configured_one(tmp_path: Path) -> None:
    settings = config.parse(PLACES.format(folder=tmp_path))
    orders = StandingState(Operation("MPC", reference_c=27.0), SafetyMemory())
    write_document(tmp_path / "state.json", encode_standing(orders))
    with Daemon(settings, RealClock()) as daemon:
        assert daemon._loop is not None
        standing = daemon._loop.status().operation
    assert standing.controller == "rules"
    assert standing.reference_c == 27.0


def models_of(bundle: str, **control: Any) -> ActiveModels:
    """Models of a rig whose active bundle is the packaged one under a name; it has a twin."""
    packaged = BundleStore(Path("none"), Path("none"), loader(60.0)).load_folder(PACKAGED_FOLDER, bundle)
    settings = Settings(control=ControlSettings(**control))
    return ActiveModels(settings, SimpleNamespace(serving=Serving(packaged)), SkillState())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("bundle", "control", "first", "why"),
    [
        ("packaged", {}, "MPC-P", "no bundle with a twin of this rig"),
        ("2026.1", {}, "MPC-Twin-P", "bundle 2026.1 has a twin"),
        ("2026.1", {"controller": "PID"}, "PID", "control.controller"),
    ],
)
def test_a_twin_of_this_rig_controls_it_unless_another_is_configured(
    bundle: str, control: dict[str, str], first: str, why: str
) -> None:
    name, reason = models_of(bundle, **control).first_controller()
    assert name == first and reason.startswith(why)


def test_an_installed_bundle_without_a_twin_leaves_the_rig_to_the_arx() -> None:
    models = models_of("2026.1")
    bundle = models._serving.active  # type: ignore[union-attr]
    without = {name: model for name, model in bundle.predictors.items() if name != "pbm"}
    models._serving = Serving(replace(bundle, predictors=without))
    assert models.first_controller()[0] == "MPC-P"


def test_a_policy_is_offered_as_long_as_the_active_bundle_has_it() -> None:
    models = models_of("2026.1")
    controllers = {**models.controllers(), EXTERNAL: Rules()}
    assert set(RL) < set(controllers)
    active = models._serving.active  # type: ignore[union-attr]
    models._keeper.serving = Serving(replace(active, policies={}))  # type: ignore[union-attr]
    models.exchange(SimpleNamespace(), controllers)  # type: ignore[arg-type]
    assert not set(RL) & set(controllers)
    assert {EXTERNAL, *MPC} < set(controllers)


def test_without_a_bundle_no_policy_can_be_chosen_by_any_door(tmp_path: Path) -> None:
    text = PLACES.replace("control: {{step_s: 5, controller: rules}}", "")
    settings = config.parse(text.format(folder=tmp_path))
    settings = replace(settings, bundle=replace(settings.bundle, path=""))
    with Daemon(settings, RealClock()) as daemon:
        assert daemon._loop is not None
        for name in RL:
            request = parse("controller", name.encode(), daemon.settings.reference)  # over MQTT
            with pytest.raises(RequestError, match=f"{name} needs bundle.path"):
                operate(Operation("MPC"), request, daemon._loop._desk())
        assert not set(RL) & set(daemon.settings.controllers)


def test_the_first_start_says_who_controls(tmp_path: Path) -> None:
    text = PLACES.replace("control: {{step_s: 5, controller: rules}}", "")
    with Daemon(config.parse(text.format(folder=tmp_path)), RealClock()) as daemon:
        assert daemon._loop is not None
        assert daemon._loop.status().operation.controller == "MPC-P"
        (event,) = (own for own in daemon._loop._events.take() if own.key == "controller.chosen")
    assert event.text.startswith("MPC-P controls: no bundle")


def test_an_experiment_with_a_controller_that_needs_a_model_is_refused(tmp_path: Path) -> None:
    settings = config.parse(PLACES.format(folder=tmp_path))
    with (
        pytest.raises(ConfigError, match="MPC needs a model for 5 s"),
        Daemon(settings, RealClock(), experiment="MPC"),
    ):
        pass


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """With a history of three ticks, all waiting to be sent."""
    store(tmp_path / "history.db", *(tick(seq) for seq in (1, 2, 3)))
    return replace(config.default(), history=HistorySettings(path=str(tmp_path / "history.db")))


@pytest.mark.parametrize(("first", "last", "queued"), [(1, 1, 1), (2, 3, 2), (1, 2**63 - 1, 3), (9, 9, 0)])
def test_a_span_of_numbers_is_queued_again(settings: Settings, first: int, last: int, queued: int) -> None:
    answer = {"ok": True, "queued": queued, "first_seq": first, "last_seq": last}
    assert resend(settings, Resend(first, last)) == answer


def test_a_resend_without_a_history_is_refused_and_makes_none(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    settings = replace(config.default(), history=HistorySettings(path=str(path)))
    assert not resend(settings, Resend(1, 2))["ok"]
    assert not path.exists()
