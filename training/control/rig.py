"""The rig that all controllers are compared on: its settings, its models, the entries of the table."""

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from edge.board.virtual_rig import settings_in
from edge.bundle.archive import open_archive
from edge.bundle.predictors import loader
from edge.bundle.roles import activate
from edge.bundle.sign import ManifestFacts, build_bundle, generate_key
from edge.bundle.store import BundleStore
from edge.config.settings import (
    BundleSettings,
    ControlSettings,
    DriftSettings,
    LlmSettings,
    ReferenceSettings,
    Settings,
)
from edge.controllers.rules import Thresholds
from edge.core.controller_names import CONTROLLERS, LLM, MPC, MPC_TWIN, RL
from edge.models.arx_file import DEFAULT_PATH

Models = Literal[
    "arx", "packaged", "twin"
]  # the packaged ARX alone; the packaged bundle; ARX and commissioned twin
TWIN = Path(__file__).parents[1] / "results" / "control" / "twin.yaml"  # of two hours of step tests
TIME_BOX_MS = (
    60_000.0  # so long that only nodes and rollouts are counted: the same run gives the same figures
)
NO_LLM = LlmSettings()
SPARING = {  # ours with more weight on effort, to be set beside others that spend less
    "MPC-Twin-P/100": 100.0, "MPC-Twin-P/1000": 1000.0, "MPC-Twin-P/4000": 4000.0, "MPC-Twin-P/6000": 6000.0,
}  # fmt: skip
PLANNING = (*MPC, *MPC_TWIN)  # that have a use for the coming reference
TUNED = Thresholds(0.2, 0.2, 2.5, 1.0)  # the cheapest of a grid, as PID's gains
HYBRID = {"predictor": "ham"}
KNOWS, HELD = {"preview": True}, {"twin_preview": False}
ANY_K = 20.0  # above what the air can leave the reference by
EARLY = {"twin_early_k": ANY_K}
Rule = Literal["free", "band", "present"]  # what a plan may do with the coming reference
CREATED = "2026-01-01T00:00:00Z"


@dataclass(frozen=True, slots=True)
class ComparisonEntry:
    """A row of the comparison.

    name : in the table; controller : of the daemon
    models : what the rig has; control : settings that differ from the usual ones
    clairvoyant : instead of the controller the best plan for the air's mean, or for what its sensor shows
    rule : of a clairvoyant, leave the reference before a step as it likes, keep MPC-Twin's rules (by at most
        `control.twin_early_k`, and no heat against the fan), or know the present reference alone
    whole : a clairvoyant's fan is off or on for all of a step
    unbounded : BFGS without the bounds of the paper's problem, clipped afterwards
    thresholds : of a thermostat other than the daemon's
    """

    name: str
    controller: str
    models: Models = "arx"
    control: Mapping[str, Any] = field(default_factory=dict)
    clairvoyant: Literal["true", "sensor"] | None = None
    rule: Rule = "free"
    whole: bool = False
    unbounded: bool = False
    thresholds: Thresholds | None = None

    @property
    def preview(self) -> bool:
        """True where the controller plans for the coming reference."""
        control = replace(ControlSettings(), **self.control)
        known = control.twin_preview if self.controller in MPC_TWIN else control.preview
        return self.controller in PLANNING and known

    @property
    def keeps_band(self) -> bool:
        """True where the coming reference is known, but the air stays near the present one until a step."""
        if self.clairvoyant is not None:
            return self.rule == "band"
        early_k = replace(ControlSettings(), **self.control).twin_early_k
        return self.controller in MPC_TWIN and self.preview and early_k < ANY_K


