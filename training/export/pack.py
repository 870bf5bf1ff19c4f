"""Packing of a training's results as a bundle: files in one folder, calibrated, signed.

`greenhouse-train bundle` takes of each kind the training whose validation error is lowest; test runs have no
say. The ARX is the packaged one (`make model`), which the MPC plans with.
"""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edge.bundle.manifest import MANIFEST, SIGNATURE
from edge.bundle.sign import POLICY_FILES, ManifestFacts, build_bundle, generate_key, sign_folder
from edge.models.arx_file import DEFAULT_PATH
from training.data.datasets import data_sha256, training_runs
from training.export.network_export import export_study
from training.models.registry import TWIN_FILE
from training.models.study import Regime, versions
from training.models.summary import best_seed, records
from training.rl.saved_policy import FOLDERS, POLICY_FILE, best_folder, read_record

PACKAGED = DEFAULT_PATH.parent / "default_bundle"
KEY = Path("out/keys/signing.pem")
REGIME: Regime = "interpolation"  # what a rig gets has seen all that there is
HYBRID, NETWORK = "ham_guarded", "lstm"
REPORT = "report.json"


@dataclass(frozen=True, slots=True)
class BundleParts:
    """Sources of the bundle's files."""

    lstm: Path
    hybrid: Path


def gather(out: Path, folder: Path, hybrid_name: str = HYBRID, network_name: str = NETWORK) -> dict[str, Any]:
    """Fill `folder` with the models of a bundle and a report of them; the report.

    out : of `greenhouse-train all`
    hybrid_name : the training whose network and twin are taken, "ham_given" for one over a given twin
    network_name : the training in the place of the LSTM
    Errors : DataError where a training is missing or a graph does not prove its contract
    """
    found = records(out)
    _empty(folder)
    seeds = {name: best_seed(found, name, REGIME) for name in (network_name, hybrid_name)}
    parts = BundleParts(lstm=_folder(out, network_name, seeds), hybrid=_folder(out, hybrid_name, seeds))
    shutil.copyfile(DEFAULT_PATH, folder / "arx.json")
    shutil.copyfile(parts.hybrid / TWIN_FILE, folder / TWIN_FILE)
    lstm = export_study(parts.lstm, folder / "lstm.onnx")
    hybrid = export_study(parts.hybrid, folder / "ham.onnx")
    report = {
        "regime": REGIME,
        "seeds": seeds,
        "versions": {"lstm": lstm.version, "ham": hybrid.version},
        "errors": {name: _errors(found, name, seed) for name, seed in seeds.items()},
    }
    (folder / REPORT).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    return report


def gather_packaged(folder: Path) -> None:
    """Fill `folder` with the models of the bundle that ships with the software, as they are."""
    _empty(folder)
    for path in PACKAGED.iterdir():
        if path.name not in (MANIFEST, SIGNATURE):
            shutil.copyfile(path, folder / path.name)


def add_policies(policies: Path, folder: Path) -> None:
    """Put the best policy of each controller among the models of `folder`, and into their report.

    policies : of `greenhouse-train rl` and `rl-online`; best in validation, the rig has no say
    Errors : DataError where a controller's is missing
    """
    chosen = {name: best_folder(sorted((policies / place).glob("seed_*"))) for name, place in FOLDERS.items()}
    for name, source in chosen.items():
        shutil.copyfile(source / POLICY_FILE, folder / POLICY_FILES[name])
    report = json.loads((folder / REPORT).read_text(encoding="utf-8"))
    records = {name: read_record(source) for name, source in chosen.items()}
    report["policies"] = {
        name: {key: record[key] for key in ("model", "seed", "policy", "metrics")}
        for name, record in records.items()
    }
    (folder / REPORT).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def facts(version: str) -> ManifestFacts:
    """Return the facts of a bundle that is made now from the recorded runs."""
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return ManifestFacts(version, created, data_sha256(training_runs(REGIME)), software=versions())


def pack_file(folder: Path, version: str, out: Path, key: Path) -> None:
    """Pack the folder as a signed archive for `greenhouse bundle install`."""
    build_bundle(folder, out, facts(version), key)


def pack_default(folder: Path, version: str, key: Path) -> None:
    """Pack the folder as the bundle that ships with the software, with its public key."""
    if not key.exists():
        key.parent.mkdir(parents=True, exist_ok=True)
        generate_key(key)
    if PACKAGED.exists():
        shutil.rmtree(PACKAGED)
    shutil.copytree(folder, PACKAGED)
    sign_folder(PACKAGED, facts(version), key)
    shutil.copyfile(key.with_suffix(".pub"), PACKAGED.with_suffix(".pub"))


def _empty(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        old.unlink()


def _folder(out: Path, name: str, seeds: Mapping[str, int]) -> Path:
    return out / name / REGIME / f"seed_{seeds[name]}"


def _errors(found: list[Mapping[str, Any]], name: str, seed: int) -> dict[str, float]:
    """Free-run MAE of each test run [K]."""
    one = next(
        record
        for record in found
        if (record["model"], record["regime"], record["seed"]) == (name, REGIME, seed)
    )
    return {scenario: values["free_run"]["mae_k"] for scenario, values in one["scenarios"].items()}
