"""Fits and rehearsals of a night, from numbers in store."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import Engine
from sqlalchemy.orm import Session
from stored_ticks import START, store

from edge.twin.twin_file import twin_document
from fleet.database.base import open_database
from fleet.database.events import RigEvent
from fleet.database.rigs import FleetRig
from fleet.database.twins import ToldTwin
from fleet.jobs import structure_job
from fleet.jobs.prior_job import newest_prior, renew_prior
from fleet.jobs.rehearsal_job import known_rehearsals, rehearse_kinds
from fleet.jobs.structure_job import DAY_S, fit_structures, known_fits
from fleet.jobs.told_sheets import told_sheets
from fleet.numbers.victoria import Numbers
from fleet.priors.kind_structure import CONVECTION
from fleet.settings import DatabaseSettings, NumbersSettings
from tests.support.simulated_runs import BOX, Effects, simulate, twin_file
from tests.support.victoria import Victoria, needs_victoria

LAG = {"heater_lag": {"tau_h": 400.0}}
SOIL = {"soil_mass": {"C_s": 9000.0, "G_s": 3.0}}
FAN = {"fan_effectiveness": {"eps_f": 0.5}}
NOWHERE = NumbersSettings(url="http://127.0.0.1:9")
NIGHT = START + DAY_S


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    engine = open_database(DatabaseSettings(url=f"sqlite:///{tmp_path}/fleet.db"))
    yield engine
    engine.dispose()


def tell(engine: Engine, rig: str, added: Effects, utc: float = START, *, kind: str = "tent") -> None:
    with Session(engine) as session, session.begin():
        if session.get(FleetRig, rig) is None:
            session.add(FleetRig(name=rig, kind=kind, first_utc=START, last_utc=START))
            session.flush()
        document = twin_document(twin_file({**BOX, **FAN, **added}))
        session.merge(ToldTwin(rig=rig, bundle="b", utc=utc, document=document))


def wanted(engine: Engine, utc: float) -> set[tuple[str, str]]:
    """Return which boxes are fitted at a time, in which structure."""
    asked: set[tuple[str, str]] = set()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(structure_job, "carry_out", lambda job: asked.add((job.rig, "+".join(job.structure))))
        assert fit_structures(engine, NOWHERE, utc, workers=0) == (0, len(asked))
    return asked


def test_boxes_are_fitted_after_a_day_and_where_there_are_two(engine: Engine) -> None:
    tell(engine, "alone", LAG, kind="case")
    tell(engine, "nobody-said-1", LAG, kind="")
    tell(engine, "nobody-said-2", SOIL, kind="")
    tell(engine, "rig-1", LAG)
    tell(engine, "rig-2", SOIL)
    assert wanted(engine, NIGHT - 1.0) == set()
    names = ("heater_lag", "soil_mass", "soil_mass+heater_lag", "soil_mass+slow_mass+heater_lag")
    every = {
        (rig, name + bent) for rig in ("rig-1", "rig-2") for name in names for bent in ("", f"+{CONVECTION}")
    }
    assert wanted(engine, NIGHT) == every
    # Where the numbers cannot be reached nothing is kept, and another night tries again.
    assert fit_structures(engine, NOWHERE, NIGHT, workers=0) == (0, len(every))
    assert wanted(engine, NIGHT + DAY_S) == every


def test_a_box_that_has_changed_is_not_fitted(engine: Engine) -> None:
    for number, added in enumerate((LAG, SOIL, SOIL), 1):
        tell(engine, f"rig-{number}", added)
    with Session(engine) as session, session.begin():
        event = RigEvent(rig="rig-3", history_id="h", seq=1, number=0, utc=START, key="twin.disagrees")
        event.severity, event.text = "warning", "it disagrees"
        session.add(event)
    assert {rig for rig, _ in wanted(engine, NIGHT)} == {"rig-1", "rig-2"}


@needs_victoria
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_kind_has_the_structure_that_its_numbers_show(engine: Engine, tmp_path: Path) -> None:
    with Victoria(tmp_path) as victoria:
        numbers = NumbersSettings(url=victoria.url)
        for number, added in enumerate((SOIL, LAG), 1):
            store(Numbers(numbers), f"rig-{number}", simulate({**BOX, **LAG}, number, 240))
            tell(engine, f"rig-{number}", added)
        renew_prior(engine, NIGHT)
        assert newest_prior(engine).structure("tent") == ()
        assert fit_structures(engine, numbers, NIGHT, workers=0) == (16, 0)
        assert fit_structures(engine, numbers, NIGHT + 1.0, workers=0) == (0, 0)
        # Where the numbers cannot be reached nothing is kept, and another night tries again.
        assert rehearse_kinds(engine, NOWHERE, NIGHT, workers=0) == (0, 2)
        assert rehearse_kinds(engine, numbers, NIGHT, workers=0) == (2, 0)
        assert rehearse_kinds(engine, numbers, NIGHT + 1.0, workers=0) == (0, 0)
        told = told_sheets(engine)
        rehearsed = known_rehearsals(engine, told)
        assert rehearsed.keys() == known_fits(engine, told).keys()
        renew_prior(engine, NIGHT + 2.0)
        prior = newest_prior(engine)
        assert prior.misses_k["tent"] < 0.3
        assert prior.structure("tent") == ("heater_lag",)
        start = prior.start(twin_file({**BOX, **FAN}), "tent")
        assert start.effects["heater_lag"]["tau_h"].value == pytest.approx(400.0, rel=0.2)
        # A broker tells a kept twin again; what a box was before it told another one says nothing of it now.
        tell(engine, "rig-1", SOIL, utc=NIGHT)
        assert fit_structures(engine, numbers, NIGHT + 3.0, workers=0) == (0, 0)
        tell(engine, "rig-1", LAG, utc=NIGHT)
        assert fit_structures(engine, numbers, NIGHT + 4.0, workers=0) == (2, 0)
        # The others of a box are other ones then, so each is rehearsed anew.
        assert rehearse_kinds(engine, numbers, NIGHT + 4.0, workers=0) == (2, 0)
