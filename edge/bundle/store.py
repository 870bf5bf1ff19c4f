"""Installed bundles on the disk: one folder a version, and one small file that says which does what.

    <store>/<version>/...       written once, then never changed
    <store>/roles.json          replaced whole; the only thing that activating changes
    <store>/admitted.json       the newest version installed so far, and which bundles were proved
    <store>/lock                held while something is changed: command line and daemon take turns
    <store>/.incoming           an install under way, or what an interrupted one has left

Every file and folder is synced before the rename that gives it its name, and the folder after it, so a power
cut or a kill leaves the state before or the state after.
"""

import hashlib
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import BinaryIO

from edge.bundle.archive import unpack
from edge.bundle.check import check_folder, read_checked
from edge.bundle.manifest import MANIFEST, PACKAGED, VERSION, Manifest, Sha256
from edge.bundle.roles import Roles, add_shadow, rolled_back
from edge.core.errors import DataError, RequestError
from edge.core.predictor import Predictor
from edge.forecasts.conformal import Intervals, read_intervals
from edge.formats.atomic_file import hold_lock, move, read_document, sync_folder, write_document
from edge.formats.cross_check import REQUIRED
from edge.formats.input_file import Folder, MemoryFolder, read_file
from edge.formats.reader import read
from edge.models.onnx_policy import OnnxPolicy, read_policy

FILE = "admitted.json"
PROVED_MAX = 64  # the newest ones; a bundle that falls out is proved again when it is loaded
_RELEASE = re.compile(r"\d{1,9}(?:\.\d{1,9})*")


@dataclass(frozen=True, slots=True)
class Admission:
    """newest : version of the newest bundle, by number; "" before the first; proved : sha256 of manifests."""

    newest: str = field(default="", metadata=REQUIRED)
    proved: tuple[Sha256, ...] = field(default=(), metadata=REQUIRED)

    def with_install(self, version: str, manifest_sha256: str) -> "Admission":
        """Return the record after an install. An older bundle that the operator
        allowed sets `newest` back.
        """
        others = tuple(sha256 for sha256 in self.proved if sha256 != manifest_sha256)
        return replace(self, newest=version, proved=(*others, manifest_sha256)[-PROVED_MAX:])


def release(version: str) -> tuple[int, ...]:
    """Return the leading numbers of a version, for comparisons: (2,) for "2.0-twin-3f2a", () without any."""
    found = _RELEASE.match(version)
    numbers = [int(part) for part in found[0].split(".")] if found else []
    while numbers and numbers[-1] == 0:  # 2.0 is 2
        numbers.pop()
    return tuple(numbers)


def read_admission(folder: Path) -> Admission | None:
    """Read the store's record, None where there is none. Errors: DataError"""
    path = folder / FILE
    values = read_document(path)
    if values is None:
        return None
    return read(Admission, values, str(path))


def write_admission(folder: Path, admitted: Admission) -> None:
    """Replace the record. Errors: OSError"""
    write_document(folder / FILE, asdict(admitted))


def load_policies(folder: Folder, manifest: Manifest) -> dict[str, OnnxPolicy]:
    """Policies by the controller that they are for, in the manifest's order; each proved as it is read.

    folder : a bundle whose hashes have been checked
    Errors : DataError beginning with the file
    """
    return {
        name: read_policy(folder / entry.file, name, manifest.sample_s)
        for name, entry in manifest.policies.items()
    }


PACKAGED_FOLDER = Path(__file__).parent.parent / "models" / "default_bundle"
INTERVALS = "intervals.json"
LOCK = "lock"
_INCOMING = ".incoming"
_DAMAGED = ".damaged"

Load = Callable[[Folder, Manifest], Mapping[str, Predictor]]
Prove = Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class LoadedBundle:
    """A bundle in memory."""

    name: str  # in the store: its version, or "packaged"
    manifest: Manifest
    predictors: Mapping[str, Predictor]
    intervals: Intervals = field(default_factory=Intervals)  # of their forecasts, where the bundle has them
    policies: Mapping[str, OnnxPolicy] = field(default_factory=dict)  # by controller


