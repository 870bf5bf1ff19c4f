"""Language models as controllers of the whole daemon: made, switched, and wired to what they need."""

import threading
from pathlib import Path

import pytest
from llm_parts import KEY, UTC, settings

from edge.assistant.llm.budget import Spending
from edge.assistant.llm.language_model import open_language_model
from edge.core.controller_names import LLM
from edge.core.errors import ConfigError
from edge.core.messages import TickRecord
from edge.sockets.client import request
from tests.support.llm_closed_loop import REFERENCE_C, YAML, run
from training.lab import Lab
from training.llm_stand_in.server import StandIn

pytestmark = pytest.mark.slow

PATIENT = YAML.replace("decision_deadline_s: 1.0", "decision_deadline_s: 4.0")


def test_every_name_decides_and_can_be_switched_to_while_the_daemon_runs() -> None:
    left = list(LLM)
    seen: dict[str, TickRecord] = {}

    def switch(record: TickRecord, lab: Lab) -> None:
        seen.setdefault(record.decision.controller, record)
        if record.decision.controller != left[0]:
            return
        left.pop(0)
        if left:
            threading.Thread(target=order, args=(lab, left[0])).start()
        else:
            lab.stop()

    with StandIn() as stand_in:
        run(left[0], stand_in.url, 300, PATIENT, during=switch)
    assert set(LLM) <= set(seen)
    for name, record in seen.items():
        if name in LLM:
            simulates = LLM[name].assistance not in ("", "sql")
            assert bool(record.decision.forecast) is simulates
            assert record.decision.why["exchanges"] >= 1


def order(lab: Lab, name: str) -> None:
    """From a thread of its own, as the command line does: the control thread is the one that answers."""
    request(Path(lab.settings.control_socket.path), {"do": "set_controller", "name": name})


@pytest.mark.parametrize("name", ["LLM-SQL-Te0", "LLM-HAM-Te0"])
def test_the_scripted_agent_brings_the_air_to_its_reference(name: str) -> None:
    with StandIn() as stand_in:
        ended = run(name, stand_in.url, 30, PATIENT)
    assert {record.decision.controller for record in ended.records} == {name}
    assert ended.error_k < 1.0  # of which the sensor takes 0.4
    assert ended.true_air_c.max() < REFERENCE_C + 1.5
    assert ended.texts("llm.claim") == []


def test_a_temperature_of_one_scatters_and_is_the_same_for_the_same_seed() -> None:
    duties = {}
    for seed in (1, 2):
        for turn in (1, 2):
            with StandIn(seed=seed) as stand_in:
                ended = run("LLM-SQL-Te1", stand_in.url, 8, PATIENT)
            duties[seed, turn] = [record.decision.command.heater_duty for record in ended.records]
    assert duties[1, 1] == duties[1, 2]
    assert duties[1, 1] != duties[2, 1]


def test_without_an_endpoint_there_is_no_such_controller() -> None:
    with pytest.raises(ConfigError, match=r"LLM-Te0 needs llm\.url"):
        run("LLM-Te0", "", 1)


def test_a_key_that_others_can_read_is_refused_at_the_start(tmp_path: Path) -> None:
    key_file = tmp_path / "key"
    key_file.write_text(KEY)
    key_file.chmod(0o644)
    with pytest.raises(ConfigError, match=r"llm\.key_file: .*lets others in"):
        open_language_model(
            settings(key_file=str(key_file)), tmp_path, Spending(""), lambda spent: None, lambda: UTC
        )
