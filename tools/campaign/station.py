"""A robot brought up once, from which episodes start: each is a fork of the process.

In virtual time daemon, lab and buses are one process on one loop, so that a fork is a copy of all
of them. The child takes up its episode and plays it to the end, while the station waits; what it
comes to is one line of JSON in a pipe. A child that crashes or hangs is a row as well.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable

from tonus.config.schema.campaign import Study
from tonus.runtime.timing import clock
from tonus.tools.campaign.allowance import Allowance, for_torn_cables
from tonus.tools.campaign.episode import Episode, Group
from tonus.tools.campaign.judge import Row, failed, row_of
from tonus.tools.campaign.play import Playing, describe
from tonus.tools.forked_work import crashed
from tonus.tools.forking import die_with_parent

_AHEAD_S = 0.003
"""so long before an episode's first event it is forked; buses and devices work ahead of a tick"""
_PATIENCE = 60
"""s of wall time to one of processor time"""
Tell = Callable[[Row], None]


def play_group(
    group: Group, study: Study, tell: Tell, allowance: Allowance = for_torn_cables
) -> None:
    """Bring the robot up and play each episode in a fork of its own. ``tell`` is called once for
    each, in the child or, where that died, here; every episode has its row in the end."""
    station = _Station(group, study, tell)
    setup, times = group.episodes[0].setup, study.times
    try:
        playing = Playing(
            setup.settle(),
            group.undisturbed,
            setup.seed,
            tail=times.tail,
            longest=times.longest,
            turn=station.before_tick,
        )
        watch(times.hang)
        seen = playing.run(study.named)
        error = seen.error or "the undisturbed run ended before the episode began"
    except Exception as caught:  # noqa: BLE001 - a setup that cannot be played is a finding
        error = describe(caught)
    if station.child is not None:
        replayed = station.child.index % study.replayed == 0
        tell(row_of(station.child, seen, replayed=replayed, allowance=allowance))
        os._exit(0)
    watch(0)
    station.give_up(error)


def watch(seconds: int) -> None:
    """From now on a signal ends this process when it has used so much processor time, on a busy
    host as on an idle one; or, if it waits for something that never comes, after much longer."""
    for number in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(seconds * _PATIENCE if seconds else 0)


class _Over(Exception):  # noqa: N818 - nothing is wrong: every episode has been forked
    pass


class _Station:
    def __init__(self, group: Group, study: Study, tell: Tell) -> None:
        self._study, self._tell = study, tell
        self._period = group.episodes[0].setup.settle().control.rates.period
        self._left = sorted(group.episodes, key=lambda each: -(each.begins or 0.0))
        self.child: Episode | None = None
        """in a child: the episode it plays"""

    def before_tick(self, playing: Playing) -> None:
        if self.child is not None:
            return
        while self._left and self._is_due(self._left[-1], playing):
            episode = self._left.pop()
            watch(0)
            if self._fork(episode):
                playing.take_up(episode.scenario)
                return
            watch(self._study.times.hang)
        if not self._left:
            raise _Over

    def _is_due(self, episode: Episode, playing: Playing) -> bool:
        """Whether the next tick is the last one before its first event."""
        lab = playing.lab
        if lab is None or lab.script_start_ns is None:
            return False
        ahead = (playing.script.armed_for + 1) * self._period + _AHEAD_S
        return ahead >= (episode.begins or 0.0)

    def _fork(self, episode: Episode) -> bool:
        """Whether this is the child. The parent waits for it."""
        sys.stdout.flush()
        sys.stderr.flush()
        process = clock.fork()
        if process == 0:
            die_with_parent()
            watch(self._study.times.hang)
            self.child, self._left = episode, []
            return True
        _, status = os.waitpid(process, 0)
        ended = os.waitstatus_to_exitcode(status)
        if ended != 0:
            self._tell(failed(episode, "exception", cause(ended, self._study.times.hang)))
        return False

    def give_up(self, error: str) -> None:
        """No episode that is left can be played."""
        for episode in reversed(self._left):
            self._tell(failed(episode, "exception", error))


def cause(exit_code: int, hang: int) -> str:
    """Why a process ended without a row."""
    if exit_code in (-signal.SIGPROF, -signal.SIGALRM):
        return f"hung: no end in {hang} s of processor time"
    return crashed(exit_code)