class BundleStore:
    """Bundles under one folder. Every change checks the bundle that it is about, wholly, before.

    keys : folder of trusted public keys
    load : gives the models of a bundle's folder; raises DataError when they can't be used on this rig
    prove : does so in a process of its own, before this process loads a bundle that was not proved yet; None
        where every bundle is the caller's own
    """

    def __init__(
        self,
        folder: Path,
        keys: Path,
        load: Load,
        packaged: Path = PACKAGED_FOLDER,
        prove: Prove | None = None,
    ) -> None:
        self.folder = folder
        self._keys, self._load, self._packaged, self._prove = keys, load, packaged, prove

    def roles(self) -> Roles:
        """Which bundle does what. Errors: DataError when the file that says so can't be understood"""
        values = read_document(self.folder / "roles.json")
        return Roles() if values is None else read(Roles, values, str(self.folder / "roles.json"))

    def versions(self) -> list[str]:
        """All that is installed, whole or not, by name."""
        if not self.folder.is_dir():
            return []
        return sorted(path.name for path in self.folder.iterdir() if path.is_dir() and path.name[0] != ".")

    def folder_of(self, version: str) -> Path:
        """Return the folder of a bundle, installed or not. Errors: RequestError for an invalid version"""
        if not VERSION.fullmatch(version):
            raise RequestError(f"{version!r} is no version of a bundle")
        return self._packaged if version == PACKAGED else self.folder / version

    def load(self, version: str) -> LoadedBundle:
        """Load a bundle whose signature and hashes are right and whose models work.

        Errors : DataError with the reason; RequestError when it is not installed
        """
        place = self.folder_of(version)
        if not place.is_dir():
            known = ", ".join([PACKAGED, *self.versions()])
            raise RequestError(f"bundle {version} is not installed; known: {known}")
        try:
            if self._prove is not None and version != PACKAGED and not self._is_proved(place):
                self._prove(place)
            return self.load_folder(place, version)
        except DataError as error:
            raise DataError(f"bundle {version}: {error}") from error

    def read_bundle(self, version: str) -> tuple[Manifest, MemoryFolder]:
        """Return manifest and files of an installed bundle; its models are not tried. Errors: DataError,
        RequestError
        """
        return read_checked(self.folder_of(version), self._keys)

    def load_folder(self, folder: Path, name: str = "") -> LoadedBundle:
        """Load the bundle in `folder`; the bytes that were checked are those
        that are loaded. Errors: DataError
        """
        manifest, files = read_checked(folder, self._keys)
        calibrated = INTERVALS in manifest.files
        intervals = read_intervals(files / INTERVALS) if calibrated else Intervals()
        predictors, policies = self._load(files, manifest), load_policies(files, manifest)
        return LoadedBundle(name or manifest.version, manifest, predictors, intervals, policies)

    def verify(self, archive: BinaryIO) -> Manifest:
        """Check a bundle that is not installed, as for `install`. Errors: DataError"""
        with tempfile.TemporaryDirectory(prefix="greenhouse-bundle-") as folder:
            unpack(archive, Path(folder))
            manifest = check_folder(Path(folder), self._keys)
            self._try_models(Path(folder))
            return manifest

    def install(self, archive: BinaryIO, allow_older: bool = False) -> Manifest:
        """Take a bundle in and let it run in shadow. Errors: DataError, and nothing has changed

        allow_older : the operator's word for a version below the newest that was installed
        """
        with hold_lock(self.folder / LOCK):
            self._clear_garbage()
            admitted = self._admission(allow_older)
            incoming = self.folder / _INCOMING
            incoming.mkdir()
            try:
                unpack(archive, incoming)
                manifest = check_folder(incoming, self._keys)
                newest = self._newest(admitted.newest, manifest.version, allow_older)
                self._try_models(incoming)
                digest = _manifest_sha256(incoming)
                self._take_in(incoming, manifest.version)
            finally:
                shutil.rmtree(incoming, ignore_errors=True)
            write_admission(self.folder, admitted.with_install(newest, digest))
            self._write(add_shadow(self._roles_or_fresh(), manifest.version))
        return manifest

    def change(self, step: Callable[[Roles], Roles]) -> Roles:
        """Take a step of edge/bundle/roles.py. Errors: RequestError, DataError for a bundle that is unfit"""
        with hold_lock(self.folder / LOCK):
            before = self._roles_or_fresh()
            after = step(before)
            if after.active != before.active:
                self.load(after.active)
            self._write(after)
        return after

    def roll_back(self, version: str | None = None) -> Roles:
        """To the previous bundle; where that is damaged, to the packaged one. version : that is to be left"""
        try:
            return self.change(partial(rolled_back, version=version))
        except DataError:
            return self.change(lambda roles: Roles(PACKAGED, None, roles.shadow))

    def _try_models(self, folder: Path) -> None:
        if self._prove is None:
            self.load_folder(folder)
        else:
            self._prove(folder)

    def _is_proved(self, place: Path) -> bool:
        try:
            admitted = read_admission(self.folder)
            return admitted is not None and _manifest_sha256(place) in admitted.proved
        except (DataError, OSError):
            return False

    def _admission(self, allow_older: bool) -> Admission:
        """Return the record. Without one the installed bundles count; a spoilt one needs the operator."""
        try:
            admitted = read_admission(self.folder)
        except DataError as error:
            if not allow_older:
                raise DataError(f"{error}; --allow-older begins it anew") from error
            return Admission()
        return admitted or Admission(max(self.versions(), key=release, default=""))

    def _newest(self, newest: str, version: str, allow_older: bool) -> str:
        """Return the newest version after an install. Errors: DataError for an
        older one that was not asked for

        A bundle made from the active one (another twin) is no older than that.
        """
        if allow_older or release(version) >= release(newest):
            return version
        active = self._roles_or_fresh().active
        if active == PACKAGED:
            active = check_folder(self._packaged, self._keys).version
        if release(version) and release(version) == release(active):
            return newest
        raise DataError(
            f"bundle {version} is older than {newest}, which was installed before; --allow-older takes it in"
        )

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
        """Remove the remains of interrupted installs. The lock keeps other processes out."""
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
        """Return the roles. A spoilt file is replaced by the next change; until
        then the packaged bundle is active.
        """
        try:
            return self.roles()
        except DataError:
            return Roles()

    def _write(self, roles: Roles) -> None:
        write_document(self.folder / "roles.json", asdict(roles))


def _manifest_sha256(folder: Path) -> str:
    return hashlib.sha256(read_file(folder / MANIFEST)).hexdigest()
