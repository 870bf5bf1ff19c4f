"""manifest.json of a bundle: what is in it, for which sample time, from which data, for which software."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from typing import Any

from edge.core.controller_names import RL
from edge.core.errors import DataError
from edge.core.names import ACTUATORS, SIGNALS
from edge.core.plain_text import shown
from edge.core.version import __version__
from edge.formats.strict_json import parse_object

FORMAT = 1
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

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")  # flat: no folder, nothing hidden, no ".."
VERSION = re.compile(r"[0-9A-Za-z][0-9A-Za-z._-]{0,63}")
_SOFTWARE = re.compile(r"\d{1,6}(\.\d{1,6}){0,3}")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of the bundle."""

    sha256: str
    size: int  # [bytes]


@dataclass(frozen=True, slots=True)
class ModelEntry:
    """Which file holds a model or a policy, and how it is to be read (a value of MODELS, POLICY)."""

    file: str
    kind: str


@dataclass(frozen=True, slots=True)
class Manifest:
    """All that is said of a bundle; the signature covers its exact bytes.

    policies : by the controller that they are for; the key is absent where there are none, as in every
        bundle that was made before there were any
    """

    name: str
    version: str
    created_utc: str
    sample_s: float
    files: Mapping[str, FileEntry]
    models: Mapping[str, ModelEntry]
    twin_sha256: str  # Twin.sha256 of twin.yaml: the physics that the hybrid was trained on
    data_sha256: str  # of the recorded runs
    software: Mapping[str, str]  # package -> version it was made with
    minimum_software: str  # of this project, to run it
    units: Mapping[str, str]
    policies: Mapping[str, ModelEntry] = field(default_factory=dict)


def write_manifest(manifest: Manifest) -> bytes:
    """The file's bytes: those that are signed."""
    document = {"format": FORMAT, **asdict(manifest)}
    if not manifest.policies:
        del document["policies"]
    return (json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False) + "\n").encode()


def parse_manifest(content: bytes) -> Manifest:
    """The manifest in `content`, whole and fit for this software. Errors: DataError naming the key."""
    try:
        document = parse_object(content)
    except ValueError as error:
        raise _wrong("", str(error)) from None
    if document.get("format") != FORMAT:
        raise _wrong("format", f"{shown(document.get('format'))} is not {FORMAT}, the one known here")
    document.setdefault("policies", {})
    keys = set(Manifest.__dataclass_fields__) | {"format"}
    if odd := sorted(keys ^ set(document)):
        raise _wrong(odd[0], "missing" if odd[0] in keys else "unknown key")
    files = {name: _file(name, entry) for name, entry in _mapping(document, "files").items()}
    manifest = Manifest(
        name=_text(document, "name", VERSION),
        version=_text(document, "version", VERSION),
        created_utc=_moment(document, "created_utc"),
        sample_s=_sample_s(document),
        files=files,
        models={name: _model(name, entry, files) for name, entry in _mapping(document, "models").items()},
        policies={
            name: _policy(name, entry, files) for name, entry in _mapping(document, "policies").items()
        },
        twin_sha256=_text(document, "twin_sha256", _SHA256),
        data_sha256=_text(document, "data_sha256", _SHA256),
        software={key: str(value) for key, value in _mapping(document, "software").items()},
        minimum_software=_text(document, "minimum_software", _SOFTWARE),
        units={key: str(value) for key, value in _mapping(document, "units").items()},
    )
    _check_fit(manifest)
    return manifest


def _check_fit(manifest: Manifest) -> None:
    if _number_parts(manifest.minimum_software) > _number_parts(__version__):
        raise _wrong("minimum_software", f"{manifest.minimum_software} is newer than {__version__}, this one")
    if manifest.version == PACKAGED:
        raise _wrong("version", f"{PACKAGED!r} is the name of the bundle that ships with the software")
    if manifest.units != UNITS:
        wrong = sorted(key for key in {*UNITS, *manifest.units} if UNITS.get(key) != manifest.units.get(key))[
            0
        ]
        raise _wrong(f"units.{wrong}", f"{shown(manifest.units.get(wrong))} is not {UNITS.get(wrong)!r}")
    if not manifest.models:
        raise _wrong("models", "there are none")
    if TWIN not in manifest.files:
        raise _wrong("files", f"{TWIN} is missing")


def _number_parts(version: str) -> tuple[int, ...]:
    parts = [int(part) for part in version.split(".")]
    return tuple(parts + [0] * (4 - len(parts)))


def _wrong(key: str, problem: str) -> DataError:
    return DataError(f"{MANIFEST}: {f'{key}: ' if key else ''}{problem}")


def _mapping(document: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = document[key]
    if not isinstance(value, dict):
        raise _wrong(key, "is no object")
    return value


def _text(document: Mapping[str, Any], key: str, pattern: re.Pattern[str]) -> str:
    value = document[key]
    if not isinstance(value, str) or not pattern.fullmatch(value):
        raise _wrong(key, f"{shown(value)} does not match {pattern.pattern}")
    return value


def _moment(document: Mapping[str, Any], key: str) -> str:
    value = document[key]
    try:
        moment = datetime.fromisoformat(value)
    except (TypeError, ValueError):
        moment = None
    if moment is None or moment.tzinfo is None:
        raise _wrong(key, f"{shown(value)} is no time like 2026-07-01T12:00:00Z")
    return str(value)


def _sample_s(document: Mapping[str, Any]) -> float:
    value = document["sample_s"]
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < float("inf"):
        raise _wrong("sample_s", f"{shown(value)} is no time above 0")
    return float(value)


def _file(name: str, entry: Any) -> FileEntry:
    place = f"files.{name}"
    if not FILE_NAME.fullmatch(name) or name in (MANIFEST, SIGNATURE):
        raise _wrong(place, "is no name for a file of a bundle")
    if not isinstance(entry, dict) or set(entry) != {"sha256", "size"}:
        raise _wrong(place, "must hold sha256 and size")
    size = entry["size"]
    if isinstance(size, bool) or not isinstance(size, int) or size < 0:
        raise _wrong(f"{place}.size", f"{shown(size)} is no number of bytes")
    if not isinstance(entry["sha256"], str) or not _SHA256.fullmatch(entry["sha256"]):
        raise _wrong(f"{place}.sha256", f"{shown(entry['sha256'])} is no sha256")
    return FileEntry(entry["sha256"], size)


def _model(name: str, entry: Any, files: Mapping[str, FileEntry]) -> ModelEntry:
    place = f"models.{name}"
    if name not in MODELS:
        raise _wrong(place, f"unknown model; known: {', '.join(MODELS)}")
    return _entry(place, entry, files, MODELS[name])


def _policy(name: str, entry: Any, files: Mapping[str, FileEntry]) -> ModelEntry:
    place = f"policies.{name}"
    if name not in RL:
        raise _wrong(place, f"no controller runs a policy of this name; known: {', '.join(RL)}")
    return _entry(place, entry, files, POLICY)


def _entry(place: str, entry: Any, files: Mapping[str, FileEntry], kind: str) -> ModelEntry:
    if not isinstance(entry, dict) or set(entry) != {"file", "kind"}:
        raise _wrong(place, "must hold file and kind")
    if entry["file"] not in files:
        raise _wrong(f"{place}.file", f"{shown(entry['file'])} is not among the files")
    if entry["kind"] != kind:
        raise _wrong(f"{place}.kind", f"{shown(entry['kind'])} is not {kind!r}")
    return ModelEntry(entry["file"], entry["kind"])
