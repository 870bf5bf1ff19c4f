"""An ONNX graph as onnxruntime runs it on the rig: one thread, no memory kept.

onnxruntime is imported when a file is read and not before: a rig without such a model never pays for it.
"""

import os
from typing import Any

from edge.core.errors import DataError


def open_session(content: bytes) -> Any:
    """Open a session on the bytes of an ONNX file. Errors: DataError where they cannot be run"""
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # newer than the pinned version, it would call its maker
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # the other cores are not ours
    options.enable_cpu_mem_arena = False  # it keeps the memory of the largest batch for good
    options.log_severity_level = 4  # what goes wrong is raised
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its own errors have no other base
        raise DataError(f"not an ONNX file that can be run: {one_line(error)}") from error


def one_line(error: Exception) -> str:
    """Its text, fit for an error of ours."""
    return " ".join(str(error).split())
