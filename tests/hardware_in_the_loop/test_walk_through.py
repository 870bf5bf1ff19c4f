"""From a board to commissioned control, each step a command of the manual, in simulated time.

`make walk-through` goes the same way from an empty board in simavr, with an hour of step tests: half an hour
gives a twin that controls less well.
"""

from pathlib import Path

import pytest
from walk_through import walk


@pytest.mark.slow
@pytest.mark.timeout(400)  # 20 s alone, more beside other workers
def test_a_board_is_set_up_commissioned_and_controlled_by_its_own_twin(tmp_path: Path, capsys):
    assert walk(tmp_path, "python", minutes=30.0)
    shown = capsys.readouterr().out
    steps = [line.split()[2] for line in shown.splitlines() if line.startswith("$ greenhouse ")]
    assert steps == ["setup", "check-config", "bundle", "commission", "run,"]
    assert "decided by: MPC-Twin-P 60\n" in shown
    mae_k = float(shown.rpartition("MAE of the second half ")[2].split()[0])
    assert mae_k < 2.0
    assert (tmp_path / "twin.yaml.before").exists()
