"""The list of faults fits the tree: a fault that no longer applies proves nothing of the tests."""

import ast

from benchmarks.common import ROOT
from benchmarks.mutations.faults import MUTATIONS


def test_every_fault_applies_once_and_leaves_code() -> None:
    assert len({each.name for each in MUTATIONS}) == len(MUTATIONS) == 47
    for each in MUTATIONS:
        text = (ROOT / "src" / "lobewise" / each.file).read_text()
        assert text.count(each.old) == 1, f"{each.name}: {each.file} holds its text {text.count(each.old)} times"
        ast.parse(text.replace(each.old, each.new))
        assert each.old != each.new
        missing = [name for name in each.tests if not (ROOT / "tests" / name).exists()]
        assert not missing, f"{each.name}: no tests {missing}"
