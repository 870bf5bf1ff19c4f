"""Questions and files of `greenhouse setup`, without a terminal: a web page can ask them as well.

`next_question` names an open one, `answer` takes a person's words, `settings_of` and `twin_of` make files.
"""

import json
import os
import re
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from secrets import token_hex
from socket import gethostname
from typing import Annotated, Any, Literal

from edge.config.example import changes
from edge.config.loading import parse
from edge.config.settings import MqttSettings, Settings
from edge.core.controller_names import NEED_NO_MODEL, RULES
from edge.core.errors import DataError, RequestError
from edge.core.hard_limits import (
    HEAT_DAY_MAX_WH,
    HEAT_HOUR_MAX_WH,
    REFERENCE_MAX_C,
    REFERENCE_MIN_C,
    STEP_MAX_S,
    STEP_MIN_S,
)
from edge.core.plain_text import quote
from edge.formats.atomic_file import write_atomically
from edge.formats.cross_check import Rule
from edge.formats.input_file import MemoryFile, read_text
from edge.formats.reader import read_json
from edge.twin import new_file
from edge.twin.box_words import quantity, volume, wall
from edge.twin.new_file import BoxDescription
from edge.twin.twin_file import FAN_ROLES, read_twin_file

WATTS = {"W": 1.0, "kW": 1000.0}
FLOWS = {"m3/h": 1.0, "l/min": 0.06, "l/s": 3.6}  # in m3/h
SECONDS = {"s": 1.0, "min": 60.0}
AREAS = {"m2": 1.0, "cm2": 1e-4}
DEGREES = {"°C": 1.0, "C": 1.0}
WALL_AREA_M2 = (0.005, 60.0)  # of a box of 0.1 litre, of a small room
DAY_HOURS = 20.0  # of full heat that the energy cap of a day allows, as for the paper's heater
STEP_S = 60.0  # that the packaged models are made for
UNIT_FILE = Path("/etc/systemd/system/greenhouse.service")
MACHINE_ID = Path("/etc/machine-id")
SYSTEMD = Path("/run/systemd/system")  # where it runs, sd_booted(3)
START = "sudo systemctl enable --now greenhouse"
INSTALL = "sudo sh deploy/install.sh"  # in the checkout
HEAD = "# Written by `greenhouse setup`: the keys that differ from their defaults.\n"

OutputResult = Literal["works", "no effect", "skipped"]


@dataclass(frozen=True, slots=True)
class SetupAnswers:
    """Answers so far, a JSON document; None for a question that is open.

    outputs : result of the check of each output
    wall : material and thickness such as `plywood:12mm`; "" where not known
    """

    port: str | None = None
    outputs: Mapping[str, OutputResult] = field(default_factory=dict)
    volume_m3: Annotated[float, Rule(above=0.0)] | None = None
    heater_w: Annotated[float, Rule(above=0.0)] | None = None
    fan_role: Annotated[str, Rule(choices=FAN_ROLES)] | None = None
    fan_m3_h: Annotated[float, Rule(above=0.0)] | None = None
    wall: str | None = None
    wall_area_m2: float | None = None
    step_s: float | None = None
    min_c: float | None = None
    max_c: float | None = None
    reference_c: float | None = None


@dataclass(frozen=True, slots=True)
class BoxQuestion:
    """One question. Its answer is the field `key`.

    example : the paper's box, which is never taken for the person's own
    empty : answer of an empty line; None where an answer must be typed
    """

    key: str
    text: str
    example: str
    read: Callable[[str], Any]
    empty: Any = None
    applies: Callable[[SetupAnswers], bool] = lambda answers: True


def _number(units: Mapping[str, float], bare: str) -> Callable[[str], float]:
    return lambda word: quantity(word, units, bare)


def _role(word: str) -> str:
    if word not in FAN_ROLES:
        raise RequestError(f"{quote(word)} is none of {', '.join(FAN_ROLES)}")
    return word


def _wall(word: str) -> str:
    material, thickness_m = wall(word)
    return f"{material}:{1000.0 * thickness_m:g}mm"


