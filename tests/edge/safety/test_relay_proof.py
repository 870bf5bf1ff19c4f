"""When heat and fan are held back, and what ends it."""

import math
from dataclasses import replace

import pytest

from edge.safety.relay_proof import BUSY_SHARE, EVERY_S, LONGEST_S, PASSED_K, RelayProof, follow
from edge.safety.thermal_supervision import QUIET_S, SETTLE_S, SHORT_S, Observation, ThermalMemory, look

STEP_S = 60.0
THREE_HOURS_S = 10800.0  # as docs/safety.md promises
BUSY = RelayProof(since_s=EVERY_S - STEP_S, heated_s=3000.0, fanned_s=3000.0)
RUNNING = RelayProof(since_s=EVERY_S, running_s=0.0, highest_c=26.0)


def step(proof: RelayProof, temp_air: float = 26.0, heated: bool = False, fan_on: bool = False) -> RelayProof:
    return follow(proof, STEP_S, temp_air, heated, fan_on, quiet=False)


def test_a_box_that_heats_and_cools_in_turns_is_proven_after_its_time():
    proof, steps = RelayProof(), 0
    while not proof.running:
        proof = step(proof, heated=steps % 2 == 0, fan_on=steps % 2 == 1)
        steps += 1
    assert steps * STEP_S == THREE_HOURS_S


@pytest.mark.parametrize(("heated", "fan_on"), [(True, False), (False, True), (False, False)])
def test_a_box_that_does_only_one_of_both_is_left_alone(heated, fan_on):
    proof = RelayProof()
    for _ in range(int(3 * EVERY_S / STEP_S)):
        proof = step(proof, heated=heated, fan_on=fan_on)
        assert not proof.running


@pytest.mark.parametrize(("share", "runs"), [(0.999, False), (1.0, True), (1.001, True)])
def test_the_share_of_time_at_its_edge(share, runs):
    busy_s = share * BUSY_SHARE * EVERY_S
    for name in ("heated_s", "fanned_s"):
        assert step(replace(BUSY, **{name: busy_s})).running is runs


def test_a_quiet_box_is_its_own_proof():
    for proof in (BUSY, RUNNING):
        assert follow(proof, STEP_S, 26.0, False, False, quiet=True) == RelayProof()


@pytest.mark.parametrize(
    ("fallen", "runs"), [(0.0, True), (0.999, True), (1.0, False), (1.001, False), (-9.0, True)]
)
def test_air_that_falls_ends_it(fallen, runs):
    assert step(RUNNING, 26.0 - fallen * PASSED_K).running is runs


def test_a_box_that_cools_by_itself_has_proven_its_relay():
    proof = step(replace(BUSY, since_s=0.0), 28.0)
    assert step(proof, 28.0 - 0.99 * PASSED_K).heated_s == BUSY.heated_s
    assert step(proof, 28.0 - PASSED_K) == RelayProof()


@pytest.mark.parametrize("input_on", [{"heated": True}, {"fan_on": True}])
def test_air_that_falls_under_an_input_proves_nothing(input_on):
    proof = step(step(replace(BUSY, since_s=0.0), 28.0), 26.0, **input_on)
    assert proof.since_s > 0.0
    assert step(proof, 25.5).since_s > 0.0  # the highest is counted anew


def test_air_that_is_no_number_does_not_end_it():
    assert step(RUNNING, float("nan")).running


def test_it_never_lasts_longer_than_its_bound():
    proof, steps = RUNNING, 0
    while proof.running:
        proof = step(proof, 27.0)
        steps += 1
    assert steps * STEP_S == 25 * 60.0
    assert proof == RelayProof()


@pytest.mark.parametrize(("seconds", "runs"), [(THREE_HOURS_S - 0.5, False), (THREE_HOURS_S, True)])
def test_time_counts_from_zero(seconds, runs):
    assert follow(RelayProof(), seconds, 26.0, heated=True, fan=1.0, quiet=False).running is runs


@pytest.mark.parametrize(("busy_s", "runs"), [(1079.0, False), (1080.0, True)])
def test_a_tenth_of_three_hours_counts_as_busy(busy_s, runs):
    busy = RelayProof(since_s=THREE_HOURS_S - STEP_S, heated_s=busy_s, fanned_s=busy_s)
    assert step(busy).running is runs


@pytest.mark.parametrize(("fallen_k", "runs"), [(0.99, True), (1.0, False)])
def test_air_that_falls_by_one_kelvin_proves_the_relay(fallen_k, runs):
    assert step(RUNNING, 26.0 - fallen_k).running is runs


def test_the_balance_has_judged_before_the_longest_proof_ends():
    assert SETTLE_S + SHORT_S == QUIET_S < LONGEST_S


def test_supervision_resets_the_proof_once_heater_and_fan_were_still_long_enough():
    memory, still = ThermalMemory(proof=BUSY), Observation(STEP_S, 22.0, 21.0, 0.0, False, 0.0)
    for _ in range(int(QUIET_S / STEP_S) + 2):
        memory, findings = look(replace(memory, proof=replace(memory.proof, since_s=0.0)), still)
        assert findings == ()
    assert memory.proof == RelayProof()


@pytest.mark.parametrize(
    ("proof", "due_s"),
    [
        (RelayProof(), math.inf),
        (RUNNING, 0.0),
        (BUSY, STEP_S),
        (replace(BUSY, since_s=EVERY_S + 30.0), 0.0),
        (replace(BUSY, fanned_s=100.0), math.inf),
        (replace(BUSY, heated_s=100.0), math.inf),
    ],
)
def test_the_time_to_the_next_proof(proof, due_s):
    assert proof.due_in_s == due_s