def entries() -> dict[str, ComparisonEntry]:
    """All that can be compared so far, by name."""
    listed = [
        *_clairvoyants(),
        ComparisonEntry("rules", "rules"),
        ComparisonEntry("rules/tuned", "rules", thresholds=TUNED),
        ComparisonEntry("PID", "PID"),
        *(ComparisonEntry(name, name) for name in MPC),
        *(ComparisonEntry(f"{name}/preview", name, control=KNOWS) for name in MPC),
        # Both readings of the paper's method: its text names BFGS, which knows no bounds.
        *(ComparisonEntry(f"{name}/unbounded", name, unbounded=True) for name in ("MPC-BFGS", "MPC-BFGS-P")),
        ComparisonEntry("MPC-Twin", "MPC-Twin", "twin"),
        ComparisonEntry("MPC-Twin-P", "MPC-Twin-P", "twin"),
        *(ComparisonEntry(f"{name}/early", name, "twin", EARLY) for name in MPC_TWIN),
        *(ComparisonEntry(f"{name}/present", name, "twin", HELD) for name in MPC_TWIN),
        *(
            ComparisonEntry(name, "MPC-Twin-P", "twin", {"penalty_weight": weight} | EARLY)
            for name, weight in SPARING.items()
        ),
        *(ComparisonEntry(f"{name}/HAM", name, "packaged", HYBRID) for name in ("MPC", "MPC-P")),
        *(
            ComparisonEntry(f"{name}/HAM/preview", name, "packaged", HYBRID | KNOWS)
            for name in ("MPC", "MPC-P")
        ),
    ]
    listed += [ComparisonEntry(name, name, "packaged") for name in (*RL, *LLM) if name in CONTROLLERS]
    return {entry.name: entry for entry in listed}


def _clairvoyants() -> Iterator[ComparisonEntry]:
    """Yield them by weight of effort: free ones for each air, and those for the sensor with a rule or fan."""
    for end in ("", "-P"):
        yield ComparisonEntry(f"clairvoyant{end}", "rules", clairvoyant="true")
        yield ComparisonEntry(f"clairvoyant{end}/whole", "rules", clairvoyant="true", whole=True)
        name = f"clairvoyant/sensor{end}"
        sensor = ComparisonEntry(name, "rules", clairvoyant="sensor")
        yield sensor
        yield replace(sensor, name=f"{name}/whole", whole=True)
        yield replace(sensor, name=f"{name}/band", rule="band")
        yield replace(sensor, name=f"{name}/band/whole", rule="band", whole=True)
        yield replace(sensor, name=f"{name}/present", rule="present")


def settings_for(
    entry: ComparisonEntry, reference: Path, folder: Path, llm: LlmSettings = NO_LLM
) -> Settings:
    """Return the daemon's settings for one run, all files in `folder`.

    Errors : SettingError for a language model's entry without an endpoint
    """
    rig = settings_in(folder, Settings(timezone="UTC"))
    return replace(
        rig,
        control=replace(
            ControlSettings(), controller=entry.controller, time_box_ms=TIME_BOX_MS, **entry.control
        ),
        llm=llm if entry.controller in LLM else NO_LLM,
        reference=ReferenceSettings(kind="csv", csv=str(reference)),
        bundle=replace(rig.bundle, path="") if entry.models == "arx" else rig.bundle,
        drift=DriftSettings(enabled=False),
    )


def install_twin(bundle: BundleSettings, step_s: float, twin: Path = TWIN) -> None:
    """Make the bundle active that has the packaged ARX and `twin`, signed by a key of this folder alone."""
    keys, models = Path(bundle.trusted_keys), Path(bundle.path).with_name("models")
    for folder in (keys, models):
        folder.mkdir(parents=True)
    shutil.copyfile(DEFAULT_PATH, models / "arx.json")
    shutil.copyfile(twin, models / "twin.yaml")
    private = models.with_name("signing.pem")
    shutil.move(generate_key(private), keys)
    archive = models.with_name("twin.zip")
    build_bundle(models, archive, ManifestFacts("1.0", CREATED, "0" * 64, step_s), private)
    store = BundleStore(Path(bundle.path), keys, loader(step_s))
    with open_archive(archive) as file:
        store.install(file)
    store.change(lambda roles: activate(roles, None))
