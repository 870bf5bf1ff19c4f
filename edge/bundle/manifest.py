"""manifest.json of a bundle: what is in it, for which sample time, from which data, for which software."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from typing import Annotated, Literal

from edge.core.controller_names import RL
from edge.core.names import ACTUATORS, SIGNALS
from edge.core.plain_text import quote
from edge.core.version import __version__
from edge.formats.cross_check import REQUIRED, CheckedDocument, Rule
from edge.formats.reader import parse_json, read

MANIFEST = "manifest.json"
SIGNATURE = "manifest.sig"
PACKAGED = "packaged"  # the bundle that ships with the software; no other bundle may be called so
MODELS = {"arx": "arx-json", "pbm": "twin-yaml", "lstm": "onnx", "ham": "onnx"}  # model -> kind of its file
POLICY = "onnx-policy"  # kind of a policy's file
TWIN = "twin.yaml"
UNITS = {
    "step": "s",
    "temp_air": SIGNALS["temp_air"].unit,
    "temp_ambient": SIGNALS["temp_ambient"].unit,
    "heater_duty": ACTUATORS["heater_duty"].unit,
    "fan_on": ACTUATORS["fan_on"].unit,
}

Version = Annotated[str, Rule(pattern=r"[0-9A-Za-z][0-9A-Za-z._-]{0,63}")]
SHA256 = re.compile(r"[0-9a-f]{64}")
Sha256 = Annotated[str, Rule(pattern=SHA256.pattern)]
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")  # flat: no folder, nothing hidden, no ".."
VERSION = re.compile(r"[0-9A-Za-z][0-9A-Za-z._-]{0,63}")


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of the bundle."""

    sha256: Sha256
    size: Annotated[int, Rule(low=0)]  # [bytes]


@dataclass(frozen=True, slots=True)
class ModelEntry:
    """Which file holds a model or a policy, and how it is to be read (a value of MODELS, POLICY)."""

    file: str
    kind: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest(CheckedDocument):
    """All that is said of a bundle; the signature covers its exact bytes.

    policies : by the controller that they are for; the key is absent where there are none, as in every
        bundle that was made before there were any
    """

    format: Literal[1] = field(default=1, metadata=REQUIRED)
    name: Version
    version: Version
    created_utc: str
    sample_s: Annotated[float, Rule(above=0.0)]
    files: Mapping[Annotated[str, Rule(pattern=FILE_NAME.pattern)], FileEntry]
    models: Annotated[Mapping[Annotated[str, Rule(choices=tuple(MODELS))], ModelEntry], Rule(least=1)]
    twin_sha256: Sha256  # Twin.sha256 of twin.yaml: the physics that the hybrid was trained on
    data_sha256: Sha256  # of the recorded runs
    software: Mapping[str, str]  # package -> version it was made with
    minimum_software: Annotated[str, Rule(pattern=r"\d{1,6}(\.\d{1,6}){0,3}")]  # of this project, to run it
    units: Mapping[str, str]
    policies: Mapping[Annotated[str, Rule(choices=RL)], ModelEntry] = field(default_factory=dict)

    def cross_check(self) -> None:
        """Refuse a bundle that is not fit for this software or lacks a model's file."""
        if _number_parts(self.minimum_software) > _number_parts(__version__):
            self.refuse("minimum_software", f"{self.minimum_software} is newer than {__version__}, this one")
        if self.version == PACKAGED:
            self.refuse("version", f"{PACKAGED!r} is the name of the bundle that ships with the software")
        try:
            has_zone = datetime.fromisoformat(self.created_utc).tzinfo is not None
        except ValueError:
            has_zone = False
        if not has_zone:
            self.refuse("created_utc", f"{quote(self.created_utc)} is no time like 2026-07-01T12:00:00Z")
        for key in sorted({*UNITS, *self.units}):
            if self.units.get(key) != UNITS.get(key):
                self.refuse(f"units.{key}", f"{quote(self.units.get(key))} is not {UNITS.get(key)!r}")
        self._check_files()

    def _check_files(self) -> None:
        for name in {MANIFEST, SIGNATURE} & self.files.keys():
            self.refuse(f"files.{name}", "is no name for a file of a bundle")
        entries = [(f"models.{name}", entry, MODELS[name]) for name, entry in self.models.items()]
        entries += [(f"policies.{name}", entry, POLICY) for name, entry in self.policies.items()]
        for place, entry, kind in entries:
            if entry.file not in self.files:
                self.refuse(f"{place}.file", f"{quote(entry.file)} is not among the files")
            if entry.kind != kind:
                self.refuse(f"{place}.kind", f"{quote(entry.kind)} is not {kind!r}")
        if TWIN not in self.files:
            self.refuse("files", f"{TWIN} is missing")


def write_manifest(manifest: Manifest) -> bytes:
    """Return the file's bytes, over which the signature is made."""
    document = asdict(manifest)
    if not manifest.policies:
        del document["policies"]
    return (json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n").encode()


def parse_manifest(content: bytes) -> Manifest:
    """Parse the manifest in `content`, complete and fit for this software.
    Errors: DataError naming the key
    """
    return read(Manifest, parse_json(content, MANIFEST), MANIFEST)


def _number_parts(version: str) -> tuple[int, ...]:
    parts = [int(part) for part in version.split(".")]
    return tuple(parts + [0] * (4 - len(parts)))
