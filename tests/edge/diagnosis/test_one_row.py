"""An effect is one function and one row: one that stands nowhere in `edge/` is known everywhere.

No other file of `edge/` may name an effect, so that adding one touches no other file.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from jsonschema import Draft202012Validator, ValidationError

from edge import DiagnosisResult, Run, Twin, diagnose
from edge.core.errors import DataError
from edge.diagnosis.cannot_tell import cannot_tell
from edge.diagnosis.experiment.document import calibration, checks
from edge.diagnosis.prepare import prepare
from edge.diagnosis.twin_choice import candidates_of
from edge.diagnosis.unknowns import with_effect
from edge.twin.effects.effect import BlindRuns, Effect, EffectParameter, HiddenBy
from edge.twin.effects.library import EFFECTS, USUAL_EFFECTS, add_effect
from edge.twin.fit import fit_twin
from edge.twin.model import BoxTwin
from edge.twin.network import Network
from edge.twin.schema import schema
from edge.twin.twin_file import read_twin_file
from edge.twin.value import Value
from tests.support.simulated_runs import (
    BOX,
    QUIET,
    as_diagnosis_runs,
    candidates_only,
    change_run,
    simulate,
    twin_file,
)

ROOT = Path(__file__).parents[3]
# Whole models that are made of effects, in which a new one has no part.
MODELS = {
    "edge/diagnosis/baselines.py": "the simple models of the literature that every twin has to beat",
    "edge/twin/new_file.py": "the first twin file of a box: loss, capacity and fan",
}
FEW = ("heater_lag", "heater_efficiency", "fan_effectiveness", "led_gain")  # beside the new one: fast
HIDDEN = {"ballast_heat": {"P_bal": 25.0}}


def ballast_heat(network: Network, P_bal: float) -> None:
    """The lamp's ballast warms the air that the fan draws past it: Q = P_bal L u_f, L the column `light`."""
    network.heat(lambda now: P_bal * now.column["light"] * now.column["fan_on"])


ROW = Effect(
    ballast_heat,
    (EffectParameter("P_bal", "W", 0.0, 100.0, 10.0),),
    source="this test",
    without="positive in the light while the fan runs",
    needs=("light",),
    starts=({"P_bal": 2.0},),
    check="a thermometer on the ballast",
    hidden_by=(HiddenBy(BlindRuns.LIGHT_STEADY),),
)


@pytest.fixture(autouse=True, scope="module")
def ballast() -> Iterator[None]:
    """The effect in the library, and the library as it was."""
    add_effect(ROW)
    yield
    for table in (EFFECTS, USUAL_EFFECTS):
        del table["ballast_heat"]


def test_a_name_is_given_once() -> None:
    with pytest.raises(ValueError, match="ballast_heat: the library has an effect of this name"):
        add_effect(ROW)


