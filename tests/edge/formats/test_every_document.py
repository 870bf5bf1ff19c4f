"""Every kind of document refuses the same bad inputs, and nothing is parsed past the one reader."""

import ast
import copy
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import onnx_files
import policy_files
import pytest
import yaml

from edge.app.backup import BackupManifest, read_manifest
from edge.app.commission_button import CommissionRequest
from edge.app.nightly_diagnosis import AdoptRequest, Findings, UnitAnswer, UnitRequest
from edge.app.request_routes import WhyRequest
from edge.app.running_rigs import RunningRig
from edge.app.setup import SetupAnswers, read_answers
from edge.assistant.llm import wire
from edge.assistant.llm.answer import SaidControls, SimulatedControls, read_answer
from edge.assistant.llm.budget import Spending
from edge.assistant.llm.failure import LlmFailure
from edge.assistant.llm.simulate_tool import SimulateArguments
from edge.assistant.llm.sql_tool import SqlArguments
from edge.assistant.llm.wire import ChoicesDocument
from edge.assistant.requests.answer import WishAnswer, understood
from edge.assistant.requests.desk import DiscardRequest, ProposalRequest, UndoRequest, WishRequest
from edge.assistant.requests.memory import ForgetRequest, RememberRequest
from edge.board.board_file import BoardDocument, read_board_file
from edge.bundle.inventory import ModelReport
from edge.bundle.keeper import BundleRequest
from edge.bundle.manifest import MANIFEST, TWIN, Manifest, parse_manifest
from edge.bundle.roles import Roles
from edge.bundle.store import PACKAGED_FOLDER, Admission
from edge.commands.twin_adopt import ReportedTwin
from edge.config import loading
from edge.config.settings import Settings
from edge.controllers import external
from edge.controllers.external import Proposal
from edge.core.errors import ConfigError, DataError, GreenhouseError, RequestError
from edge.data_intake.mapping import MapDocument, Source, read_map
from edge.drift.evidence import Evidence
from edge.drift.monitor import DriftMemory
from edge.evidence.chain_files import ChainDay, ChainSeal, ChainStart
from edge.evidence.day_rows import SealedRow
from edge.evidence.marks import EvidenceMark
from edge.forecasts.conformal import IntervalsDocument, read_intervals
from edge.forecasts.skill import ErrorPair, SkillState
from edge.formats.input_file import MemoryFile
from edge.formats.reader import parse_json, parse_yaml, read
from edge.models.arx_file import DEFAULT_PATH, ArxDocument, read_arx
from edge.models.contract import ContractDocument, parse_contract
from edge.models.policy_contract import PolicyDocument, parse_policy_contract
from edge.mqtt import commands
from edge.mqtt.commands import RemoteInstall, RemoteRollback, Resend
from edge.page.alarms.alarm_state import AlarmState
from edge.page.alarms.trial import ChannelTrial, TrialAnswer
from edge.safety.memory import Dose, SafetyMemory
from edge.state import codecs
from edge.state.codecs import DriftDocument, SafetyDocument, SkillDocument, StandingDocument
from edge.state.store import LLM_BUDGET
from edge.tick import orders_json, steering
from edge.tick.calibration import CalibrationPoint, StandingCalibration
from edge.tick.orders import (
    ORDERS,
    CalibratePoint,
    Desk,
    NoKeys,
    OneSignal,
    Operation,
    SetController,
    SetFanMode,
    SetManual,
    SetMode,
    SetReference,
    StartMaintenance,
    StartProfile,
    Steer,
    operate,
    read_request,
)
from edge.tick.orders_json import OperationDocument
from edge.tick.standing_profile import StandingProfile
from edge.tick.steering import DailyTarget, FanRest, Steering
from edge.twin.twin_file import TwinDocument, read_twin_file
from edge.twin.value import KnownValue, ValueToFit, read_value

ROOT = Path(__file__).parents[3]
FILE = Path("document")


