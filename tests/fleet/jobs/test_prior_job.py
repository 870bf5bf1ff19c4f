"""The prior of a night: from told twins to the start of a new box, and the boxes unlike their kind."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import Engine, select
from sqlalchemy.orm import Session

from edge.__main__ import main
from edge.core.errors import DataError
from edge.diagnosis.baselines import bare
from edge.twin.twin_file import TwinFile, read_twin_file, twin_document, write_twin_file
from edge.twin.value import Value
from fleet.commands.work import WORK
from fleet.database.base import open_database
from fleet.database.lease import FleetLease
from fleet.database.rigs import FleetRig
from fleet.database.twins import Departure, KeptPrior, ToldTwin
from fleet.jobs.prior_job import newest_prior, renew_prior
from fleet.settings import DatabaseSettings

RNG = np.random.default_rng(3)


def twin(loss: float = 2.4) -> TwinFile:
    def about(value: float) -> Value:
        return Value(float(value * np.exp(0.05 * RNG.normal())))

    effects = {"wall_loss": {"UA": about(loss)}, "extra_capacity": {"kC": about(4.0)}}
    return replace(TwinFile(), effects=effects, fan_role="none")


def tell(engine: Engine, rig: str, document: dict[str, object]) -> None:
    with Session(engine) as session, session.begin():
        if session.get(FleetRig, rig) is None:
            session.add(FleetRig(name=rig, kind="tent", first_utc=1.0, last_utc=2.0))
            session.flush()
        session.merge(ToldTwin(rig=rig, bundle="b", utc=1.0, document=document))


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    engine = open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"))
    yield engine
    engine.dispose()


def test_a_box_unlike_its_kind_is_told_until_it_is_like_it_again(engine: Engine) -> None:
    for number in range(4):
        tell(engine, f"tent-{number}", twin_document(twin()))
    tell(engine, "tent-4", twin_document(twin(loss=12.0)))
    assert renew_prior(engine, 10.0).boxes == 5
    with Session(engine) as session:
        (found,) = session.scalars(select(Departure)).all()
    assert (found.rig, found.effect, found.parameter) == ("tent-4", "wall_loss", "UA")
    assert found.ratio == pytest.approx(5.0, rel=0.2) and found.spreads > 3.0
    renew_prior(engine, 20.0)
    with Session(engine) as session:
        assert session.scalars(select(Departure)).one().since_utc == 10.0
    tell(engine, "tent-4", twin_document(twin()))
    assert renew_prior(engine, 30.0).departures == 0
    with Session(engine) as session:
        assert session.scalars(select(Departure)).all() == []
        assert [kept.utc for kept in session.scalars(select(KeptPrior))] == [10.0, 20.0, 30.0]


def test_a_twin_that_nobody_can_read_is_left_out_and_named(engine: Engine) -> None:
    tell(engine, "tent-1", twin_document(twin()))
    tell(engine, "liar", {"effects": {"wall_loss": {"UA": "a lot"}}})
    done = renew_prior(engine, 10.0)
    assert done.boxes == 1 and "wall_loss.UA" in done.unread["liar"]


def test_a_prior_is_read_back_as_it_was_kept(engine: Engine) -> None:
    with pytest.raises(DataError, match="no prior yet"):
        newest_prior(engine)
    with pytest.raises(DataError, match="no box has told"):
        renew_prior(engine, 10.0)
    for number in range(3):
        tell(engine, f"tent-{number}", twin_document(twin()))
    renew_prior(engine, 10.0)
    start = newest_prior(engine).start(bare(twin()), "tent")
    assert start.effects["wall_loss"]["UA"].value == pytest.approx(2.4, rel=0.15)


def test_a_new_box_is_started_by_two_commands(
    engine: Engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def call(*words: str | Path) -> int:
        given = ["fleet", *map(str, words), "--settings", f"{tmp_path}/fleet.yaml"]
        monkeypatch.setattr("sys.argv", ["greenhouse", *given])
        return main(given)

    (tmp_path / "fleet.yaml").write_text(f'database: {{url: "sqlite:///{tmp_path}/fleet.db"}}\n')
    write_twin_file(
        replace(twin(), effects={"wall_loss": {"UA": Value(1.0, fit=True)}}), tmp_path / "box.yaml"
    )
    for number in range(3):
        tell(engine, f"tent-{number}", twin_document(twin()))
    lease = FleetLease(engine, WORK)
    assert lease.take() == ""  # as while the service does them
    assert call("work") == 2
    assert "does the jobs of a night now" in capsys.readouterr().err
    lease.give_back()
    assert call("work") == 0
    assert "prior: of 3 boxes; 0 values are far" in capsys.readouterr().out
    assert call("prior", tmp_path / "box.yaml", "--kind", "tent", "--out", tmp_path / "start.yaml") == 0
    assert "no box of kind" not in capsys.readouterr().out
    assert read_twin_file(tmp_path / "start.yaml").effects["wall_loss"]["UA"].value == pytest.approx(
        2.4, rel=0.15
    )
    assert call("prior", tmp_path / "box.yaml", "--kind", "shed", "--out", tmp_path / "start.yaml") == 0
    assert "known kinds: tent" in capsys.readouterr().out
    assert read_twin_file(tmp_path / "start.yaml").to_fit() == []
