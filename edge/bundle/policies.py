"""The policies of a bundle's folder: what its manifest names, each held to the manifest's step."""

from edge.bundle.manifest import Manifest
from edge.formats.input_file import Folder
from edge.models.onnx_policy import OnnxPolicy, read_policy


def load_policies(folder: Folder, manifest: Manifest) -> dict[str, OnnxPolicy]:
    """Policies by the controller that they are for, in the manifest's order; each proved as it is read.

    folder : a bundle whose hashes have been checked
    Errors : DataError beginning with the file
    """
    return {
        name: read_policy(folder / entry.file, name, manifest.sample_s)
        for name, entry in manifest.policies.items()
    }