@dataclass(frozen=True)
class DocumentKind:
    """One kind: how it is read from text, one good document, and where a number stands in it."""

    read: Callable[[str], object]
    good: Callable[[], Any]
    number: tuple[str | int, ...] = ()
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
SETTINGS = Settings()
DESK = Desk(0.0, ("MPC",), 10.0, 40.0)
STEERING = Steering("a", "warmer", 60.0, (DailyTarget(0.0, 25.0),), 1.0, 1.0, 0.5, (FanRest(0.0, 60.0),))
REQUESTS: dict[str, tuple[type, Any, tuple[str | int, ...]]] = {
    "emergency_stop": (NoKeys, {}, ()),
    "set_mode": (SetMode, {"mode": "heat"}, ("mode",)),
    "set_fan_mode": (SetFanMode, {"fan_mode": "on"}, ("fan_mode",)),
    "set_reference": (SetReference, {"reference_c": 25.0}, ("reference_c",)),
    "set_controller": (SetController, {"name": "MPC"}, ("name",)),
    "set_manual": (SetManual, {"heater_duty": 0.5, "fan_on": 1, "led": 0.0}, ("heater_duty",)),
    "maintenance": (StartMaintenance, {"minutes": 5.0}, ("minutes",)),
    "start_profile": (
        StartProfile,
        {"profile": {"name": "a", "times_s": [0.0, 60.0], "targets_c": [20.0, 25.0]}},
        ("profile", "times_s", 1),
    ),
    "steer": (Steer, {"steering": steering.to_dict(STEERING)}, ("steering", "until_utc")),
}
CONTROLS = {"heater_duty": 0.5, "fan_on": True, "rationale": "because"}
WISH = {
    "reference": [{"from": "06:00", "degc": 25.0}],
    "heater_penalty": None,
    "fan_penalty": 1.0,
    "heater_max_duty": 0.5,
    "fan_rest": [{"from": "22:00", "until": "06:00"}],
    "hours": 24.0,
    "understood": "25 degC from 6 on",
    "question": "",
}
START_OF_RECORD = {
    "layout": 1,
    "date": "2026-07-01",
    "started_utc": 1.0,
    "history_id": "a",
    "after_seq": 7,
    "protocol_sha256": "0" * 64,
    "key_sha256": "0" * 64,
    "software": "0.1.0",
}
DAY_OF_RECORD = {
    "layout": 1,
    "number": 1,
    "date": "2026-07-01",
    "previous_sha256": "0" * 64,
    "rows_sha256": "0" * 64,
    "rows_bytes": 5,
    "history_id": "a",
    "after_seq": 7,
    "last_seq": 9,
    "ticks": 1,
    "gaps": [{"first_seq": 8, "last_seq": 8, "reason": "full"}],
    "marks": 0,
    "sealed_utc": 1.0,
}
REPLY = {"choices": [{"message": {"content": "hello"}, "finish_reason": "stop"}]}


def request(name: str, good: Any, number: tuple[str | int, ...]) -> DocumentKind:
    """An order as it comes through the control socket."""

    def read_order(text: str) -> object:
        return operate(Operation("MPC"), {"do": name, **parse_json(text)}, DESK)

    return DocumentKind(read_order, lambda: good, number, GreenhouseError)


def asked(kind: type, good: Any, number: tuple[str | int, ...] = ()) -> DocumentKind:
    """A request that others than the control thread answer."""
    return DocumentKind(
        lambda text: read_request(kind, parse_json(text)), lambda: good, number, GreenhouseError
    )


def in_memory(kind: type, good: Any, number: tuple[str | int, ...] = ()) -> DocumentKind:
    return DocumentKind(lambda text: read(kind, parse_json(text)), lambda: good, number)


POINT = CalibrationPoint("co2", 420.0, 450.0, 5.0, 1.0)
CALIBRATION = StandingCalibration("temp_air", 1.01, -0.5, 1.0)
OPERATION = orders_json.to_dict(
    Operation("MPC", reference_c=25.0, steering=STEERING, points=(POINT,), calibrations=(CALIBRATION,))
)
SAFETY = codecs.encode_safety(SafetyMemory(("air",), doses=(Dose(None, 1e9, 2.0),)))
SKILL = SkillState({("arx", 5, "persistence"): ErrorPair(("1", "2"), 3, 0.1, 0.2)})
DRIFT = DriftMemory("0" * 64, Evidence.none(0.0))


def in_memory_by(
    decode: Callable[[dict[str, Any]], object], good: Any, number: tuple[str | int, ...] = ()
) -> DocumentKind:
    """A state that was parsed before."""
    return DocumentKind(lambda text: decode(parse_json(text)), lambda: good, number)


