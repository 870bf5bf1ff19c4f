"""Policies in a bundle: named in the manifest, loaded with its models, absent in older bundles."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from bundles import FACTS, Workshop, answering, install, load_nothing, make_store
from contexts import context
from onnx_files import write_onnx
from policy_files import policy_file

from edge.__main__ import main
from edge.app.active_models import ActiveModels
from edge.bundle.check import check_folder
from edge.bundle.manifest import MANIFEST, parse_manifest
from edge.bundle.predictors import loader
from edge.bundle.sign import build_bundle, sign_folder
from edge.bundle.store import BundleStore
from edge.config import loading as config
from edge.core.errors import DataError
from edge.forecasts.skill import SkillState
from edge.models.policy_actions import command_of
from edge.models.policy_observation import FEATURES


def with_policies(workshop: Workshop, **facts: object) -> Path:
    folder = workshop.models("policies")
    policy_file(folder / "rl-off.onnx", favourite=3, **facts)
    policy_file(folder / "rl-tr-p.onnx", favourite=5, **facts)
    sign_folder(folder, FACTS, workshop.key)
    return folder


def loaded(workshop: Workshop, folder: Path):
    return BundleStore(workshop.folder / "store", workshop.trusted, load_nothing, folder).load("packaged")


def test_the_policies_of_a_bundle_are_loaded_by_controller(workshop: Workshop) -> None:
    policies = loaded(workshop, with_policies(workshop)).policies
    assert list(policies) == ["RL-Off", "RL-Tr-P"]
    assert [policy.name for policy in policies.values()] == list(policies)


def test_a_bundle_without_policies_says_nothing_of_them(workshop: Workshop) -> None:
    folder = workshop.signed_folder("plain")
    assert "policies" not in json.loads((folder / MANIFEST).read_text())
    assert check_folder(folder, workshop.trusted).policies == {}
    assert loaded(workshop, folder).policies == {}


def test_a_policy_for_another_step_spoils_the_bundle(workshop: Workshop) -> None:
    folder = with_policies(workshop, sample_s=30.0)
    with pytest.raises(DataError, match=r"rl-off\.onnx: sample_s: made for steps of 30 s"):
        loaded(workshop, folder)


@pytest.mark.parametrize(
    ("policies", "problem"),
    [
        ({"MPC": {"file": "rl-off.onnx", "kind": "onnx-policy"}}, "policies: unknown key 'MPC'"),
        (
            {"RL-Off": {"file": "none.onnx", "kind": "onnx-policy"}},
            "policies.RL-Off.file: 'none.onnx' is not",
        ),
        ({"RL-Off": {"file": "rl-off.onnx", "kind": "onnx"}}, "policies.RL-Off.kind: 'onnx' is not"),
    ],
)
def test_a_wrong_entry_is_refused_by_its_key(workshop: Workshop, policies, problem: str) -> None:
    document = json.loads((with_policies(workshop) / MANIFEST).read_text())
    with pytest.raises(DataError, match=problem):
        parse_manifest(json.dumps(document | {"policies": policies}).encode())


def test_a_changed_policy_breaks_the_signature(workshop: Workshop) -> None:
    folder = with_policies(workshop)
    shutil.copyfile(folder / "rl-off.onnx", folder / "rl-tr-p.onnx")
    with pytest.raises(DataError, match=r"rl-tr-p\.onnx"):
        check_folder(folder, workshop.trusted)


def test_the_command_names_the_policies(workshop: Workshop, capsys: pytest.CaptureFixture[str]) -> None:
    folder = with_policies(workshop)
    assert main(["bundle", "verify", str(folder), "--keys", str(workshop.trusted)]) == 0
    assert "models arx, pbm, policies RL-Off, RL-Tr-P" in capsys.readouterr().out


def test_controllers_have_the_policies_of_the_active_bundle(workshop: Workshop) -> None:
    place = BundleStore(workshop.folder / "store", workshop.trusted, loader(60.0), with_policies(workshop))
    with answering(place, workshop.folder) as keeper:
        controllers = ActiveModels(config.default(), keeper, SkillState()).controllers()
    assert controllers["RL-Off"].decide(context(24.0, 26.0)).command == command_of(3)
    assert controllers["RL-Tr-P"].decide(context(24.0, 26.0)).command == command_of(5)
    assert "RL-On-P" not in controllers  # nobody can choose it


def test_a_network_and_a_policy_of_any_origin_run_from_an_installed_bundle(workshop: Workshop) -> None:
    """Both are graphs that no training of this repository makes; their contracts alone speak for them."""
    folder = workshop.models("foreign")
    write_onnx(folder / "lstm.onnx", "window")
    policy_file(folder / "rl-off.onnx", favourite=3)
    build_bundle(folder, workshop.folder / "foreign.zip", FACTS, workshop.key)
    store = make_store(workshop, load=loader(60.0))
    bundle = store.load(install(store, workshop.folder / "foreign.zip"))
    past = {name: np.full(3, 20.0) for name in ("temp_air", "heater_duty", "fan_on")}
    found = bundle.predictors["lstm"].rollout(past, np.array([[[0.5, 0.0], [0.25, 0.0]]]), {})
    assert found.tolist() == [[20.5, 20.75]]
    observation = np.eye(len(FEATURES))[:1]
    assert bundle.policies["RL-Off"].values(observation).argmax(axis=1).tolist() == [3]
