"""The hybrid (paper, eq. method-hybrid-model) over the twin that it was trained on, as an ONNX file."""

from edge.formats.input_file import Source
from edge.models.onnx_predictor import OnnxPredictor, read_onnx

KINDS = ("ham", "ham_guarded")  # the paper's, and the one that falls back to its twin outside its data


def read_ham(path: Source, twin_sha256: str, step_s: float | None = None) -> OnnxPredictor:
    """Read the predictor "ham" in `path`, proved by its golden vectors; its `kind` names the hybrid.

    twin_sha256 : `Twin.sha256` of the twin beside it: a hybrid corrects one twin and no other
    step_s : the control step that it has to be made for [s], None for any
    Errors : DataError that names the file and the key
    """
    return read_onnx(path, "ham", KINDS, step_s, twin_sha256)