KINDS: dict[type, DocumentKind] = {
    BackupManifest: DocumentKind(
        of_text(read_manifest),
        lambda: {"layout": 1, "version": "0.1.0", "created_utc": "2026-11-25T00:00:00+00:00", "files": {}},
        ("layout",),
    ),
    SetupAnswers: DocumentKind(
        in_file(lambda file: read_answers(file, SETTINGS)),
        lambda: {"port": "/dev/ttyACM0", "outputs": {"fan": "works"}, "volume_m3": 0.15},
        ("volume_m3",),
    ),
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
    BoardDocument: DocumentKind(
        in_file(read_board_file),
        lambda: {"board": "uno", "id": 1, "limits": {"temp_trip_c": 45.0}},
        ("limits", "temp_trip_c"),
    ),
    MapDocument: DocumentKind(in_file(read_map), lambda: LOG_MAP, ("time", "gap_s")),
    Source: DocumentKind(in_file(read_map), lambda: LOG_MAP, ("columns", "heater_duty", "full")),
    **{kind: request(name, good, number) for name, (kind, good, number) in REQUESTS.items()},
    Resend: DocumentKind(
        lambda text: commands.parse("resend", text.encode(), SETTINGS.reference),
        lambda: {"first_seq": 1, "last_seq": 2},
        ("last_seq",),
        RequestError,
    ),
    RemoteInstall: DocumentKind(
        lambda text: commands.parse("install_bundle", text.encode(), SETTINGS.reference),
        lambda: {"url": "http://fleet/b.zip", "sha256": "a" * 64},
        (),
        RequestError,
    ),
    RemoteRollback: DocumentKind(
        lambda text: commands.parse("rollback_bundle", text.encode(), SETTINGS.reference),
        lambda: {"version": "2.0"},
        (),
        RequestError,
    ),
    WhyRequest: asked(WhyRequest, {"at_utc": 1.0}, ("at_utc",)),
    AdoptRequest: asked(AdoptRequest, {"report": "2026-07-01_0300", "job": 1}, ("job",)),
    ModelReport: in_memory(ModelReport, {"adopted_twin": {"from": "1.0"}}, ()),
    BundleRequest: asked(BundleRequest, {"action": "status", "job": 1}, ("job",)),
    CommissionRequest: asked(CommissionRequest, {"end": True}),
    WishRequest: asked(WishRequest, {"words": "warmer"}),
    ProposalRequest: asked(ProposalRequest, {"id": "a"}),
    DiscardRequest: asked(DiscardRequest, {"id": "a", "why": "too warm"}),
    UndoRequest: asked(UndoRequest, {"why": "too warm"}),
    RememberRequest: asked(RememberRequest, {"text": "no fan", "id": 1}, ("id",)),
    ForgetRequest: asked(ForgetRequest, {"id": 1, "all": False}, ("id",)),
    Proposal: DocumentKind(
        lambda text: external._proposal(parse_json(text)),
        lambda: {"heater_duty": 0.5, "fan_on": True},
        ("heater_duty",),
        GreenhouseError,
    ),
    SaidControls: DocumentKind(
        lambda text: read_answer(text, False), lambda: CONTROLS, ("heater_duty",), LlmFailure
    ),
    SimulatedControls: DocumentKind(
        lambda text: read_answer(text, True),
        lambda: CONTROLS | {"simulation": "a"},
        ("heater_duty",),
        LlmFailure,
    ),
    WishAnswer: DocumentKind(
        lambda text: understood(parse_json(text), "a", "words", 0.0, SETTINGS.reference),
        lambda: WISH,
        ("reference", 0, "degc"),
        GreenhouseError,
    ),
    SimulateArguments: in_memory(
        SimulateArguments, {"heater_duty": [0.5], "fan_on": [True]}, ("heater_duty", 0)
    ),
    SqlArguments: in_memory(SqlArguments, {"query": "SELECT 1"}),
    ChoicesDocument: DocumentKind(
        lambda text: wire.read_reply(wire.read_document(text.encode()), wire.Usage()),
        lambda: REPLY,
        error=LlmFailure,
    ),
    ReportedTwin: in_memory(ReportedTwin, {"twin_after": "twin.yaml"}),
    Findings: in_memory(Findings, {"verdict": "named", "effects": [{"name": "leak"}]}),
    UnitRequest: in_memory(
        UnitRequest, {"words": ["twin"], "log": "log", "patience_s": 1.0}, ("patience_s",)
    ),
    UnitAnswer: in_memory(UnitAnswer, {"code": 0}),
    ChainStart: in_memory(ChainStart, START_OF_RECORD, ("after_seq",)),
    ChainDay: in_memory(ChainDay, DAY_OF_RECORD, ("gaps", 0, "last_seq")),
    ChainSeal: in_memory(
        ChainSeal, {"layout": 1, "days": 3, "head_sha256": "0" * 64, "sealed_utc": 1.0}, ("sealed_utc",)
    ),
    EvidenceMark: in_memory(EvidenceMark, {"utc": 1.0, "what": "hands", "edge": "begin"}, ("utc",)),
    SealedRow: in_memory(
        SealedRow, {"mark": {"utc": 1.0, "what": "hands", "edge": "begin", "text": ""}}, ("mark", "utc")
    ),
    OperationDocument: in_memory_by(orders_json.from_dict, OPERATION, ("reference_c",)),
    StandingDocument: in_memory_by(codecs.decode_standing, {"operation": OPERATION, "safety": SAFETY}),
    SafetyDocument: in_memory_by(codecs.decode_safety, SAFETY, ("doses", 0, 1)),
    Steering: in_memory_by(steering.from_dict, steering.to_dict(STEERING), ("until_utc",)),
    SkillDocument: in_memory_by(codecs.decode_skill, codecs.encode_skill(SKILL), ("pairs", 0, 6)),
    DriftDocument: in_memory_by(codecs.decode_drift, codecs.encode_drift(DRIFT), ("sums", 0)),
    Spending: in_memory_by(LLM_BUDGET.decode, LLM_BUDGET.encode(Spending("2026-07-01", 5)), ("tokens",)),
    StandingProfile: in_memory(
        StandingProfile,
        {"name": "a", "times_s": [0.0, 60.0], "targets_c": [20.0, 25.0]},
        ("times_s", 1),
    ),
    RunningRig: in_memory(RunningRig, {"name": "a", "socket": "/run/a.sock", "stops": "/stops"}),
    AlarmState: in_memory(AlarmState, {"alarms": [], "notes": {}}),
    ChannelTrial: in_memory(ChannelTrial, {"id": "a", "utc": 1.0}, ("utc",)),
    TrialAnswer: in_memory(TrialAnswer, {"id": "a", "reasons": {"ntfy": ""}}),
    Roles: in_memory(Roles, asdict(Roles())),
    CalibratePoint: asked(CalibratePoint, {"signal": "co2", "true_value": 420.0}, ("true_value",)),
    OneSignal: asked(OneSignal, {"signal": "co2"}),
    Admission: in_memory(Admission, asdict(Admission("1.0", ("0" * 64,)))),
}
FOREIGN = {ChoicesDocument, ReportedTwin, Findings, ModelReport}  # may hold keys of others
PARTS = {"UsageDocument"}  # read out of a reply; the usage is None where it is wrong
every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=[kind.__name__ for kind in KINDS])


