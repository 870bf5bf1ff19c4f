"""Print the name of a model in a GGUF file, with size and quantisation: `python bench/llm_gguf_name.py FILE`.

Run by the environment that has the package gguf.
"""

import sys
from pathlib import Path

from gguf import GGUFReader, LlamaFileType


def name_of(path: Path) -> str:
    """E.g. SmolLM2-135M-Instruct, 135 M parameters, Q4_1"""
    reader = GGUFReader(path)
    parameters = sum(int(tensor.n_elements) for tensor in reader.tensors)
    kind = LlamaFileType(int(reader.fields["general.file_type"].contents())).name
    quantisation = kind.removeprefix("MOSTLY_").removeprefix("ALL_")
    return f"{path.stem.split('.')[0]}, {parameters / 1e6:.0f} M parameters, {quantisation}"


if __name__ == "__main__":
    print(name_of(Path(sys.argv[1])))
