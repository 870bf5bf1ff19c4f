"""Small signed bundles for tests: a real ARX model and a real twin, no network."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from edge.bundle.archive import open_archive
from edge.bundle.manifest import Manifest
from edge.bundle.sign import ManifestFacts, build_bundle, generate_key, sign_folder
from edge.bundle.store import BundleStore, Load, Prove
from edge.core.predictor import Predictor
from edge.models.arx_file import DEFAULT_PATH

FACTS = ManifestFacts(version="1.0", created_utc="2026-07-01T12:00:00Z", data_sha256="d" * 64)


@dataclass(frozen=True, slots=True)
class Workshop:
    """A place with a signing key, and the folder of public keys that a rig trusts."""

    folder: Path
    key: Path = field(init=False)
    trusted: Path = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", self.folder / "signing.pem")
        object.__setattr__(self, "trusted", self.folder / "trusted")
        self.trusted.mkdir()
        shutil.move(generate_key(self.key), self.trusted)

    def models(self, name: str = "models") -> Path:
        """A fresh folder of models."""
        folder = self.folder / name
        folder.mkdir()
        shutil.copyfile(DEFAULT_PATH, folder / "arx.json")
        (folder / "twin.yaml").write_text("sample_s: 60\n")
        (folder / "report.json").write_text("{}\n")
        return folder

    def archive(self, version: str, **facts: object) -> Path:
        """A signed archive of fresh models; its report differs from version to version."""
        models = self.models(f"models-{version}")
        (models / "report.json").write_text(f'{{"version": "{version}"}}\n')
        out = self.folder / f"{version}.zip"
        build_bundle(models, out, replace(FACTS, version=version, **facts), self.key)
        shutil.rmtree(models)
        return out

    def signed_folder(self, name: str, **facts: object) -> Path:
        """The same as a folder."""
        folder = self.models(name)
        sign_folder(folder, replace(FACTS, **facts), self.key)
        return folder


def load_nothing(folder: Path, manifest: Manifest) -> Mapping[str, Predictor]:
    """For tests that are not about models."""
    return {}


def install(store: BundleStore, source: Path) -> str:
    """The version that was installed."""
    with open_archive(source) as archive:
        return store.install(archive).version


def make_store(workshop: Workshop, load: Load = load_nothing, prove: Prove | None = None) -> BundleStore:
    """A store whose packaged bundle is version 0."""
    packaged = workshop.folder / "packaged"
    if not packaged.exists():
        workshop.signed_folder("packaged", version="0")
    return BundleStore(workshop.folder / "store", workshop.trusted, load, packaged, prove)