def with_number(kind: DocumentKind, number: str) -> str:
    """The good document with another text where its number was."""
    document = here = copy.deepcopy(kind.good())
    for key in kind.number[:-1]:
        here = here[key]
    here[kind.number[-1]] = "@@"
    return json.dumps(document).replace('"@@"', number)


def twice(document: dict[str, Any]) -> str:
    text = json.dumps(document)
    return f"{text[:-1]}, {text[1:]}" if document else '{"a": 1, "a": 1}'


BAD: dict[str, Callable[[DocumentKind], str]] = {
    "a list": lambda kind: "[]",
    "a word": lambda kind: '"word"',
    "too deep": lambda kind: "[" * 100_000,
    "an object too deep": lambda kind: '{"a":' * 100_000,
    "too large": lambda kind: json.dumps(kind.good()) + " " * (17 << 20),
    "an unknown key": lambda kind: json.dumps({**kind.good(), "nonsense": 1}),
    "a key twice": lambda kind: twice(kind.good()),
}
NUMBERS: dict[str, Callable[[DocumentKind], str]] = {
    "too deep inside": lambda kind: with_number(kind, "[" * 100 + "]" * 100),
    "NaN": lambda kind: with_number(kind, "NaN"),
    "NaN of YAML": lambda kind: with_number(kind, ".nan"),
    "infinity": lambda kind: with_number(kind, "Infinity"),
    "a number too large": lambda kind: with_number(kind, "1e999"),
    "digits without end": lambda kind: with_number(kind, "9" * 400),
    "true as a number": lambda kind: with_number(kind, "true"),
    "a number as text": lambda kind: with_number(kind, '"1.0"'),
    "a list as a number": lambda kind: with_number(kind, "[]"),
}


