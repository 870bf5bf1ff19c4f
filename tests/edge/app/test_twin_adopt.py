"""A diagnosis's twin: its file, its way into the running bundle and back, and who loads it."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from bundles import Workshop, answering, configured_rig
from contexts import context
from training_runs import BOX, box_run

from edge.__main__ import main
from edge.app.active_models import ActiveModels
from edge.bundle.predictors import loader
from edge.bundle.roles import is_adopted
from edge.bundle.sign import generate_key
from edge.bundle.store import PACKAGED_FOLDER, BundleStore
from edge.config import loading as config
from edge.core.errors import DataError
from edge.diagnosis.adopted_twin import AddedEffect, Origin, twin_after
from edge.forecasts.skill import SkillState
from edge.formats.run_file import data_sha256
from edge.models.pbm import read_twin
from edge.twin.schema import schema
from edge.twin.twin_file import TwinFile, read_twin_file, write_twin_file
from edge.twin.value import Value
from training.models import ham
from training.models.registry import HAM_GIVEN, TWIN_FILE, TWIN_GIVEN, over
from training.models.twin_step import TwinStep

pytestmark = pytest.mark.slow

SHA = "5" * 64  # of no bundle that a test makes
ORIGIN = Origin(
    data_sha256=SHA,
    before={"train": {"rmse_k": np.float64(0.41), "mae_k": 0.3}, "test": None},
    after={"train": {"rmse_k": 0.1, "mae_k": 0.08}, "test": None},
    created_utc="2026-07-01T12:00:00Z",
    further={"verdict": "named", "rounds": np.array([1.0]).tolist()},
)
LOSS = AddedEffect(
    "wall_loss",
    {"UA": Value(np.float64(5.1234567), low=np.float64(4.8), high=np.float64(5.4))},
    alternatives=("infiltration",),
    log_odds=np.float64(212.5),
)
KNOWN = TwinFile(
    effects={"fan_effectiveness": {"eps_f": Value(0.7, rel_sd=0.05)}},
    sensor={"quantisation_k": 0.1, "noise_sd_k": None},
    nuisance={"heater_power_run_sd": 0.015},
)


# the file


def test_the_twin_of_a_diagnosis_says_what_was_added_why_and_from_which_data(tmp_path: Path) -> None:
    after = twin_after(KNOWN, [LOSS], ORIGIN)
    write_twin_file(after, tmp_path / "twin.yaml")
    back = read_twin_file(tmp_path / "twin.yaml")
    assert back == after
    assert back.effects["wall_loss"]["UA"] == Value(5.12346, low=4.8, high=5.4)
    assert back.effects["fan_effectiveness"] == KNOWN.effects["fan_effectiveness"]
    assert (back.sensor, back.nuisance) == (KNOWN.sensor, KNOWN.nuisance)
    provenance = back.provenance
    assert provenance["added"]["wall_loss"]["alternatives"] == ["infiltration"]
    assert provenance["added"]["wall_loss"]["UA"] == {"value": 5.12346, "low": 4.8, "high": 5.4}
    assert provenance["before"]["train"]["rmse_k"] == 0.41
    assert provenance["data_sha256"] == SHA
    assert provenance["twin_before_sha256"] == KNOWN.twin().sha256
    assert provenance["software"].startswith("greenhouse-twin ")
    read_twin(tmp_path / "twin.yaml")  # every value is known
    jsonschema.validate(yaml.safe_load((tmp_path / "twin.yaml").read_text()), schema())


def test_values_that_the_data_moved_are_kept_with_their_intervals() -> None:
    file = replace(KNOWN, geometry={**KNOWN.geometry, "heater_max_w": Value(90.0, fit=True)})
    moved = {
        ("geometry", "heater_max_w"): Value(97.0, low=95.0, high=99.0),
        ("effects", "fan_effectiveness", "eps_f"): Value(0.72, rel_sd=0.05, low=0.7, high=0.74),
    }
    after = twin_after(file, [LOSS], ORIGIN, moved)
    assert after.to_fit() == []
    assert after.geometry["heater_max_w"] == Value(97.0, low=95.0, high=99.0)
    assert after.effects["fan_effectiveness"]["eps_f"].value == 0.72
    assert list(after.effects) == ["fan_effectiveness", "wall_loss"]


def test_a_rounded_value_does_not_leave_its_interval() -> None:
    edge = AddedEffect("wall_loss", {"UA": Value(4.00000049, low=4.0000005, high=4.0000006)})
    value = twin_after(KNOWN, [edge], ORIGIN).effects["wall_loss"]["UA"]
    assert value.low is not None
    assert value.high is not None
    assert value.low <= value.value <= value.high


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("wall_los", {"UA": 5.0}, "unknown effect 'wall_los'"),
        ("wall_loss", {}, "effects.wall_loss.UA: missing"),
        ("wall_loss", {"UA": 5.0, "G": 1.0}, "unknown parameter 'G'"),
        ("wall_loss", {"UA": -5.0}, "effects.wall_loss.UA: -5 is outside"),
        ("wall_loss", {"UA": float("nan")}, "effects.wall_loss.UA: nan is not a finite number"),
    ],
)
def test_an_effect_that_no_twin_can_have_is_refused(
    name: str, parameters: dict[str, float], message: str
) -> None:
    added = AddedEffect(name, {key: Value(value) for key, value in parameters.items()})
    with pytest.raises(DataError, match=message):
        twin_after(KNOWN, [added], ORIGIN)


# adopting


@dataclass(frozen=True)
class AdoptingRig:
    """A rig with a bundle of ARX and twin, a key that it trusts, and a report of a diagnosis."""

    workshop: Workshop
    report: Path

    @property
    def folder(self) -> Path:
        return self.workshop.folder

    @property
    def store(self) -> BundleStore:
        return BundleStore(self.folder / "rig" / "bundles", self.workshop.trusted, loader(60.0))

    def adopt(self, *words: object) -> int:
        return main(["twin", "adopt", "--config", str(self.folder / "edge.yaml"), *map(str, words)])

    def configure(self, *lines: str) -> None:
        with (self.folder / "edge.yaml").open("a") as file:
            file.writelines(f"{line}\n" for line in lines)


def write_report(folder: Path, twin: TwinFile, **document: object) -> Path:
    folder.mkdir(exist_ok=True)
    write_twin_file(twin, folder / "twin.yaml")
    content = {"verdict": "named", "effects": [{"name": "wall_loss"}], "twin_after": "twin.yaml", **document}
    (folder / "diagnosis.json").write_text(json.dumps(content))
    return folder


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AdoptingRig:
    workshop = configured_rig(tmp_path, monkeypatch, ", signing_key: {key}")
    return AdoptingRig(workshop, write_report(tmp_path / "report", twin_after(KNOWN, [LOSS], ORIGIN)))


def version_of(report: Path, base: str = "0") -> str:
    return f"{base}-twin-{read_twin(report / 'twin.yaml').twin.sha256[:8]}"


def test_a_new_twin_runs_in_shadow_until_it_is_told_to_take_over(
    rig: AdoptingRig, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rig.adopt(rig.report) == 0
    version = version_of(rig.report)
    out = capsys.readouterr().out
    assert f"active: packaged; shadow: {version}" in out
    assert "`control: {predictor: pbm}` makes it plan with the twin" in out
    loaded = rig.store.load(version)
    assert loaded.predictors["pbm"].version == read_twin(rig.report / "twin.yaml").version
    assert loaded.manifest.data_sha256 == SHA
    assert loaded.manifest.created_utc == ORIGIN.created_utc
    # A second time changes nothing.
    assert rig.adopt(rig.report) == 0
    assert rig.store.versions() == [version]
    # And back with one command.
    assert rig.adopt("--back") == 0
    assert (rig.store.roles().active, rig.store.roles().shadow) == ("packaged", None)
    assert rig.adopt("--back") == 2
    assert "no adopted twin runs: bundle packaged is active" in capsys.readouterr().err


def test_activated_it_is_on_probation_and_one_command_takes_it_back(rig: AdoptingRig) -> None:
    assert rig.adopt(rig.report, "--activate") == 0
    roles = rig.store.roles()
    assert (roles.active, roles.previous, roles.on_probation) == (version_of(rig.report), "packaged", True)
    assert rig.adopt("--back") == 0
    assert rig.store.roles().active == "packaged"


def test_a_second_diagnosis_builds_on_the_adopted_twin(
    rig: AdoptingRig, capsys: pytest.CaptureFixture[str]
) -> None:
    assert rig.adopt(rig.report, "--activate") == 0
    assert rig.adopt(rig.report) == 2
    assert "is the twin of bundle 0-twin-" in capsys.readouterr().err
    soil = AddedEffect("soil_mass", {"C_s": Value(9000.0), "G_s": Value(2.0)})
    first = read_twin_file(rig.report / "twin.yaml")
    second = write_report(rig.folder / "second", twin_after(first, [soil], ORIGIN))
    assert rig.adopt(second) == 0
    assert rig.store.roles().shadow == version_of(second)  # of one length however often
    assert rig.adopt("--back") == 0  # the last step first
    assert rig.store.roles().active == version_of(rig.report)


def test_a_running_daemon_has_it_when_the_command_ends(rig: AdoptingRig) -> None:
    with answering(rig.store, rig.folder) as keeper:
        assert rig.adopt(rig.report) == 0
        assert keeper.serving.rival.name == version_of(rig.report)
        assert rig.adopt(rig.report, "--activate") == 0
        assert keeper.serving.active.name == version_of(rig.report)
        assert rig.adopt("--back") == 0
        assert keeper.serving.active.name == "packaged"


@pytest.fixture
def refused(rig: AdoptingRig, capsys: pytest.CaptureFixture[str]) -> Iterator[object]:
    """Calls that are refused in one line and leave the store as it was."""

    def call(*words: object) -> str:
        capsys.readouterr()
        assert rig.adopt(*words) == 2
        assert rig.store.versions() == []
        [line] = capsys.readouterr().err.splitlines()
        return line.removeprefix("greenhouse twin: ")

    return call


def test_nothing_is_signed_without_a_key_that_is_named_and_trusted(rig: AdoptingRig, refused) -> None:
    stranger = rig.folder / "stranger.pem"
    generate_key(stranger)  # its public half is trusted by nobody
    assert "the signature is by none of the 1 trusted keys" in refused(rig.report, "--key", stranger)
    assert "nothing.pem" in refused(rig.report, "--key", rig.folder / "nothing.pem")
    text = (rig.folder / "edge.yaml").read_text()
    (rig.folder / "edge.yaml").write_text(text.replace(f"signing_key: {rig.workshop.key}", "signing_key: ''"))
    assert refused(rig.report).startswith("no key to sign with: --key FILE or bundle.signing_key")
    assert rig.adopt(rig.report, "--key", rig.workshop.key) == 0


@pytest.mark.parametrize(
    ("twin", "document", "message"),
    [
        (KNOWN, {"verdict": "nothing_missing", "twin_after": None}, "the verdict is nothing_missing"),
        (KNOWN, {"twin_after": None, "against_adopting": ["it is worse"]}, "to adopt: it is worse"),
        (
            replace(KNOWN, effects={"wall_loss": {"UA": Value(5.0, fit=True)}}),
            {},
            "effects.wall_loss.UA: is still to be fitted",
        ),
        (replace(KNOWN, sample_s=30.0), {}, "sample_s: 30, but bundle packaged is for 60 s"),
        (TwinFile(), {}, "is the twin of bundle packaged, which is active, already"),
        (KNOWN, {"twin_after": "other.yaml"}, "'other.yaml' is not a file of the report"),
    ],
)
def test_a_report_that_holds_no_new_twin_is_refused(
    rig: AdoptingRig, refused, twin: TwinFile, document: dict[str, object], message: str
) -> None:
    assert message in refused(write_report(rig.folder / "other", twin, **document))


def test_a_folder_that_is_no_report_is_told(rig: AdoptingRig, refused) -> None:
    assert "is this the folder of a diagnosis?" in refused(rig.folder)
    (rig.report / "diagnosis.json").write_text("{")
    assert "diagnosis.json: not JSON" in refused(rig.report)
    assert "give the folder of a diagnosis, or --back" in refused()
    assert "give the folder of a diagnosis, or --back" in refused(rig.report, "--back")


def test_a_bundle_for_another_rig_is_written_and_not_installed(
    rig: AdoptingRig, capsys: pytest.CaptureFixture[str]
) -> None:
    out = rig.folder / "out.zip"
    assert rig.adopt(rig.report, "--bundle-out", out) == 0
    assert rig.store.versions() == []
    assert main(["bundle", "--config", str(rig.folder / "edge.yaml"), "verify", str(out)]) == 0
    assert f"{version_of(rig.report)} of 2026-07-01T12:00:00Z, 60 s steps, models arx, pbm" in (
        capsys.readouterr().out
    )


def test_a_twin_file_is_replaced_and_put_back(rig: AdoptingRig, capsys: pytest.CaptureFixture[str]) -> None:
    target = rig.folder / "twin.yaml"
    target.write_text("sample_s: 60\n")
    assert rig.adopt(rig.report, "--to", target) == 0
    assert target.read_bytes() == (rig.report / "twin.yaml").read_bytes()
    assert rig.adopt("--back", "--to", target) == 0
    assert target.read_text() == "sample_s: 60\n"
    capsys.readouterr()
    assert rig.adopt("--back", "--to", target) == 2
    assert capsys.readouterr().err.endswith("twin.yaml.before: is not there, so nothing was replaced\n")
    assert rig.adopt(rig.report, "--to", rig.report / "twin.yaml") == 2
    assert rig.adopt(rig.report, "--to", rig.folder / "no" / "folder.yaml") == 2


def test_a_hybrid_of_the_twin_before_is_left_out_and_never_the_one_that_plans(
    rig: AdoptingRig, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(BundleStore.__init__, "__defaults__", (PACKAGED_FOLDER, None))
    shutil.copyfile(PACKAGED_FOLDER.with_suffix(".pub"), rig.workshop.trusted / "packaged.pub")
    rig.configure("control: {predictor: ham}")
    assert rig.adopt(rig.report) == 2
    assert "control.predictor is ham, and this rig's ham was trained on the twin before" in (
        capsys.readouterr().err
    )
    assert rig.store.versions() == []
    text = (rig.folder / "edge.yaml").read_text()
    (rig.folder / "edge.yaml").write_text(text.replace("predictor: ham", "predictor: pbm"))
    assert rig.adopt(rig.report) == 0
    assert "ham is left out, it corrects the twin before; `greenhouse-train ham --twin" in (
        capsys.readouterr().out
    )
    version = rig.store.roles().shadow
    assert is_adopted(version)
    assert set(rig.store.load(version).predictors) == {"arx", "pbm", "lstm"}


# who loads it


def test_the_adopted_twin_estimates_and_the_mpc_plans_with_it(rig: AdoptingRig) -> None:
    assert rig.adopt(rig.report, "--activate") == 0
    rig.configure("control: {predictor: pbm, controller: MPC}")
    settings = config.load(rig.folder / "edge.yaml")
    with answering(rig.store, rig.folder) as keeper:
        models = ActiveModels(settings, keeper, SkillState())
    adopted = read_twin(rig.report / "twin.yaml")
    assert models.model.version == adopted.version
    decision = models.controllers()["MPC"].decide(context(temp=24.0, reference=26.0))
    controls = np.array([[[decision.command.heater_duty, float(decision.command.fan_on)]]])
    history = {
        "temp_air": np.array([24.0]),
        "temp_ambient": np.array([21.0]),
        "heater_duty": np.array([np.nan]),
        "fan_on": np.array([np.nan]),
    }
    expected = adopted.rollout(history, controls, {"temp_ambient": np.array([21.0])})[0, 0]
    assert decision.forecast[0] == pytest.approx(expected, abs=1e-6)


def test_the_training_takes_a_twin_as_it_is_given(tmp_path: Path) -> None:
    runs = [box_run(1), box_run(2)]
    values = {
        effect: {name: Value(value) for name, value in own.items()} for effect, own in BOX.effects.items()
    }
    file = TwinFile(effects=values, provenance={"data_sha256": data_sha256(runs)})
    trained = over(file)[TWIN_GIVEN](runs, 0, None)
    assert trained.predictor.version == BOX.sha256[:12]
    assert trained.progress["twin_is_of_these_runs"] is True
    assert over(file)[TWIN_GIVEN](runs[:1], 0, None).progress["twin_is_of_these_runs"] is False
    trained.save(tmp_path, {"seed": 0})
    kept = read_twin_file(tmp_path / TWIN_FILE)
    assert kept.twin().sha256 == BOX.sha256
    assert kept.provenance["training"] == {"seed": 0}


def test_values_that_are_to_be_fitted_are_fitted_on_the_training_runs() -> None:
    truth = BOX.effects["wall_mass"]
    effects = {
        effect: {name: Value(value) for name, value in own.items()} for effect, own in BOX.effects.items()
    }
    effects["wall_mass"]["G_out"] = Value(8.0, fit=True)
    trained = over(TwinFile(effects=effects))[TWIN_GIVEN]([box_run(1), box_run(2)], 0, None)
    assert trained.predictor.twin.effects["wall_mass"]["G_out"] == pytest.approx(truth["G_out"], rel=0.02)


def test_the_hybrid_is_trained_over_the_given_twin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick = ham.GuardedHamSettings(epochs=1)
    monkeypatch.setattr(ham, "GuardedHamSettings", lambda: quick)
    file = read_twin_file(PACKAGED_FOLDER / "twin.yaml")
    trained = over(file)[HAM_GIVEN]([box_run(1), box_run(2)], 1, None)
    trained.save(tmp_path, {"regime": "interpolation"})
    assert read_twin_file(tmp_path / TWIN_FILE).twin().sha256 == file.twin().sha256
    assert trained.progress["twin_data_sha256"] == file.provenance["data_sha256"]
    assert trained.progress["validation_loss"] > 0.0


def test_a_network_refuses_a_twin_that_it_can_not_hold_and_names_the_effects() -> None:
    effects = {"wall_loss": {"UA": 5.0}, "heater_sag": {"sag": 0.1}, "constant_heat": {"P0": 3.0}}
    with pytest.raises(DataError, match="twin: heater_sag, constant_heat: acts on the inputs"):
        TwinStep.of(replace(BOX, effects=effects))
    with pytest.raises(DataError, match="sample_s: 30, but the runs are trained on at 60 s"):
        over(TwinFile(sample_s=30.0))
