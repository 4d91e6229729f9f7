"""`tonus view`: the robot in a browser, live or from logs."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tonus.runtime.timing import clock
from tonus.tools import output
from tonus.tools.errors import ToolError

if TYPE_CHECKING:
    from tonus.tools.view.foxglove_server import FoxgloveServer
    from tonus.tools.view.live import Live
    from tonus.tools.view.playback import Playback

_APPEARS_S = 60.0


@click.command()
@click.argument("logs", nargs=-1, type=click.Path(path_type=Path))
@click.option("--operate", is_flag=True, help="Let the page command the robot, and its lab.")
@click.option("--host", default="127.0.0.1", help="Address to serve on; another needs --token.")
@click.option("--port", type=click.IntRange(0, 65535), help="Port; 0: any that is free.")
@click.option("--token", help="Serve only those who know it; at least 16 characters.")
@click.option(
    "--foxglove",
    type=click.IntRange(-1, 65535),
    is_flag=False,
    flag_value=-1,
    metavar="[PORT]",
    help="Serve the topics to Foxglove, Lichtblick and PlotJuggler too.",
)
@click.option("--run", "run_id", type=click.IntRange(min=1), hidden=True)
def view(
    logs: tuple[Path, ...],
    *,
    operate: bool,
    host: str,
    port: int | None,
    token: str | None,
    foxglove: int | None,
    run_id: int | None,
) -> None:
    """Show the running daemon in a browser, or play LOGS back, several in one picture.

    Without --operate the page shows and commands nothing. Ctrl-C ends the viewer, never the robot.
    """
    # numpy loads with a thread for each processor, which nothing here has work for.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with _uncollected():
        from tonus.tools.view.gate import Gate, is_local, new_token

    if logs and foxglove is not None:
        raise click.UsageError("--foxglove serves a running daemon; those programs open logs")
    if logs and operate:
        raise click.UsageError("a log cannot be operated: leave --operate or the log out")
    if not is_local(host) and token is None:
        raise click.UsageError(f"{host} can be reached by others: give --token too")
    if token is not None and len(token) < 16:
        raise click.UsageError("--token is too short to be a secret: give 16 characters or more")
    if operate and token is None:
        token = new_token()
    with _uncollected():
        try:
            from tonus.tools.view.viewer import Viewer
        except ModuleNotFoundError as error:
            raise ToolError(
                f"the viewer needs the package {error.name}: pip install 'tonus[view]'"
            ) from error
        live = None if logs else _live(run_id)
        playback = _playback(logs) if logs else None
        gate = Gate(host, port, token)
        server = None
        if foxglove is not None and live is not None:
            server = _foxglove(live, host, foxglove, operate=operate, token=token)
        viewer = Viewer(gate, live, playback, operate=operate, follow=run_id is None)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: viewer.close())
    if not is_local(host):
        text = "whoever has the token and can reach this host can open the page"
        click.echo(f"warning: {text}{', and command the robot' if operate else ''}", err=True)
    output.make_optional()
    click.echo(f"open {gate.address}  (Ctrl-C ends the viewer{', not the robot' if live else ''})")
    if server is not None:
        click.echo(f"Foxglove and others connect to ws://{host}:{server.port}")
    try:
        viewer.run()
    finally:
        if server is not None:
            server.close()
        viewer.release()


@contextmanager
def _uncollected() -> Iterator[None]:
    """Without the garbage collector, which takes a tenth of the time to load what draws, and finds
    nothing in it."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _live(run_id: int | None) -> Live:
    from tonus.tools.view.live import Live, newest_run

    return Live(newest_run() if run_id is None else _rings(run_id))


def _playback(logs: tuple[Path, ...]) -> Playback:
    """Imported here: a live picture does not wait for what reads logs."""
    from tonus.tools.view.playback import Playback
    from tonus.tools.view.recorded import Recorded

    return Playback([Recorded(path) for path in logs])


def _foxglove(
    live: Live, host: str, port: int, *, operate: bool, token: str | None
) -> FoxgloveServer:
    from tonus.tools.view.foxglove_server import FoxgloveServer
    from tonus.tools.view.settings import settings

    number = settings().foxglove_port if port < 0 else port
    return FoxgloveServer(live, host, number, operate=operate, token=token)


def _rings(run_id: int) -> Path:
    """Of the run of this process, which may be starting still."""
    from tonus.config.places import runtime_dir

    rings = runtime_dir() / f"run-{run_id}"
    for _ in range(int(_APPEARS_S / 0.1)):
        if (rings / "run.json").exists():
            return rings
        if not Path("/proc", str(run_id)).exists():
            break
        clock.pause(0.1)
    raise ToolError(f"{rings}: this run has not begun")
