"""Faults and places in words, for the log and for the last line a person reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tonus.runtime.safety.faults import PASSIVE
from tonus.runtime.states import Fault, StopMode

if TYPE_CHECKING:
    from tonus.config.schema.root import Config

TEXT = {
    Fault.NONE: "no fault",
    Fault.DRIVE_LOST: "the drive stopped answering",
    Fault.DRIVE_FAULT: "the drive left Operation Enabled by itself",
    Fault.CELL_LOST: "the load cell stopped answering",
    Fault.CELL_BAD: "the load cell reports a defect, or an offset beyond the tare limit",
    Fault.ENABLE_TIMEOUT: "the drive did not reach Operation Enabled in time",
    Fault.REFERENCING_FAILED: "cable lengths could not be referenced",
    Fault.CONTACT_LIMIT: "the contact force met its limit",
    Fault.SPEED_LIMIT: "the platform met its speed limit",
    Fault.WORKSPACE_LIMIT: "the platform left its workspace",
    Fault.OVER_TENSION: "the cable stayed above T_max",
    Fault.SLACK_CABLE: "the cable went slack",
    Fault.EMERGENCY_STOP: "emergency stop",
    Fault.NOT_FINITE: "a computed value was not a number",
    Fault.IMPLAUSIBLE_DRIVE: "the encoder reports a motion that no motor can make",
    Fault.IMPLAUSIBLE_CELL: "the load cell reports a force that no cable can bear",
    Fault.CABLE_TORN: "the cable is stretched and does not pull: torn, or its cell is wrong",
    Fault.LENGTH_JUMP: "the cable's length jumped: slipped on its drum, or its encoder or cell did",
    Fault.TENSION_ERROR: "the tension does not follow: drum jammed, motor weak, or cell wrong",
    Fault.LENGTH_DRIFT: "the cable's length deviates increasingly from the others",
    Fault.DRUM_TORQUE: "the drum's motion does not match its torque: motor, drum, encoder or cell",
    Fault.DRUM_STUCK: "the drum does not turn with the platform: jammed, or its encoder frozen",
    Fault.CELL_FROZEN: "the load cell repeats one reading",
    Fault.CONTROL_FAILED: "control raised an exception",
    Fault.RELAY_SILENT: "the relay of the STO inputs is silent: the supervisor could stop nothing",
    Fault.SUPERVISOR_IGNORED: "drives stayed enabled without the supervisor's heartbeat",
}
_AT_THE_CABLE = "inspect cable, drum and cell; replace what is damaged; reference again"
REMEDY = {
    Fault.NONE: "",
    Fault.DRIVE_LOST: "check the drive's power and bus cable; then reset",
    Fault.DRIVE_FAULT: "look the drive's error code up; correct the cause, then reset",
    Fault.CELL_LOST: "check the amplifier's power and bus cable; then reset",
    Fault.CELL_BAD: "reset; if found again: check the cell's wiring; tare with slack cables",
    Fault.ENABLE_TIMEOUT: "check the drive's supply, enable input and error code; then reset",
    Fault.REFERENCING_FAILED: "put the platform into its cradle, free every cable; then reset",
    Fault.CONTACT_LIMIT: "free the platform; lower the contact force or raise its limit",
    Fault.SPEED_LIMIT: "slow the scenario down; look for a disturbance in the log",
    Fault.WORKSPACE_LIMIT: "look for the load or command that led there; then reset",
    Fault.OVER_TENSION: "look for a blocked platform or a load that is too large; then reset",
    Fault.SLACK_CABLE: "inspect the cable and its guides; check pretension; then reset",
    Fault.EMERGENCY_STOP: "make the robot safe, release the switch; then reset",
    Fault.NOT_FINITE: "report it with the log; check a controller of your own",
    Fault.IMPLAUSIBLE_DRIVE: "check the encoder's cable and resolution; then reset",
    Fault.IMPLAUSIBLE_CELL: "check the cell's wiring and calibration; then reset",
    Fault.CABLE_TORN: _AT_THE_CABLE,
    Fault.LENGTH_JUMP: _AT_THE_CABLE,
    Fault.TENSION_ERROR: "turn the drum by hand; check motor, brake and cell; then reset",
    Fault.LENGTH_DRIFT: "check how the cable lies on its drum; reference again",
    Fault.DRUM_TORQUE: "turn the drum by hand; check motor, brake, encoder and cell; then reset",
    Fault.DRUM_STUCK: "free the drum or its brake; check the encoder; then reset",
    Fault.CELL_FROZEN: "check the amplifier; switch it off and on; then reset",
    Fault.CONTROL_FAILED: "read the traceback in the process's log; report it with the log",
    Fault.RELAY_SILENT: "check the supply and the cable of the relay's node; then reset",
    Fault.SUPERVISOR_IGNORED: "look in the log for why it stopped, and for another master; reset",
}
"""What a person should do, once the robot has stopped."""
STOP_TEXT = {
    StopMode.ON_PATH: "along the path and down to the cradle",
    StopMode.DESCENT: "down with the remaining cables, by weight and damping",
    StopMode.PASSIVE: "each drum by itself, with low tension and damping",
}
_OF_A_DRIVE = {
    Fault.DRIVE_LOST,
    Fault.DRIVE_FAULT,
    Fault.ENABLE_TIMEOUT,
    Fault.OVER_TENSION,
    Fault.SLACK_CABLE,
    Fault.IMPLAUSIBLE_DRIVE,
    Fault.REFERENCING_FAILED,
    Fault.CABLE_TORN,
    Fault.LENGTH_JUMP,
    Fault.TENSION_ERROR,
    Fault.LENGTH_DRIFT,
    Fault.DRUM_TORQUE,
    Fault.DRUM_STUCK,
}
_OF_A_CELL = {Fault.CELL_LOST, Fault.CELL_BAD, Fault.IMPLAUSIBLE_CELL, Fault.CELL_FROZEN}


def reaction(fault: Fault, *, armed: bool) -> str:
    """What the state machine does about it."""
    if fault is Fault.EMERGENCY_STOP:
        return "drives disabled at once"
    if not armed:
        return "stays disarmed"
    if fault is Fault.CONTROL_FAILED:
        return "passive stop, then drives disabled; the run ends"
    return "passive stop" if fault in PASSIVE else "controlled stop"


def place(config: Config, fault: Fault, where: int) -> str:
    """Channel, node and axis or cell a fault concerns; empty when it has no place."""
    if where < 0:
        return ""
    if fault in _OF_A_DRIVE:
        return axis_name(config, where)
    if fault in _OF_A_CELL:
        return cell_name(config, where)
    return ""


def describe(config: Config, fault: Fault, where: int, detail: str = "") -> str:
    """One line: where, what and why."""
    at = place(config, fault, where)
    text = f"{at}: {TEXT[fault]}" if at else TEXT[fault]
    return f"{text} ({detail})" if detail else text


def axis_name(config: Config, axis: int) -> str:
    """Channel, node and axis of a drive."""
    name = f"axis {axis}"
    place = config.fieldbus.axis_places.get(axis)
    return f"{place} ({name})" if place else name


def cell_name(config: Config, cell: int) -> str:
    """Channel, node and cell of a force sensor."""
    name = "contact cell" if cell == config.robot.contact_cell else f"cell {cell}"
    place = config.fieldbus.cell_places.get(cell)
    return f"{place} ({name})" if place else name
