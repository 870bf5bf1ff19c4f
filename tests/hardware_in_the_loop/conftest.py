"""The whole daemon against a virtual board: modules beside this folder and in it can be imported."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
