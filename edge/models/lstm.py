"""The LSTM of the paper (tab:method-model-parameters-lstm), fed back over its window, as an ONNX file."""

from edge.formats.input_file import Source
from edge.models.onnx_predictor import OnnxPredictor, read_onnx


def read_lstm(path: Source, step_s: float | None = None) -> OnnxPredictor:
    """Read the predictor "lstm" in `path`, proved by its golden vectors.

    step_s : the control step that it has to be made for [s], None for any
    Errors : DataError that names the file and the key
    """
    return read_onnx(path, "lstm", ("lstm",), step_s)
