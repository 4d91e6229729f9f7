"""State and parameters of the plant as two flat records, which the compiled kernel works on.

Both hold eight-byte words only (the switches stand last), so that views into them stay aligned.
The types are part of the kernel's compiled signature: it is compiled anew when they change here,
and once for each number of cables.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from tonus.config.schema.robot import cells_of
from tonus.sim.lab.truth import truth_fields
from tonus.sim.plant.compiled import sources

_FLOAT = "<f8"
_VECTOR = (_FLOAT, (3,))


def _fields(**groups: tuple[str, tuple[int, ...]] | str) -> list[tuple[str, str, tuple[int, ...]]]:
    return [(n, g, ()) if isinstance(g, str) else (n, g[0], g[1]) for n, g in groups.items()]


@cache
def state_dtype(cables: int) -> np.dtype[np.void]:
    """The state of a plant with so many cables."""
    per_cable, points = (_FLOAT, (cables,)), (_FLOAT, (cables, 3))
    per_cell = (_FLOAT, (cells_of(cables),))
    return np.dtype(
        [
            *(
                (name, _FLOAT, (size,) if size else ())
                for name, _, size, _, _ in truth_fields(cables)
            ),
            *_fields(
                motor_angle=per_cable,  # rad, motor side, the motor's own way positive
                motor_rate=per_cable,  # rad/s, motor side
                motor_current=per_cable,  # A, positive where the motor's own way is
                current_reference=per_cable,  # A, written by the drives, likewise
                cell_force=per_cell,  # N, what each cell shows
                cell_filtered=per_cell,  # N, behind each cell's low-pass
                slipped=per_cable,  # m, paid out by slipping on the drum
                contact_shift=_FLOAT,  # m, of the phantom along its normal
                rotor_angle=per_cable,  # rad at the drum; moves with backlash only
                rotor_rate=per_cable,  # rad/s at the drum
                relaxed=_FLOAT,  # m, how far the phantom's dashpot has given way
                foot=(_FLOAT, (8, 2)),  # m, where each corner sticks to the table
                bristle=(_FLOAT, (8, 2)),  # m, of each corner from there
                standing=(_FLOAT, (8,)),  # 1: the corner is on the table
                resting=_FLOAT,  # 1: any corner is
                # What follows is the kernel's own, valid within one call.
                rotation=(_FLOAT, (3, 3)),  # platform to base
                lever=points,  # m, r_i in the base frame
                direction=points,  # u_i
                length=per_cable,  # m, from the frame's anchor to the platform's
                elastic=per_cable,  # N, tension without the damper's share
                strain_length=per_cable,  # m, unstretched free length
                stored=per_cable,  # J, in the free cable
                teeth_torque=per_cable,  # N m, of the rotor on the drum
                teeth_energy=per_cable,  # J
                force=_VECTOR,  # N, total on the platform
                moment=_VECTOR,  # N m, total about the platform origin, base frame
                dissipation=_FLOAT,  # W, in cables, phantom and cradle
                cable_dissipation=_FLOAT,  # W, the cables' share of it
                teeth_dissipation=_FLOAT,  # W, in the gearboxes' teeth
                relaxation=_FLOAT,  # W, in the solid's dashpot
                half_velocity=_VECTOR,  # m/s, in mid-step
                half_momentum=_VECTOR,  # kg m2/s, angular, base frame, in mid-step
                half_rate=per_cable,  # rad/s, in mid-step
                half_rotor_rate=per_cable,  # rad/s, in mid-step
                drum_acceleration=per_cable,  # rad/s2, of the last kick
                rotor_acceleration=per_cable,  # rad/s2, of the last kick
                powered=("u1", (cables,)),  # power stage on
                locked=("u1", (cables,)),  # holding brake closed
                jammed=("u1", (cables,)),  # the drum cannot turn
            ),
        ]
    )


@cache
def parameters_dtype(cables: int) -> np.dtype[np.void]:
    """The parameters of a plant with so many cables."""
    per_cable, points = (_FLOAT, (cables,)), (_FLOAT, (cables, 3))
    per_cell = (_FLOAT, (cells_of(cables),))
    return np.dtype(
        _fields(
            mass=_FLOAT,
            inertia=_VECTOR,  # principal, platform frame
            gravity=_FLOAT,
            anchors=points,  # base frame
            tips=points,  # platform frame
            pulley_radius=_FLOAT,  # m, zero: the cable ends in the anchor
            axial_stiffness=per_cable,  # N: EA without tension, zero for a cable that is cut
            stiffening=per_cable,  # N of EA per N of tension
            cable_damping=per_cable,
            start_length=per_cable,  # m, unstretched free length at drum angle zero
            radius=per_cable,
            drum_inertia=per_cable,
            viscous=per_cable,
            coulomb=per_cable,  # N m at the drum
            load_friction=per_cable,  # share of the tension
            brake_torque=per_cable,  # N m at the drum (the rotor) that a closed brake holds
            stribeck=_FLOAT,  # share by which friction is higher at standstill
            stribeck_rate=per_cable,  # rad/s of the drum
            backlash=_FLOAT,  # 1: rotor and drum are two bodies; then drum's values are its own
            half_play=_FLOAT,  # rad at the drum
            rotor_inertia=per_cable,  # kg m2 at the drum
            rotor_viscous=per_cable,
            rotor_coulomb=per_cable,
            teeth_stiffness=_FLOAT,  # N m/rad at the drum
            teeth_damping=_FLOAT,
            driving_loss=per_cable,  # share of the motor's torque lost while the motor drives
            driven_loss=per_cable,  # share of it added while the cable drives
            torque_per_amp=per_cable,  # N m/A at the drum, without losses
            resistance=_FLOAT,  # ohm
            ratio=per_cable,
            sign=per_cable,  # -1 where the motor's own way lets the cable out
            current_limit=per_cable,
            current_pole=_FLOAT,  # rad/s
            cell_pole=_FLOAT,  # rad/s
            cell_gain=per_cell,
            cell_offset=per_cell,  # N
            encoder_gain=per_cable,  # 1, or 0 for one that is frozen
            encoder_offset=per_cable,  # rad at the drum
            slipping=_FLOAT,  # 1 while any cable slips off its drum
            slip_rate=per_cable,  # m/s, of cable that slips off its drum
            contact=_FLOAT,  # 1 with a phantom, else 0
            contact_point=_VECTOR,
            contact_normal=_VECTOR,
            contact_rate=_FLOAT,  # m/s, of the phantom along its normal
            contact_stiffness=_FLOAT,
            contact_damping=_FLOAT,
            relaxing_stiffness=_FLOAT,
            solid=_FLOAT,  # 1: standard linear solid, 0: Kelvin-Voigt
            relaxation_rate=_FLOAT,  # 1/s, of the solid's dashpot while pressed
            recovery_rate=_FLOAT,  # 1/s, of the surface while free
            box_half=(_FLOAT, (2,)),  # m, half the platform's length and width, platform frame
            box_ends=(_FLOAT, (2,)),  # m, its lower and upper face, platform frame
            table_height=_FLOAT,  # m, of the level table
            cradle_place=_VECTOR,  # m, where the platform lies with its corners in their cups
            cradle_radius=_FLOAT,  # m, of a cup
            cradle_depth=_FLOAT,  # m, of a cup under the table
            cradle_friction=_FLOAT,  # coefficient
            corner_stiffness=_FLOAT,  # N/m, upright, and of what sticks
            corner_damping=_FLOAT,  # N s/m, likewise
            load_direction=_VECTOR,
            load_point=_VECTOR,  # platform frame
            push_force=_VECTOR,  # N, base frame
            push_point=_VECTOR,  # platform frame
            pushed=_FLOAT,  # 1 while there is a push
            grip_stiffness=_FLOAT,  # N/m of a port that leads the platform, zero: it plays a force
            grip_damping=_FLOAT,
            grip_origin=_VECTOR,  # m, where it took hold
            opening=_FLOAT,  # share of the step before the first drift: 1/2 or 1 (kernel.advance)
            # Never read: see `tonus.sim.plant.compiled`.
            **{f"sources_{sources(Path(__file__).parent)}": _FLOAT},
        )
    )
