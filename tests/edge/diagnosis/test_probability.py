"""edge/diagnosis/verdict.py: how sure a name is."""

from edge.diagnosis.verdict import MOST_SURE, evidence, probability


def sure(nats: float = 30.0, with_k: float = 0.1, without_k: float = 0.5) -> float:
    return probability(evidence(nats, with_k, without_k))


def test_more_evidence_is_never_less_sure() -> None:
    assert sure(nats=5.0) < sure(nats=20.0) <= sure(nats=80.0)
    assert sure(without_k=0.11) < sure(without_k=0.2) <= sure(without_k=2.0)


def test_nothing_is_certain() -> None:
    assert sure(nats=1e9, without_k=1e6) == MOST_SURE
    assert 0.0 <= sure(nats=-50.0, with_k=5.0, without_k=5.0) < 0.1


def test_odd_numbers_are_no_error() -> None:
    for numbers in ((0.0, 0.0, 1.0), (1.0, 1e-12, 1.0), (-1.0, 1e9, 1.0)):
        assert 0.0 <= probability(evidence(*numbers)) <= MOST_SURE
