"""A few mutants of every format of other tools; ``benchmarks/fuzz.py`` runs any number of them."""

from pathlib import Path

import fuzz
import pytest
from common.fuzz_sources import make_sources


@pytest.mark.filterwarnings("ignore")
def test_mutants_load_or_raise_an_error_of_the_package(tmp_path: Path) -> None:
    sources = make_sources(tmp_path)
    assert len(sources) == 26
    for entry in sources:
        entry[2]()  # the file is valid
        assert fuzz.attack(fuzz.Format(*entry), mutants=15, first=0, seed=1)["violations"] == 0, entry[0]
