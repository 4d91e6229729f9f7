"""The events of the daemon and of the recorder: what each name means, and what is done about it.

Those of the drivers are in `tonus.drivers.events`, those of the firewall in its module. A fault is
an event too: its name in small letters. docs/events.md has them all.
"""

from __future__ import annotations

from tonus.drivers.events import Meaning

EVENTS: dict[str, Meaning] = {
    "state": Meaning("the state machine went from one state to another", ""),
    "operator": Meaning(
        "a command was accepted, or a scenario chosen; with the sender, where there is one", ""
    ),
    "refused": Meaning(
        "a command was refused; with the sender and the reason",
        "nothing changes",
        "read the reason; give the command again when it allows it",
    ),
    "signal": Meaning(
        "the process received SIGHUP while it serves commands",
        "nothing changes",
        "nothing; give commands with `tonus ctl`",
    ),
    "overrun": Meaning(
        "realtime.overrun_ticks ticks or more were missed in a row, and realtime.overrun asks for "
        "a reaction in this state",
        "the platform holds or stops, as realtime.overrun says",
        "find what takes the time: `tonus doctor`, docs/timing.md",
    ),
    "stop_mode": Meaning(
        "the mode of the controlled stop: on_path, descent or passive",
        "the stop goes on in this mode, and never returns to an earlier one (docs/stop.md)",
        "wait for the end of the stop; look for the fault before it",
    ),
    "envelope": Meaning(
        "the level of the Dynamic Safety Envelope: green, amber (a bound is near), red (a bound is "
        "met)",
        "amber: stiffness or speed comes down; red: a fault follows",
        "amber: slow the scenario down or take load off; red: look for the fault that follows",
    ),
    "wrench_deficit": Meaning(
        "the cables miss the commanded wrench by more than distribution.deficit_limit",
        "they deliver the nearest wrench that they can",
        "lower the load or the acceleration, or move towards the middle of the workspace",
    ),
    "cable_slack": Meaning(
        "a cable does not pull while all are tensioned for referencing",
        "the others wait at tension.slack for it, sequence.take_up_s at most",
        "nothing, where it is being wound up; else look whether it has torn or is caught",
    ),
    "drums_unobserved": Meaning(
        "ticks were missed, or samples of a drive late or of uncertain time, throughout "
        "isolation.unobserved_s",
        "the run continues; a drum that jams or slips is found by its length and tension alone",
        "as for missed ticks or late samples: `tonus doctor`, then the bus's events before it",
    ),
    "tuned": Meaning(
        "an operator changed a parameter of operation.tunable; the event says who, from what, to "
        "what",
        "the value in force goes there at its rate",
    ),
    "drums_observed": Meaning(
        "the samples of every drive are on time again", "torque and motion are compared again"
    ),
    "brake_slipped": Meaning(
        "a drum turned while its drive was off and its holding brake closed",
        "arming is refused until the daemon is started again",
        "support the platform, then repair the brake (docs/sto.md)",
    ),
    "tracker_lost": Meaning(
        "no usable tracker pose for tracker.maximum_age_ms",
        "the pose estimate uses the cables alone; arming is refused",
        "look at the tracker's view, its network and tracker.port",
    ),
    "tracker_back": Meaning("tracker poses are used again", ""),
    "tracker_learnt": Meaning(
        "estimator.refused_poses poses in a row were refused and agree with each other",
        "the estimate trusts the cable lengths less, and follows the tracker",
        "check that the tracker's frame was not moved; reference the cables again",
    ),
    "pose_cables": Meaning(
        "the cable lengths contradict each other or the motion: a slack or slipped cable, "
        "or a wrong parameter",
        "the pose estimate goes on; a fault follows if one cable stands out, and a passive stop if "
        "none does and the lengths drift on",
        "look for a slack or slipped cable; reference again; check drum radii and frame points",
    ),
    "pose_tracker": Meaning(
        "consecutive tracker poses are far from the estimate",
        "these poses are not used",
        "look for reflections and hidden markers; check the tracker's calibration",
    ),
    "pose_singular": Meaning(
        "the cables hardly determine the pose (singular structure matrix)",
        "the pose estimate goes on",
        "keep the scenario away from that pose (`tonus workspace`)",
    ),
    "pose_good": Meaning("lengths, tensions and tracker agree again", ""),
    "keyframe_left_out": Meaning(
        "the controller's state is larger than a keyframe may be",
        "a replay begins at an earlier keyframe or at the first tick",
        "keep less in the controller's state",
    ),
    "recording_stopped": Meaning(
        "the recorder cannot write, for example because the disk is full",
        "control goes on; the ring keeps the newest records",
        "free space on the disk, or correct the folder's permissions",
    ),
    "recording_resumed": Meaning(
        "the recorder writes again, in another file; with the number of missing cycles", ""
    ),
    "records_lost": Meaning(
        "the ring overwrote records before the recorder read them",
        "counted; control goes on",
        "find what keeps the recorder from the disk or the processor (`tonus doctor`)",
    ),
    "log_deleted": Meaning(
        "an old log file was deleted",
        "as recording.keep_files says",
        "nothing, or raise recording.keep_files; keep what matters elsewhere",
    ),
    "recorder_restarted": Meaning(
        "the recorder died and was started again",
        "it writes another file from what the ring holds",
        "look for its reason in the process's log; the host may be out of memory",
    ),
    "recorder_lost": Meaning(
        "the recorder and its keeper died; later their rings were recorded",
        "the file holds what was in the rings",
        "look for who killed them; the host may be out of memory",
    ),
    "daemon_lost": Meaning(
        "the daemon ended without closing the log",
        "the recorder completes the file; the drives' heartbeat consumers stop the robot",
        "look for its reason in the process's log; start it again when the robot has stopped",
    ),
}
"""Every name that `tonus.runtime` and `tonus.tools` write into a log."""