QUESTIONS = (
    BoxQuestion(
        "volume_m3",
        "How much air does the box hold? Litres, m3, or its three inside edges, with the unit.",
        "50x50x60 cm",
        volume,
    ),
    BoxQuestion(
        "heater_w", "What power does the heater have at full duty? In W.", "100 W", _number(WATTS, "W")
    ),
    BoxQuestion(
        "fan_role",
        "What does the fan do? exhaust: it exchanges air with the room. stirring: it only mixes the air "
        "inside. none: there is no fan.",
        "exhaust",
        _role,
    ),
    BoxQuestion(
        "fan_m3_h",
        "What does the fan move when it runs free? In m3/h; its data sheet has it.",
        "68 m3/h",
        _number(FLOWS, "m3/h"),
        applies=lambda answers: answers.fan_role == "exhaust",
    ),
    BoxQuestion(
        "wall",
        "What are the walls made of, and how thick? Enter: not known. "
        f"Materials: {', '.join(new_file.CONDUCTIVITY_W_M_K)}.",
        "polycarbonate:8mm",
        _wall,
        empty="",
    ),
    BoxQuestion(
        "wall_area_m2",
        "What area do all walls, the floor and the lid have together? In m2.",
        "1.7 m2",
        _number(AREAS, "m2"),
        applies=lambda answers: bool(answers.wall),
    ),
    BoxQuestion(
        "step_s",
        "How often shall the daemon decide? Enter: every 60 s.",
        "60 s",
        _number(SECONDS, "s"),
        empty=STEP_S,
    ),
    BoxQuestion(
        "min_c", "What is the lowest temperature to ask for? In °C.", "15 °C", _number(DEGREES, "°C")
    ),
    BoxQuestion(
        "max_c", "What is the highest temperature to ask for? In °C.", "38 °C", _number(DEGREES, "°C")
    ),
    BoxQuestion(
        "reference_c",
        "What temperature shall the rig hold at first? In °C.",
        "24 °C",
        _number(DEGREES, "°C"),
    ),
)


def next_question(answers: SetupAnswers) -> BoxQuestion | None:
    """Return the first question without an answer, None when all have one."""
    is_open = (q for q in QUESTIONS if q.applies(answers) and getattr(answers, q.key) is None)
    return next(is_open, None)


def answer(answers: SetupAnswers, question: BoxQuestion, words: str, before: Settings) -> SetupAnswers:
    """Return the answers with one more. before : the present edge.yaml. Errors: RequestError"""
    words = words.strip()
    if not words and question.empty is None:
        raise RequestError(f"an answer is needed, such as {question.example}")
    value = question.read(words) if words else question.empty
    found: SetupAnswers = replace(answers, **{question.key: value})
    for problem in filter(None, _problems(found, before.safety.temp_air_max_c).values()):
        raise RequestError(problem)
    return found


def _problems(answers: SetupAnswers, limit_c: float) -> dict[str, str]:
    """Return by key why an answer looks like another unit or excludes others, "" where it does not."""
    a, found = answers, {}
    if a.volume_m3 is not None:
        found["volume_m3"] = new_file.volume_problem(a.volume_m3)
    if a.heater_w is not None:
        found["heater_w"] = new_file.heater_problem(a.heater_w)
    if a.fan_m3_h is not None and a.volume_m3 is not None:
        found["fan_m3_h"] = new_file.flow_problem(a.fan_m3_h, a.volume_m3)
    found["wall"] = _wall_problem(a.wall)
    lowest_c = REFERENCE_MIN_C if a.min_c is None else a.min_c
    highest_c = REFERENCE_MAX_C if a.max_c is None else a.max_c
    found["wall_area_m2"] = _outside(a.wall_area_m2, *WALL_AREA_M2, "m2")
    found["step_s"] = _outside(a.step_s, STEP_MIN_S, STEP_MAX_S, "s")
    found["min_c"] = _outside(a.min_c, REFERENCE_MIN_C, REFERENCE_MAX_C, "°C")
    found["max_c"] = _outside(a.max_c, lowest_c, REFERENCE_MAX_C, "°C")
    found["reference_c"] = _outside(a.reference_c, lowest_c, highest_c, "°C")
    if a.max_c is not None and a.max_c >= limit_c:
        found["max_c"] = f"{a.max_c:g} °C is not below the safety limit {limit_c:g} °C, safety.temp_air_max_c"
    if a.max_c is not None and a.max_c == a.min_c:
        found["max_c"] = "is the lowest temperature too"
    return found


def _wall_problem(words: str | None) -> str:
    try:
        if words:
            wall(words)
    except RequestError as error:
        return str(error)
    return ""


def _outside(value: float | None, low: float, high: float, unit: str) -> str:
    if value is None or low <= value <= high:
        return ""
    return f"{value:g} {unit} is not within {low:g}..{high:g} {unit}"


def read_answers(path: Path | MemoryFile, before: Settings) -> SetupAnswers:
    """Return the answers of a file. Errors: DataError, which names file and key"""
    answers = read_json(SetupAnswers, path)
    for key, problem in _problems(answers, before.safety.temp_air_max_c).items():
        if problem:
            raise DataError(f"{path}: {key}: {problem}")
    return answers


