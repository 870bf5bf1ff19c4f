"""Save a GGUF file's model in the form of transformers: `python bench/llm_from_gguf.py FILE FOLDER`.

Run by the environment that the server is installed in. The weights are those of the file, as 32 bit floats.
"""

import sys
from pathlib import Path

from transformers import AutoModelForCausalLM, AutoTokenizer


def save(path: Path, folder: Path) -> None:
    """Model and tokenizer with its chat template."""
    given = {"gguf_file": path.name}
    AutoTokenizer.from_pretrained(path.parent, **given).save_pretrained(folder)
    read = AutoModelForCausalLM.from_pretrained(path.parent, **given)
    config = read.config
    del config.quantization_config  # it calls the floats quantised still, and would not be saved
    model = AutoModelForCausalLM.from_config(config)
    model.load_state_dict(read.state_dict())
    model.save_pretrained(folder)


if __name__ == "__main__":
    save(Path(sys.argv[1]), Path(sys.argv[2]))
