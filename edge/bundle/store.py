"""Installed bundles on the disk: one folder a version, and one small file that says which does what.

    <store>/<version>/...       written once, then never changed
    <store>/roles.json          replaced whole; the only thing that activating changes
    <store>/lock                held while something is changed: command line and daemon take turns
    <store>/.incoming           an install under way, or what an interrupted one has left

Every file and folder is synced before the rename that gives it its name, and the folder after it, so a power
cut or a kill leaves the state before or the state after.
"""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import BinaryIO

from edge import state_file
from edge.bundle.archive import unpack
from edge.bundle.check import check_folder
from edge.bundle.durable import make_folder, move, sync_folder
from edge.bundle.manifest import MANIFEST, PACKAGED, VERSION, Manifest
from edge.bundle.roles import Roles, installed, rolled_back
from edge.errors import DataError, RequestError
from edge.forecasts.conformal import Intervals, read_intervals
from edge.models.base import Predictor
from edge.policy.from_bundle import load_policies
from edge.policy.onnx_policy import OnnxPolicy

PACKAGED_FOLDER = Path(__file__).parent.parent / "models" / "default_bundle"
INTERVALS = "intervals.json"
_INCOMING = ".incoming"
_DAMAGED = ".damaged"

Load = Callable[[Path, Manifest], Mapping[str, Predictor]]


@dataclass(frozen=True, slots=True)
class Loaded:
    """A bundle in memory."""

    name: str  # in the store: its version, or "packaged"
    manifest: Manifest
    predictors: Mapping[str, Predictor]
    intervals: Intervals = field(default_factory=Intervals)  # of their forecasts, where the bundle has them
    policies: Mapping[str, OnnxPolicy] = field(default_factory=dict)  # by controller


class Store:
    """Bundles under one folder. Every change checks the bundle that it is about, wholly, before.

    keys : folder of trusted public keys
    load : gives the models of a bundle's folder; raises DataError when they can't be used on this rig
    """

    def __init__(self, folder: Path, keys: Path, load: Load, packaged: Path = PACKAGED_FOLDER) -> None:
        self.folder = folder
        self._keys, self._load, self._packaged = keys, load, packaged

    def roles(self) -> Roles:
        """Which bundle does what. Errors: DataError when the file that says so can't be understood"""
        try:
            values = state_file.read(self.folder / "roles.json")
        except state_file.StateFileBroken as error:
            raise DataError(str(error)) from error
        return Roles() if values is None else _roles(self.folder / "roles.json", values)

    def versions(self) -> list[str]:
        """All that is installed, whole or not, by name."""
        if not self.folder.is_dir():
            return []
        return sorted(path.name for path in self.folder.iterdir() if path.is_dir() and path.name[0] != ".")

    def folder_of(self, version: str) -> Path:
        """Where a bundle lies, or would. Errors: RequestError for what is no version"""
        if not VERSION.fullmatch(version):
            raise RequestError(f"{version!r} is no version of a bundle")
        return self._packaged if version == PACKAGED else self.folder / version

    def load(self, version: str) -> Loaded:
        """A bundle whose signature and hashes are right and whose models work.

        Errors : DataError with the reason; RequestError when it is not installed
        """
        place = self.folder_of(version)
        if not place.is_dir():
            known = ", ".join([PACKAGED, *self.versions()])
            raise RequestError(f"bundle {version} is not installed; known: {known}")
        try:
            return self._checked(version, place)
        except DataError as error:
            raise DataError(f"bundle {version}: {error}") from error

    def verify(self, archive: BinaryIO) -> Loaded:
        """A bundle that is not installed, checked as for `install`. Errors: DataError"""
        with tempfile.TemporaryDirectory(prefix="greenhouse-bundle-") as folder:
            unpack(archive, Path(folder))
            return self._checked("", Path(folder))

    def install(self, archive: BinaryIO) -> Manifest:
        """Take a bundle in and let it run in shadow. Errors: DataError, and nothing has changed"""
        with self._lock():
            self._clear_garbage()
            incoming = self.folder / _INCOMING
            incoming.mkdir()
            try:
                unpack(archive, incoming)
                manifest = self._checked("", incoming).manifest
                self._take_in(incoming, manifest.version)
            finally:
                shutil.rmtree(incoming, ignore_errors=True)
            self._write(installed(self._roles_or_fresh(), manifest.version))
        return manifest

    def change(self, step: Callable[[Roles], Roles]) -> Roles:
        """Take a step of edge/bundle/roles.py. Errors: RequestError, DataError for a bundle that is unfit"""
        with self._lock():
            before = self._roles_or_fresh()
            after = step(before)
            if after.active != before.active:
                self.load(after.active)
            self._write(after)
        return after

    def roll_back(self) -> Roles:
        """To the previous bundle; where that is damaged, to the packaged one."""
        try:
            return self.change(rolled_back)
        except DataError:
            return self.change(lambda roles: Roles(PACKAGED, None, roles.shadow))

    def _checked(self, name: str, folder: Path) -> Loaded:
        manifest = check_folder(folder, self._keys)
        calibrated = INTERVALS in manifest.files
        intervals = read_intervals(folder / INTERVALS) if calibrated else Intervals()
        predictors, policies = self._load(folder, manifest), load_policies(folder, manifest)
        return Loaded(name or manifest.version, manifest, predictors, intervals, policies)

    def _take_in(self, incoming: Path, version: str) -> None:
        """Give the checked folder its name. A version never changes what it holds."""
        place = self.folder / version
        if place.exists():
            if self._is_whole(place):
                if (place / MANIFEST).read_bytes() == (incoming / MANIFEST).read_bytes():
                    return
                raise DataError(f"bundle {version} is installed and is another one: give it a new version")
            move(place, self.folder / _DAMAGED)  # the disk has spoilt it: the new one takes its place
        sync_folder(incoming)
        move(incoming, place)

    def _clear_garbage(self) -> None:
        """What interrupted installs have left; nobody else is at it, the lock is ours."""
        for name in (_INCOMING, _DAMAGED):
            if (self.folder / name).exists():
                shutil.rmtree(self.folder / name)

    def _is_whole(self, place: Path) -> bool:
        try:
            check_folder(place, self._keys)
        except DataError:
            return False
        return True

    def _roles_or_fresh(self) -> Roles:
        """A spoilt file is replaced by the next change; until then the packaged bundle is active."""
        try:
            return self.roles()
        except DataError:
            return Roles()

    def _write(self, roles: Roles) -> None:
        state_file.write(self.folder / "roles.json", asdict(roles))

    @contextmanager
    def _lock(self) -> Iterator[None]:
        """One process and thread at a time; a kill frees it. What the disk refuses is told as DataError."""
        try:
            make_folder(self.folder)
            descriptor = os.open(self.folder / "lock", os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, 0o640)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX)
                yield
            finally:
                os.close(descriptor)
        except OSError as error:
            raise DataError(f"{error.filename or self.folder}: {error.strerror or error}") from error


def _roles(path: Path, values: Mapping[str, object]) -> Roles:
    names = {key: _version(path, values.get(key)) for key in ("active", "previous", "shadow")}
    on_probation = values.get("on_probation")
    if names["active"] is None or not isinstance(on_probation, bool):
        raise DataError(f"{path}: does not say which bundle is active")
    return Roles(names["active"], names["previous"], names["shadow"], on_probation)


def _version(path: Path, value: object) -> str | None:
    if value is None:
        return None
    if not isinstance(value, str) or not VERSION.fullmatch(value):
        raise DataError(f"{path}: {value!r} is no version of a bundle")
    return value
