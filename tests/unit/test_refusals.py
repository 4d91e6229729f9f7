"""Wrong input, closed outputs and missing rights over every command: one line, the documented code,
and nothing that was recorded is lost."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

import pytest
from synthetic_run import record

from tonus.tools.cli.main import COMMANDS, main
from tonus.tools.run import ring_directory as ring_directory_module

LOG, CUT, TEXT, FIFO, DENIED, FILE = "LOG", "CUT", "TEXT", "FIFO", "/dev/null/x", "FILE"
"""placeholders: a whole log, one that is cut, a text, a pipe, a place for nobody, a plain file"""

CASES: tuple[tuple[str, int, str], ...] = (
    # what is typed, exit code, words of the line
    ("nonsense", 2, "No such command"),
    ("verfy", 2, "did you mean verify?"),
    ("--nonsense", 2, "No such option"),
    ("run", 2, "Missing argument"),
    ("run nope.yaml", 2, "no such file"),
    ("run .", 2, "is a directory"),
    ("run TEXT --virtual", 2, "TEXT"),
    ("run LOG --virtual", 2, "UTF-8"),
    ("run config/direct.yaml --virtual --out FILE", 2, "is no folder; choose another with --out"),
    ("run config/direct.yaml --virtual --out FILE/x", 2, "is no folder; choose another"),
    ("run config/direct.yaml --virtual --duration nan", 2, "no finite number"),
    ("run config/direct.yaml --virtual --duration inf", 2, "no finite number"),
    ("run config/direct.yaml --virtual --duration -1", 2, "not in the range"),
    ("run config/direct.yaml --virtual --duration soon", 2, "not a valid float"),
    ("run config/direct.yaml --virtual --seed -3", 2, "not in the range"),
    ("run config/direct.yaml --virtual --seed x", 2, "not a valid integer"),
    ("run config/direct.yaml --virtual --controller x", 2, "'bio'"),
    ("run config/direct.yaml --virtual --scenario x", 2, "choose one of"),
    ("run config/direct.yaml --virtual --scenario TEXT", 2, "TEXT"),
    ("run config/direct.yaml --virtual --serve --or-virtual", 2, "--serve or --json"),
    ("run config/can.yaml --set tracker.address=192.0.2.1", 2, "tracker.address: 192.0.2.1 is not"),
    ("check", 2, "Missing argument"),
    ("check config/can.yaml --set tracker.address=999.1.1.1", 2, "nor a host name; write one, as"),
    ("check nope", 2, "no such file"),
    ("check TEXT", 2, "TEXT"),
    ("check config/tracker.yaml", 2, "its part tracker; name the file that has tracker: !include"),
    ("check config/scenarios/hold.yaml", 2, "there is no such file"),
    ("check /dev/null", 2, "is a device or a pipe, not a file; choose one of config/"),
    ("check FIFO", 2, "is a device or a pipe, not a file; choose one of config/"),
    ("check config/direct.yaml --scenario /dev", 2, "'/dev' is a directory"),
    ("check config/direct.yaml --scenario nope", 2, "choose one of"),
    ("lab nope.yaml", 2, "no such file"),
    ("lab config/robot.yaml", 2, "no lab: section"),
    ("lab config/can.yaml --nodes can9", 2, "can9"),
    ("ctl", 2, ""),
    ("ctl dance", 2, "No such command"),
    ("ctl status", 2, "tonus run CONFIG --serve"),
    ("ctl arm", 2, "tonus run CONFIG --serve"),
    ("ctl status --socket FILE", 2, "FILE"),
    ("ctl watch --rate nan", 2, "no finite number"),
    ("ctl watch --count 0", 2, "not in the range"),
    ("fault get", 2, "start one with"),
    ("fault dance", 2, "No such command"),
    ("fault unplug --channel can0", 2, "--node"),
    ("view", 2, "start one with"),
    ("view nope.mcap", 2, "nope.mcap"),
    ("view TEXT", 2, "TEXT"),
    ("view LOG", 2, "is not one that this version reads"),
    ("view LOG --operate", 2, "cannot be operated"),
    ("view LOG --foxglove 8765", 2, "open logs"),
    ("view --host 0.0.0.0", 2, "--token"),
    ("view --token short", 2, "16 characters"),
    ("view --run 4194304", 2, "has not begun"),
    ("verify", 2, "Missing argument"),
    ("verify nope.yaml", 2, "choose one of"),
    ("verify acceptance --config nope.yaml", 2, "no such file"),
    ("new", 2, "Missing argument"),
    ("new out --like nope.yaml", 2, "no such file"),
    ("doctor nope.yaml", 2, "no such file"),
    ("doctor --seconds nan", 2, "no finite number"),
    ("doctor --seconds 0", 2, "not in the range"),
    ("workspace nope.yaml", 2, "no such file"),
    ("workspace config/can.yaml --force inf", 2, "no finite number"),
    ("workspace config/can.yaml --grid 1000", 2, "not in the range"),
    ("workspace config/can.yaml --out /dev/null/x", 2, "--out"),
    ("tune nothing", 2, "nothing to tune"),
    ("tune pid --config config/can.yaml", 2, "direct"),
    ("tune pid --tuning nope.yaml", 2, "nope.yaml"),
    ("tune pid --out /dev/null/x/y.yaml", 2, "choose another"),
    ("paper nope.yaml", 2, "no such file"),
    ("paper --controllers x", 2, "no x in the protocol"),
    ("paper --stages 4", 2, "1,2,3"),
    ("paper --tuned nope.yaml", 2, "nope.yaml"),
    ("paper --tuned TEXT", 2, "tonus tune"),
    ("campaign nothing", 2, "nothing"),
    ("campaign faults --episodes 0", 2, "not in the range"),
    ("campaign faults --bus x", 2, "is not one of"),
    ("campaign faults --episodes 1 --out /dev/null/x", 2, "--out"),
    ("log", 2, ""),
    ("log nonsense LOG", 2, "No such command"),
    ("log inof LOG", 2, "did you mean info?"),
    ("log info", 2, "Missing argument"),
    ("log info nope.mcap", 2, "no such file"),
    ("log info TEXT", 2, "is not an MCAP file"),
    ("log info FIFO", 2, "is a pipe"),
    ("log info /dev/null", 2, "is empty"),
    ("log info .", 2, "is a directory; name a log that"),
    ("log info RUN", 2, "/LOG/run.mcap"),
    ("log report RUN", 2, "/LOG/run.mcap"),
    ("view RUN", 2, "/LOG/run.mcap"),
    ("log report TEXT", 2, "is not an MCAP file"),
    ("log report LOG --out /dev/null/x", 2, "/dev/null/x"),
    ("log compare TEXT", 2, "is not an MCAP file"),
    ("log compare LOG", 2, "LOG"),
    ("log timing nope.mcap", 2, "no such file"),
    ("log timing LOG --budget nope", 2, "choose one of"),
    ("log replay LOG", 2, "LOG"),
    ("log replay FIFO", 2, "is a pipe"),
    ("log recover TEXT", 2, "is not an MCAP file"),
    ("log recover CUT --out LOG", 2, "exists already"),
    ("log recover CUT --out /dev/null/x", 2, "--out"),
    ("log export LOG", 2, "Missing option"),
    ("log export LOG --format xls", 2, "is not one of"),
    ("log export LOG --format csv --topics /no", 2, "there is no topic"),
    ("log export LOG --format csv --from 5 --to 1", 2, "ends before it begins"),
    ("log export LOG --format csv --from nan", 2, "is not a time"),
    ("log export LOG --format csv --from 1000", 2, "holds no message"),
    ("log export LOG --format csv --out /dev/null/x", 2, "--out"),
    ("log identify LOG --anchor-sigma nan", 2, "no finite number"),
    ("log identify TEXT", 2, "is not an MCAP file"),
    ("log layout nonsense", 2, "is not one of"),
    ("log layout foxglove --out /dev/null/x", 2, "--out"),
    ("log layout foxglove --out /dev/full", 2, "No space left"),
    ("export dbc nope.yaml", 2, "no such file"),
    ("export dbc config/can.yaml --out /dev/full", 2, "No space left"),
    ("export dbc config/can.yaml --channel x", 2, "choose one of can0"),
    ("export eds config/direct.yaml", 2, "is direct"),
    ("export eds config/can.yaml --out FILE", 2, "FILE"),
    ("export esi config/can.yaml", 2, "no slaves"),
    ("init", 2, "Missing argument"),
    ("init FILE", 2, "FILE"),
    ("init /dev/null/x", 2, "choose another folder"),
    ("init new --like nope.yaml", 2, "no such file"),
)


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("given")
    log = record(folder / "LOG", 400)
    cut = folder / "CUT.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    (folder / "TEXT.yaml").write_text("not: [a configuration\n")
    (folder / "FILE").write_text("a file")
    os.mkfifo(folder / "FIFO")
    names = {"RUN": log.parent, "LOG": log, "CUT": cut, "TEXT": folder / "TEXT.yaml"}
    return {key: str(path) for key, path in names.items()} | {
        key: str(folder / key) for key in ("FILE", "FIFO")
    }


def contents(given: dict[str, str]) -> dict[str, str]:
    """Of all that was there before, the pipe left out."""
    files = [file for file in Path(given["FILE"]).parent.rglob("*") if file.is_file()]
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.mark.parametrize(("typed", "code", "words"), CASES, ids=[case[0] for case in CASES])
def test_it_ends_in_one_line_and_the_documented_code(
    typed: str,
    code: int,
    words: str,
    given: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("TONUS_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.chdir(tmp_path)
    before = contents(given)
    arguments = [
        "/".join([given.get(name, name) for name in word.split("/")]) for word in typed.split()
    ]
    monkeypatch.setattr(sys, "argv", ["tonus", *arguments])
    with pytest.raises(SystemExit) as ending:
        main()
    said = capsys.readouterr()
    assert ending.value.code == code, said.err
    lines = said.err.strip().splitlines()
    if words:
        assert len(lines) == 1, said.err
        assert lines[0].startswith("tonus: ")
        assert words in lines[0] or given.get(words, "\0") in lines[0]
    assert "Traceback" not in said.err + said.out
    assert contents(given) == before, "what was recorded is as it was"
    assert not (tmp_path / "out").exists(), "a refusal writes nothing"


def test_there_are_sixty_and_no_command_is_left_out() -> None:
    assert len(CASES) >= 60
    assert {typed.split()[0] for typed, *_ in CASES} >= set(COMMANDS)


def test_an_error_of_the_operating_system_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Wherever in a command it comes from: nobody wrote a sentence for this one."""

    def refuse(*_: object) -> Path:
        raise PermissionError(13, "Permission denied", "/some/where")

    monkeypatch.setattr(ring_directory_module, "runtime_dir", refuse)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["tonus", "run", "config/direct.yaml", "--virtual"])
    with pytest.raises(SystemExit) as ending:
        main()
    assert ending.value.code == 2
    said = capsys.readouterr().err.strip().splitlines()
    (line,) = [line for line in said if not line.startswith("compiling")]  # a first run compiles
    assert line.startswith("tonus: /some/where: permission denied;")