BAD |= NUMBERS


@every_kind
def test_a_good_document_is_read(kind: DocumentKind) -> None:
    kind.read(json.dumps(kind.good()))


CASES = [
    pytest.param(kind, bad, id=f"{bad}-{cls.__name__}")
    for cls, kind in KINDS.items()
    for bad in BAD
    if (kind.number or bad not in NUMBERS) and not (cls in FOREIGN and bad == "an unknown key")
]


@pytest.mark.parametrize(("kind", "bad"), CASES)
def test_a_bad_document_is_refused(kind: DocumentKind, bad: str) -> None:
    with pytest.raises(kind.error):
        kind.read(BAD[bad](kind))


@pytest.mark.parametrize("cls", [cls for cls in KINDS if cls not in FOREIGN])
def test_a_misspelt_key_is_refused(cls: type) -> None:
    kind = KINDS[cls]
    good = kind.good()
    for key in good:
        without = {name: value for name, value in good.items() if name != key}
        with pytest.raises(kind.error, match="unknown key"):
            kind.read(json.dumps({**without, f"{key}z": good[key]}))


@pytest.mark.parametrize("cls", sorted(FOREIGN, key=str))
def test_a_document_of_others_may_hold_more_keys(cls: type) -> None:
    KINDS[cls].read(BAD["an unknown key"](KINDS[cls]))


PARSERS = {
    *("json.loads", "json.load", "yaml.load", "yaml.safe_load", "yaml.full_load", "yaml.unsafe_load"),
    *("parsing.parse_object", "parsing.parse_yaml", "parse_object"),
}
PAST_THE_READER = {  # file -> why it may parse by itself
    "edge/board/sim_clock.py": "answers of the virtual board that this process started",
    "edge/bundle/proof.py": "the task that this process gives its own child",
    "edge/formats/parsing.py": "JSON and YAML of the reader",
    "edge/formats/reader.py": "the reader",
    "edge/storage/tick_rows.py": "rows of the database that this software wrote",
    "edge/storage/numbers.py": "128 bytes that the history overwrites in place",
    "edge/storage/runs.py": "rows of the database that this software wrote",
    "firmware_protocol/gen_spec.py": "messages.yaml of this repository, read by the generators",
    "firmware_protocol/virtual_board/chamber_parameters.py": "imports nothing of edge",
    "firmware_protocol/virtual_board/lockstep.py": "imports nothing of edge",
    "firmware_protocol/virtual_board/faults.py": "imports nothing of edge",
    "firmware_protocol/virtual_board/store.py": "imports nothing of edge",
}
READERS = ("read", "read_entry", "read_json", "read_yaml", "read_request", "_values")


def calls(path: Path) -> list[tuple[str, ast.Call]]:
    """Calls in a file by the name of what is called, without its module."""
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    return [(ast.unparse(node.func).rpartition(".")[2], node) for node in nodes]


def test_nothing_is_parsed_past_the_reader() -> None:
    found = {
        str(path.relative_to(ROOT))
        for part in ("edge", "firmware_protocol")
        for path in (ROOT / part).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) in PARSERS
    }
    assert found == set(PAST_THE_READER)


def test_no_kind_of_document_is_missing_here() -> None:
    found = {
        node.id
        for path in (ROOT / "edge").rglob("*.py")
        for name, call in calls(path)
        if name in READERS and call.args
        for node in ast.walk(call.args[0])
        if isinstance(node, ast.Name) and node.id[0].isupper() and not node.id.isupper() and node.id != "Any"
    }
    found |= {order.keys.__name__ for order in ORDERS.values()}
    assert found == {kind.__name__ for kind in KINDS} | PARTS
