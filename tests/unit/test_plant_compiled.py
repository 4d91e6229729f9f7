"""What is compiled is what is written, however the sources are cut into files."""

from __future__ import annotations

from pathlib import Path

from numba import typeof
from plant_setup import plant

import tonus.sim.plant
from tonus.sim.plant.compiled import sources
from tonus.sim.plant.layout import parameters_dtype


def test_a_change_in_any_source_is_another_key_in_the_compilers_cache(tmp_path: Path) -> None:
    for name in ("kernel.py", "cables.py"):
        (tmp_path / name).write_text("a = 1\n")
    before = sources(tmp_path)
    assert sources(tmp_path) == before
    (tmp_path / "cables.py").write_text("a = 2\n")
    assert sources(tmp_path) != before


def test_the_key_of_the_present_sources_is_in_the_compiled_signature() -> None:
    digest = sources(Path(tonus.sim.plant.__file__).parent)
    assert f"sources_{digest}" in (parameters_dtype(8).names or ())
    assert digest in str(typeof(plant().parameters))
