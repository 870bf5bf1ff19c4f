"""bench/mutants.py on a small tree of its own: one function whose test watches half of it."""

import subprocess
from pathlib import Path

import pytest

from bench import __main__ as bench
from bench.mutants import bench_package, draw, importing_tests, module_files, mutants_of

LEVEL = '''"""A tank."""


def is_full(level: float, limit: float = 0.5) -> bool:
    """Müßig text before the code: columns count bytes."""
    return bool("ß" and level >= limit)


def spare(level, left=1.0):
    return max(0.0, left - level)
'''
WATCHES_IS_FULL = """from box.level import is_full


def test_the_edge():
    assert is_full(0.5) and not is_full(0.4999) and not is_full(0.6, 0.7)
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name, text in {
        "box/__init__.py": "",
        "box/level.py": LEVEL,
        "tests/test_level.py": WATCHES_IS_FULL,
        "tests/helper.py": "import box\n",
        "tests/test_other.py": "from tests.helper import box\n\ndef test_it(): pass\n",
        "tests/test_alone.py": "import json\n\ndef test_it(): pass\n",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    subprocess.run(["git", "init", "-q", "."], cwd=tmp_path, check=True)
    return tmp_path


def test_each_change_is_made_in_its_place_and_the_rest_stays(tree):
    found = {(mutant.kind, mutant.line): mutant.text for mutant in mutants_of(Path("box/level.py"), tree)}
    assert "return bool(('ß' or level >= limit))" in found["boolean", 6]
    assert 'return bool("ß" and (level < limit))' in found["comparison", 6]
    assert "limit: float = 0.25)" in found["keyword default", 4]
    assert "left + level" in found["arithmetic", 10]
    for text in found.values():
        changed = [new for old, new in zip(LEVEL.splitlines(), text.splitlines(), strict=True) if old != new]
        assert len(changed) == 1


def test_max_is_turned_round_and_reduced_to_each_of_its_parts(tree):
    texts = [mutant.text for mutant in mutants_of(Path("box/level.py"), tree) if mutant.kind == "min/max"]
    last = {text.splitlines()[-1].strip() for text in texts}
    assert last == {"return min(0.0, left - level)", "return 0.0", "return (left - level)"}


def test_the_tests_are_those_that_import_the_package_also_through_a_helper(tree):
    assert [path.name for path in importing_tests("box", tree)] == ["test_level.py", "test_other.py"]


def test_the_same_seed_draws_the_same_changes_and_another_does_not(tree):
    possible, first = draw("box", 1, 5, tree)
    assert len(first) == 5 < possible
    assert draw("box", 1, 5, tree)[1] == first != draw("box", 2, 5, tree)[1]


def test_the_survivors_are_the_changes_of_what_no_test_watches_and_the_tree_stays_as_it_is(tree):
    drawn = draw("box", 1, 8, tree)[1]
    lines = list(bench_package("box", 1, 8, 60.0, tree))
    places = [line.split()[1] for line in lines if line.startswith("  survives")]
    assert places == [f"box/level.py:{mutant.line}" for mutant in drawn if mutant.line > 6]
    assert lines[-1].split() == ["all", str(8 - len(places)), "0", str(len(places))]
    assert 0 < len(places) < 8
    assert (tree / "box/level.py").read_text(encoding="utf-8") == LEVEL


def test_tests_that_fail_without_a_change_end_the_bench(tree):
    (tree / "tests/test_level.py").write_text("import box\n\ndef test_it(): assert False\n")
    with pytest.raises(RuntimeError, match="fail without a change"):
        list(bench_package("box", 1, 1, 60.0, tree))


def test_a_package_that_is_missing_is_named():
    with pytest.raises(ValueError, match=r"edge\.nothing"):
        module_files("edge.nothing", Path(bench.__file__).parents[1])


def test_a_bench_takes_options_of_its_own(capfd):
    assert bench.main(["mutants", "edge.nothing", "--seed", "3"]) == 1
    assert "there is no package or module 'edge.nothing'" in capfd.readouterr().err
