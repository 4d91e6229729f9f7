"""What a person does about a fault, in a line; docs/fmea.md tells how each is detected."""

from __future__ import annotations

from tonus.runtime.states import Fault

REMEDY: dict[Fault, str] = {
    Fault.NONE: "",
    Fault.DRIVE_LOST: "check the drive's supply, cable and node number; then reset",
    Fault.DRIVE_FAULT: "read the drive's error code in the events, correct its cause; then reset",
    Fault.CELL_LOST: "check the load cell's supply, cable and node number; then reset",
    Fault.CELL_BAD: "check the cell's wiring, and that its cable is slack at rest; then reset",
    Fault.ENABLE_TIMEOUT: "check the drive's power and its STO input; then reset",
    Fault.REFERENCING_FAILED: (
        "lay the platform into its cradle, free the cables, let the tracker see it; then reset"
    ),
    Fault.CONTACT_LIMIT: "take away what the platform pressed against; then reset",
    Fault.SPEED_LIMIT: "look for what pushed the platform, or play a slower scenario; then reset",
    Fault.WORKSPACE_LIMIT: "look for what moved the platform out of its box; then reset",
    Fault.OVER_TENSION: "free the cable or the platform if it is caught; then reset",
    Fault.SLACK_CABLE: "check that the cable runs over its drum; then reset",
    Fault.EMERGENCY_STOP: "see that no person is in danger; then reset",
    Fault.NOT_FINITE: "keep the log: it is a defect of Tonus or of your controller; then reset",
    Fault.IMPLAUSIBLE_DRIVE: "check the encoder and its cable; then reset",
    Fault.IMPLAUSIBLE_CELL: "check the load cell and its amplifier; then reset",
    Fault.CABLE_TORN: "inspect the cable and replace it, or check its load cell; then reset",
    Fault.LENGTH_JUMP: "check how the cable lies on its drum, and the encoder; then reset",
    Fault.TENSION_ERROR: "with power off turn the drum by hand; check motor and cell; then reset",
    Fault.LENGTH_DRIFT: "check how the cable lies on its drum, and its encoder; then reset",
    Fault.CELL_FROZEN: "restart the load cell's amplifier; then reset",
    Fault.CONTROL_FAILED: "keep the log: it holds the exception; start the daemon again",
    Fault.DRUM_TORQUE: "turn the drum by hand with the power off; check motor, encoder and cell",
    Fault.DRUM_STUCK: "free the drum, or check its encoder; then reset",
}
"""Of every fault."""