def test_a_twin_file_may_have_it(tmp_path: Path) -> None:
    path = tmp_path / "twin.yaml"
    path.write_text("effects: {ballast_heat: {P_bal: {value: 12.0, rel_sd: 0.1}}}\n", encoding="utf-8")
    assert read_twin_file(path).effects == {"ballast_heat": {"P_bal": Value(12.0, rel_sd=0.1)}}
    path.write_text("effects: {ballast_heat: {P_bal: 2e7}}\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"effects.ballast_heat.P_bal: 2e\+07 is outside 0..1e\+06 W$"):
        read_twin_file(path)


def test_the_schema_knows_it() -> None:
    validator = Draft202012Validator(schema())
    validator.validate({"effects": {"ballast_heat": {"P_bal": 12.0}}})
    with pytest.raises(ValidationError):
        validator.validate({"effects": {"ballast_heat": {"P_ball": 12.0}}})


def test_it_acts() -> None:
    # 20 W of ballast at half the light are 10 W, as much as a duty of 0.1
    duty, fan, column = np.full((1, 30), 0.3), np.ones((1, 30)), {"light": np.full(30, 0.5)}
    lit = BoxTwin(effects={"ballast_heat": {"P_bal": 20.0}}).rollout(
        np.array([21.0]), duty, fan, 21.0, conditions=column
    )
    np.testing.assert_allclose(lit, BoxTwin().rollout(np.array([21.0]), duty + 0.1, fan, 21.0))


def test_it_is_fitted() -> None:
    place = ("effects", "ballast_heat", "P_bal")
    file = twin_file({**BOX, "ballast_heat": {"P_bal": 10.0}}).with_values({place: Value(10.0, fit=True)})
    runs = [simulate({**BOX, **HIDDEN}, seed, 60, QUIET) for seed in (1, 2)]
    assert fit_twin(file, runs).estimates[place].value == pytest.approx(25.0, rel=1e-3)


def test_it_is_a_candidate_where_its_column_is_and_begins_at_its_start() -> None:
    run = simulate(BOX, 1, 60)
    lit, dark = (
        prepare(twin_file(), as_diagnosis_runs([item])).fit_runs
        for item in (run, change_run(run, light=None))
    )
    assert "ballast_heat" in candidates_of(twin_file(), lit)
    assert "ballast_heat" not in candidates_of(twin_file(), dark)
    (begun,) = with_effect(twin_file(), "ballast_heat")
    assert begun.effects["ballast_heat"] == {"P_bal": Value(2.0, fit=True)}


def test_recordings_that_hide_it_say_so() -> None:
    told = "\n".join(cannot_tell([change_run(simulate(BOX, 1, 60), light=None)], {}, 1))
    assert "the light was not recorded: led_gain and ballast_heat can't be told" in told


def test_its_measurement_is_offered() -> None:
    assert checks(["ballast_heat"]) == ("a thermometer on the ballast",)
    assert calibration(("effects", "ballast_heat", "P_bal")) == "a thermometer on the ballast"


@pytest.fixture(scope="module")
def found() -> DiagnosisResult:
    """The diagnosis of runs in which it acts, by a twin that lacks it."""
    runs = [simulate({**BOX, **HIDDEN}, seed, 60) for seed in (1, 2)]
    with candidates_only(*FEW, "ballast_heat"):
        return diagnose(Twin(twin_file()), [Run(run.path.name, run) for run in runs])


@pytest.mark.slow
def test_a_diagnosis_names_it(found: DiagnosisResult) -> None:
    assert found.verdict == "named"
    (effect,) = found.document["effects"]
    assert effect["name"] == "ballast_heat"
    value = effect["parameters"]["P_bal"]
    assert value["unit"] == "W"
    assert value["low"] < 25.0 < value["high"]
    assert effect["without"] == ROW.without
    assert found.twin is not None
    assert "ballast_heat" in found.twin.file.effects


def test_the_report_says_it_in_plain_words(found: DiagnosisResult, tmp_path: Path) -> None:
    page = found.report(tmp_path).read_text(encoding="utf-8")
    assert "the lamp's ballast warms the air that the fan draws past it" in page.replace("&#x27;", "'")
    assert "One effect is missing: the lamp's ballast warms the air" in str(found)


# nothing else names effects


@cache
def texts(path: Path) -> tuple[str, ...]:
    """Strings of a file, docstrings left out; the parts of an f-string are strings too."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    alone = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    strings = (node for node in nodes if isinstance(node, ast.Constant) and id(node) not in alone)
    return tuple(node.value for node in strings if isinstance(node.value, str))


def words(path: Path) -> set[str]:
    """Whole words of all strings."""
    return {word for text in texts(path) for word in re.findall(r"\w+", text)}


def others() -> list[Path]:
    """Files of `edge/` but the library's."""
    library = ROOT / "edge/twin/effects"
    return [path for path in sorted((ROOT / "edge").rglob("*.py")) if library not in path.parents]


def test_no_other_file_names_an_effect() -> None:
    names = set(EFFECTS) | {"ballast_heat"}
    naming = {str(path.relative_to(ROOT)) for path in others() if words(path) & names}
    assert naming == set(MODELS)  # one that no longer names any leaves the list


def test_no_other_file_names_a_parameter() -> None:
    parameters = {item.name for effect in EFFECTS.values() for item in effect.parameters}
    free = [path for path in others() if str(path.relative_to(ROOT)) not in MODELS]
    assert {path.name: own for path in free if (own := set(texts(path)) & parameters)} == {}


def test_a_name_in_a_string_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "some.py"
    path.write_text('"""wall_loss"""\nSTARTS = {"soil_mass": 1}\nprint(f"{1}: heater_lag and others")\n')
    assert words(path) & set(EFFECTS) == {"soil_mass", "heater_lag"}
