"""The predictors of a bundle's folder: what its manifest names, each held to the manifest's word."""

from collections.abc import Callable, Mapping
from functools import partial

from edge.bundle.manifest import MANIFEST, TWIN, Manifest
from edge.core.errors import DataError
from edge.core.predictor import Predictor
from edge.formats.input_file import Folder, Source

Load = Callable[[Folder, Manifest], Mapping[str, Predictor]]


def loader(step_s: float) -> Load:
    """`load_predictors` for a rig whose control step is `step_s`."""
    return partial(load_predictors, step_s=step_s)


def load_predictors(folder: Folder, manifest: Manifest, step_s: float) -> dict[str, Predictor]:
    """Predictors by name, in the manifest's order; each proves its contract as it is read.

    folder : a bundle whose hashes have been checked
    Errors : DataError beginning with the file's or the manifest's key, also for another control step and
        for a hybrid that was trained on another twin
    """
    if manifest.sample_s != step_s:
        raise DataError(
            f"{MANIFEST}: sample_s: made for {manifest.sample_s:g} s, control.step_s is {step_s:g}"
        )
    _check_twin(folder, manifest)
    predictors = {}
    for name, entry in manifest.models.items():
        model = _READ[name](folder / entry.file, manifest)
        if model.step_s != manifest.sample_s:
            raise DataError(
                f"{entry.file}: is made for steps of {model.step_s:g} s, "
                f"the bundle for {manifest.sample_s:g} s"
            )
        predictors[name] = model
    return predictors


def _check_twin(folder: Folder, manifest: Manifest) -> None:
    from edge.models.pbm import read_twin

    found = read_twin(folder / TWIN).twin.sha256
    if found != manifest.twin_sha256:
        raise DataError(f"{MANIFEST}: twin_sha256: is not that of {TWIN}, {found}")


def _arx(path: Source, manifest: Manifest) -> Predictor:
    from edge.models.arx_file import read_arx

    return read_arx(path)


def _pbm(path: Source, manifest: Manifest) -> Predictor:
    from edge.models.pbm import read_twin

    return read_twin(path)


def _lstm(path: Source, manifest: Manifest) -> Predictor:
    from edge.models.onnx_predictor import read_lstm

    return read_lstm(path)


def _ham(path: Source, manifest: Manifest) -> Predictor:
    from edge.models.onnx_predictor import read_ham

    return read_ham(path, manifest.twin_sha256)


_READ: dict[str, Callable[[Source, Manifest], Predictor]] = {
    "arx": _arx,
    "pbm": _pbm,
    "lstm": _lstm,
    "ham": _ham,
}
