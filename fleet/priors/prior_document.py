"""A prior as JSON, so that it is fitted once a night and read whenever a box is new."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any

from edge.formats.cross_check import Rule
from fleet.priors.fleet_prior import FleetPrior
from fleet.priors.population import Population, ValuePrior

Share = Annotated[float, Rule(low=0.0, high=1.0)]
Spread = Annotated[float, Rule(above=0.0)]


@dataclass(frozen=True, slots=True)
class MeanDocument:
    """A kind's mean."""

    mean: float
    sd: Spread


@dataclass(frozen=True, slots=True)
class PopulationDocument:
    """A value over all kinds."""

    mean: float
    between: Spread
    within: Spread
    kinds: Mapping[str, MeanDocument]


@dataclass(frozen=True, slots=True)
class PriorDocument:
    """All of it. values : by effect and parameter; misses_k, loss_shares : by kind"""

    shares: Mapping[str, Mapping[str, Share]]
    values: Mapping[str, Mapping[str, PopulationDocument]]
    misses_k: Mapping[str, Spread] = field(default_factory=dict)
    loss_shares: Mapping[str, Spread] = field(default_factory=dict)


def document_of(prior: FleetPrior) -> dict[str, Any]:
    """Return mappings, texts and numbers that `prior_of` reads back to the same."""
    values: dict[str, dict[str, Any]] = {}
    for (effect, parameter), population in prior.values.items():
        values.setdefault(effect, {})[parameter] = asdict(population)
    by_kind = {"misses_k": dict(prior.misses_k), "loss_shares": dict(prior.loss_shares)}
    return {"shares": prior.shares, "values": values, **by_kind}


def prior_of(document: PriorDocument) -> FleetPrior:
    """Return the prior that a document holds."""
    values = {
        (effect, parameter): Population(
            own.mean,
            own.between,
            own.within,
            {kind: ValuePrior(about.mean, about.sd) for kind, about in own.kinds.items()},
        )
        for effect, parameters in document.values.items()
        for parameter, own in parameters.items()
    }
    shares = {kind: dict(own) for kind, own in document.shares.items()}
    return FleetPrior(shares, values, dict(document.misses_k), dict(document.loss_shares))
