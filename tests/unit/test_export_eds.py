"""`tonus export eds`: one file for each kind of device."""

from __future__ import annotations

from pathlib import Path

import canopen
from click.testing import CliRunner

from tonus.tools.cli.export import export


def test_each_kind_of_device_gets_a_file_that_python_canopen_imports(tmp_path: Path) -> None:
    out = tmp_path / "new" / "eds"
    result = CliRunner().invoke(export, ["eds", "config/can.yaml", "--out", str(out)])
    assert result.exit_code == 0, result.output
    files = sorted(out.iterdir())
    assert sorted(result.output.split()) == [str(file) for file in files]
    assert {"epos4.eds", "force_cell.eds"} <= {file.name for file in files}
    drive = canopen.import_od(str(out / "epos4.eds"), node_id=5)
    assert 0x6041 in drive
    assert 0x6041 not in canopen.import_od(str(out / "force_cell.eds"), node_id=5)