def write_answers(path: Path, answers: SetupAnswers) -> None:
    """Save the answers. Errors: OSError"""
    given = {key: value for key, value in asdict(answers).items() if value is not None}
    write_atomically(path, json.dumps(given, indent=1) + "\n")


def settings_of(before: Settings, answers: SetupAnswers, report_period_s: float, twin: Path) -> Settings:
    """Return the settings of this rig with its twin file; what is not asked stays as it was.

    The packaged models are those of the paper's box. So a rig without a model of its own begins with the
    controller `rules`, which needs none.
    Errors : ConfigError where an answer and what was there exclude each other
    """
    a, control, reference = answers, before.control, before.reference
    assert a.port and a.step_s and a.min_c is not None and a.max_c is not None and a.reference_c is not None
    assert a.heater_w
    safety = replace(
        before.safety,
        energy_hour_max_wh=min(max(before.safety.energy_hour_max_wh, a.heater_w), HEAT_HOUR_MAX_WH),
        energy_day_max_wh=min(max(before.safety.energy_day_max_wh, DAY_HOURS * a.heater_w), HEAT_DAY_MAX_WH),
    )
    has_own = bool(control.model) or control.controller in NEED_NO_MODEL
    return replace(
        before,
        board=replace(before.board, port=a.port),
        control=replace(control, step_s=a.step_s, controller=control.controller if has_own else RULES),
        reference=replace(reference, min_c=a.min_c, max_c=a.max_c, reference_c=a.reference_c),
        sensor_health=replace(before.sensor_health, sample_period_s=report_period_s),
        safety=safety,
        box=replace(before.box, twin=str(twin), heater_w=0.0),  # the twin file has it
        mqtt=replace(before.mqtt, rig=rig_name(before)),
    )


def rig_name(before: Settings) -> str:
    """Return the name of a rig: a new rig gets the host's, with a mark that differs between clones."""
    if before.mqtt != MqttSettings() or os.access(before.state_file, os.F_OK):
        return before.mqtt.rig
    host = re.sub("[^a-zA-Z0-9_-]+", "-", gethostname().partition(".")[0]).strip("-")[:50] or "rig"
    machine = read_text(MACHINE_ID) if os.access(MACHINE_ID, os.R_OK) else token_hex()
    return f"{host}-{sha256(f'greenhouse {machine}'.encode()).hexdigest()[:6]}"


def edge_text(settings: Settings) -> str:
    """Return edge.yaml with the keys that differ from the defaults."""
    text = HEAD + changes(settings)
    if parse(text) != settings:
        raise DataError("edge.yaml: the text does not say what was answered")
    return text


def twin_of(answers: SetupAnswers) -> str:
    """Return the twin file; what is not known is to be fitted. Errors: RequestError, DataError"""
    a = answers
    assert a.volume_m3 and a.heater_w and a.fan_role and a.step_s
    material = wall(a.wall) if a.wall else None
    area_m2 = a.wall_area_m2 if material else None
    box = BoxDescription(a.volume_m3, a.heater_w, a.fan_role, a.fan_m3_h, area_m2, material, a.step_s)
    new_file.check(box)
    text = new_file.text(box)
    read_twin_file(MemoryFile(Path("twin.yaml"), text.encode()))
    return text


def text_before(path: Path) -> str | None:
    """Return the text of a file, None where it is missing. Errors: DataError"""
    try:
        return read_text(path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: {error}") from error


def put(path: Path, text: str, stamp: str) -> Path | None:
    """Write a file; keep the one before under another name, and return that. Errors: OSError"""
    kept = None
    if path.exists():
        kept = path.resolve().with_name(f"{path.name}.before-{stamp}")
        os.link(path.resolve(), kept)  # the writer gives the new file another inode
    write_atomically(path, text)
    return kept


def start_obstacle() -> list[str]:
    """Return why this process cannot start the service, then the commands that do; [] where it can."""
    if not SYSTEMD.is_dir():
        return ["systemd does not run here. On the rig:", START]
    if not UNIT_FILE.exists():
        return ["the service is not installed. In the checkout:", INSTALL, START]
    return [] if os.geteuid() == 0 else ["only root starts it:", START]


def start_service() -> bool:
    """Start the service now and at each boot; return whether it runs."""
    # A daemon that runs with the settings before starts anew.
    steps = (("systemctl", "enable", "greenhouse"), ("systemctl", "restart", "greenhouse"))
    return all(subprocess.run(step, check=False).returncode == 0 for step in steps)
