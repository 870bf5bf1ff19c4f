"""Small signed bundles for tests: a real ARX model and a real twin, no network."""

import shutil
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from edge.bundle import signature
from edge.bundle.archive import open_archive
from edge.bundle.keeper import BundleKeeper
from edge.bundle.manifest import Manifest
from edge.bundle.sign import ManifestFacts, build_bundle, generate_key, sign_folder
from edge.bundle.store import BundleStore, Load, Prove
from edge.core.clock import RealClock
from edge.core.predictor import Predictor
from edge.models.arx_file import DEFAULT_PATH
from edge.sockets.control_socket import ControlSocket

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


def make_store(
    workshop: Workshop, *installed: str, load: Load = load_nothing, prove: Prove | None = None
) -> BundleStore:
    """A store whose packaged bundle is version 0, and in which these versions were installed."""
    packaged = workshop.folder / "packaged"
    if not packaged.exists():
        workshop.signed_folder("packaged", version="0")
    store = BundleStore(workshop.folder / "store", workshop.trusted, load, packaged, prove)
    for version in installed:
        install(store, workshop.archive(version))
    return store


def configured_rig(folder: Path, monkeypatch: pytest.MonkeyPatch, bundle: str = "") -> Workshop:
    """A rig with edge.yaml and a packaged bundle, and a person who signs.

    bundle : further keys of the section, with the workshop's in braces
    """
    workshop = Workshop(folder)
    packaged = workshop.signed_folder("packaged", version="0")
    monkeypatch.setattr(BundleStore.__init__, "__defaults__", (packaged, None))
    monkeypatch.setattr(signature, "PACKAGED_KEY", folder / "none.pub")
    more = bundle.format(key=workshop.key)
    (folder / "edge.yaml").write_text(
        f"control_socket: {{path: {folder}/control.sock}}\n"
        f"bundle: {{path: {folder}/rig/bundles, trusted_keys: {workshop.trusted}{more}}}\n"
    )
    return workshop


@contextmanager
def answering(store: BundleStore, folder: Path) -> Iterator[BundleKeeper]:
    """The part of a running daemon that answers for bundles, at `folder`/control.sock."""
    with (
        closing(BundleKeeper(store, RealClock(), automatic=False, trial_ticks=10)) as keeper,
        closing(ControlSocket(folder / "control.sock", keeper.answer, lambda *_: None)),
    ):
        yield keeper
