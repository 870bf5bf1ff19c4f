"""Every kind of document refuses the same bad inputs, and nothing is parsed past the one reader."""

import ast
import copy
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx_files
import policy_files
import pytest
import yaml

from edge.bundle.manifest import MANIFEST, TWIN, Manifest, parse_manifest
from edge.bundle.store import PACKAGED_FOLDER
from edge.config import loading
from edge.config.settings import Settings
from edge.core.errors import ConfigError, DataError
from edge.data_intake.mapping import MapDocument, Source, read_map
from edge.forecasts.conformal import IntervalsDocument, read_intervals
from edge.formats.input_file import MemoryFile
from edge.formats.reader import parse_yaml
from edge.models.arx_file import DEFAULT_PATH, ArxDocument, read_arx
from edge.models.contract import ContractDocument, parse_contract
from edge.models.policy_contract import PolicyDocument, parse_policy_contract
from edge.twin.twin_file import TwinDocument, read_twin_file
from edge.twin.value import KnownValue, ValueToFit, read_value

ROOT = Path(__file__).parents[3]
FILE = Path("document")


@dataclass(frozen=True)
class DocumentKind:
    """One kind: how it is read from text, one good document, and a number in it that is looked into."""

    read: Callable[[str], object]
    good: Callable[[], Any]
    number: tuple[str | int, ...]
    error: type[Exception] = DataError


def in_file(read: Callable[[MemoryFile], object]) -> Callable[[str], object]:
    return lambda text: read(MemoryFile(FILE, text.encode()))


def of_text(read: Callable[[bytes], object]) -> Callable[[str], object]:
    return lambda text: read(text.encode())


def packaged(name: str) -> Any:
    return json.loads((PACKAGED_FOLDER / name).read_text())


def of_yaml(read: Callable[[str, Any], object]) -> Callable[[str], object]:
    return lambda text: read("a", parse_yaml(text))


LOG_MAP: dict[str, Any] = {
    "file": {"delimiter": ",", "decimal": ".", "header_line": 1, "encoding": "utf-8"},
    "time": {"column": "t", "format": "seconds", "gap_s": 600.0},
    "columns": {
        "temp_air_c": {"from": "T", "unit": "degC"},
        "heater_duty": {"from": "W", "unit": "of full", "full": 100.0},
    },
}
KINDS: dict[type, DocumentKind] = {
    Settings: DocumentKind(
        loading.parse, lambda: {"control": {"step_s": 60.0}}, ("control", "step_s"), ConfigError
    ),
    ArxDocument: DocumentKind(
        in_file(read_arx), lambda: json.loads(DEFAULT_PATH.read_text()), ("temp_air", 0)
    ),
    Manifest: DocumentKind(of_text(parse_manifest), lambda: packaged(MANIFEST), ("sample_s",)),
    IntervalsDocument: DocumentKind(
        in_file(read_intervals), lambda: packaged("intervals.json"), ("intervals", 0, "half_width_k")
    ),
    ContractDocument: DocumentKind(
        parse_contract, lambda: onnx_files.document_of("ham"), ("golden", 0, "temps", 0, 0)
    ),
    PolicyDocument: DocumentKind(
        parse_policy_contract, lambda: policy_files.document(), ("golden", "values", 0, 0)
    ),
    TwinDocument: DocumentKind(
        in_file(read_twin_file), lambda: yaml.safe_load((PACKAGED_FOLDER / TWIN).read_text()), ("sample_s",)
    ),
    KnownValue: DocumentKind(of_yaml(read_value), lambda: {"value": 1.0, "rel_sd": 0.1}, ("value",)),
    ValueToFit: DocumentKind(of_yaml(read_value), lambda: {"fit": True, "start": 1.0}, ("start",)),
    MapDocument: DocumentKind(in_file(read_map), lambda: LOG_MAP, ("time", "gap_s")),
    Source: DocumentKind(in_file(read_map), lambda: LOG_MAP, ("columns", "heater_duty", "full")),
}
every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=[kind.__name__ for kind in KINDS])


def with_number(kind: DocumentKind, number: str) -> str:
    """The good document with another text where its number was."""
    document = here = copy.deepcopy(kind.good())
    for key in kind.number[:-1]:
        here = here[key]
    assert not isinstance(here[kind.number[-1]], bool | str)
    here[kind.number[-1]] = "@@"
    return json.dumps(document).replace('"@@"', number)


BAD: dict[str, Callable[[DocumentKind], str]] = {
    "a list": lambda kind: "[]",
    "a word": lambda kind: '"word"',
    "too deep": lambda kind: "[" * 100_000,
    "an object too deep": lambda kind: '{"a":' * 100_000,
    "too deep inside": lambda kind: with_number(kind, "[" * 100 + "]" * 100),
    "too large": lambda kind: json.dumps(kind.good()) + " " * (17 << 20),
    "an unknown key": lambda kind: json.dumps({**kind.good(), "nonsense": 1}),
    "a key twice": lambda kind: json.dumps(kind.good())[:-1] + "," + json.dumps(kind.good())[1:],
    "NaN": lambda kind: with_number(kind, "NaN"),
    "NaN of YAML": lambda kind: with_number(kind, ".nan"),
    "infinity": lambda kind: with_number(kind, "Infinity"),
    "a number too large": lambda kind: with_number(kind, "1e999"),
    "digits without end": lambda kind: with_number(kind, "9" * 400),
    "true as a number": lambda kind: with_number(kind, "true"),
    "a number as text": lambda kind: with_number(kind, '"1.0"'),
    "a list as a number": lambda kind: with_number(kind, "[]"),
}


@every_kind
def test_a_good_document_is_read(kind: DocumentKind) -> None:
    kind.read(json.dumps(kind.good()))


@every_kind
@pytest.mark.parametrize("bad", BAD)
def test_a_bad_document_is_refused(kind: DocumentKind, bad: str) -> None:
    with pytest.raises(kind.error):
        kind.read(BAD[bad](kind))


@every_kind
def test_a_missing_or_misspelt_key_is_refused_or_has_a_default(kind: DocumentKind) -> None:
    good = kind.good()
    for key in good:
        without = {name: value for name, value in good.items() if name != key}
        with pytest.raises(kind.error, match="unknown key"):
            kind.read(json.dumps({**without, f"{key}z": good[key]}))


READERS = ("read", "read_json", "read_yaml")


def calls(path: Path) -> list[tuple[str, ast.Call]]:
    """Calls in a file by the name of what is called, without its module."""
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    return [(ast.unparse(node.func).rpartition(".")[2], node) for node in nodes]


def test_no_kind_of_document_is_missing_here() -> None:
    found = {
        call.args[0].id
        for path in (ROOT / "edge").rglob("*.py")
        if "edge.formats.reader import" in path.read_text()
        for name, call in calls(path)
        if name in READERS
        and call.args
        and isinstance(call.args[0], ast.Name)
        and call.args[0].id[0].isupper()
    }
    assert found == {kind.__name__ for kind in KINDS}
