"""State and parameters of the plant as two flat records, which the compiled kernel works on.

Both hold eight-byte words only (the switches stand last), so that views into them stay aligned.
The types are part of the kernel's compiled signature: changing them here recompiles it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tonus.config.schema.robot import CABLES
from tonus.sim.lab.truth import TRUTH_FIELDS
from tonus.sim.plant.compiled import sources

_FLOAT = "<f8"
_PER_CABLE = (_FLOAT, (CABLES,))
_VECTOR = (_FLOAT, (3,))


def _fields(**groups: tuple[str, tuple[int, ...]] | str) -> list[tuple[str, str, tuple[int, ...]]]:
    return [(n, g, ()) if isinstance(g, str) else (n, g[0], g[1]) for n, g in groups.items()]


STATE = np.dtype(
    [
        *((name, _FLOAT, (size,) if size else ()) for name, _, size, _, _ in TRUTH_FIELDS),
        *_fields(
            motor_angle=_PER_CABLE,  # rad, motor side, the motor's own way positive
            motor_rate=_PER_CABLE,  # rad/s, motor side
            motor_current=_PER_CABLE,  # A, positive where the motor's own way is
            current_reference=_PER_CABLE,  # A, written by the drives, likewise
            cell_force=(_FLOAT, (CABLES + 1,)),  # N, what each cell shows
            cell_filtered=(_FLOAT, (CABLES + 1,)),  # N, behind each cell's low-pass
            slipped=_PER_CABLE,  # m, paid out by slipping on the drum
            contact_shift=_FLOAT,  # m, of the phantom along its normal
            rotor_angle=_PER_CABLE,  # rad at the drum; moves with backlash only
            rotor_rate=_PER_CABLE,  # rad/s at the drum
            relaxed=_FLOAT,  # m, how far the phantom's dashpot has given way
            foot=(_FLOAT, (8, 2)),  # m, where each corner sticks to the table
            bristle=(_FLOAT, (8, 2)),  # m, of each corner from there
            standing=(_FLOAT, (8,)),  # 1: the corner is on the table
            resting=_FLOAT,  # 1: any corner is
            # What follows is the kernel's own, valid within one call.
            rotation=(_FLOAT, (3, 3)),  # platform to base
            lever=(_FLOAT, (CABLES, 3)),  # m, r_i in the base frame
            direction=(_FLOAT, (CABLES, 3)),  # u_i
            length=_PER_CABLE,  # m, from the frame's anchor to the platform's
            elastic=_PER_CABLE,  # N, tension without the damper's share
            strain_length=_PER_CABLE,  # m, unstretched free length
            stored=_PER_CABLE,  # J, in the free cable
            teeth_torque=_PER_CABLE,  # N m, of the rotor on the drum
            teeth_energy=_PER_CABLE,  # J
            force=_VECTOR,  # N, total on the platform
            moment=_VECTOR,  # N m, total about the platform origin, base frame
            dissipation=_FLOAT,  # W, in cables, phantom and cradle
            cable_dissipation=_FLOAT,  # W, the cables' share of it
            teeth_dissipation=_FLOAT,  # W, in the gearboxes' teeth
            relaxation=_FLOAT,  # W, in the solid's dashpot
            half_velocity=_VECTOR,  # m/s, in mid-step
            half_momentum=_VECTOR,  # kg m2/s, angular, base frame, in mid-step
            half_rate=_PER_CABLE,  # rad/s, in mid-step
            half_rotor_rate=_PER_CABLE,  # rad/s, in mid-step
            drum_acceleration=_PER_CABLE,  # rad/s2, of the last kick
            rotor_acceleration=_PER_CABLE,  # rad/s2, of the last kick
            powered=("u1", (CABLES,)),  # power stage on
            locked=("u1", (CABLES,)),  # holding brake engaged
            jammed=("u1", (CABLES,)),  # the drum cannot turn
        ),
    ]
)

PARAMETERS = np.dtype(
    _fields(
        mass=_FLOAT,
        inertia=_VECTOR,  # principal, platform frame
        gravity=_FLOAT,
        anchors=(_FLOAT, (CABLES, 3)),  # base frame
        tips=(_FLOAT, (CABLES, 3)),  # platform frame
        pulley_radius=_FLOAT,  # m, zero: the cable ends in the anchor
        axial_stiffness=_PER_CABLE,  # N: EA without tension, zero for a cable that is cut
        stiffening=_PER_CABLE,  # N of EA per N of tension
        cable_damping=_PER_CABLE,
        start_length=_PER_CABLE,  # m, unstretched free length at drum angle zero
        radius=_PER_CABLE,
        drum_inertia=_PER_CABLE,
        viscous=_PER_CABLE,
        coulomb=_PER_CABLE,  # N m at the drum
        load_friction=_PER_CABLE,  # share of the tension
        stribeck=_FLOAT,  # share by which friction is higher at standstill
        stribeck_rate=_PER_CABLE,  # rad/s of the drum
        backlash=_FLOAT,  # 1: rotor and drum are two bodies; then drum's values are its own
        half_play=_FLOAT,  # rad at the drum
        rotor_inertia=_PER_CABLE,  # kg m2 at the drum
        rotor_viscous=_PER_CABLE,
        rotor_coulomb=_PER_CABLE,
        teeth_stiffness=_FLOAT,  # N m/rad at the drum
        teeth_damping=_FLOAT,
        driving_loss=_PER_CABLE,  # share of the motor's torque lost while the motor drives
        driven_loss=_PER_CABLE,  # share of it added while the cable drives
        torque_per_amp=_PER_CABLE,  # N m/A at the drum, without losses
        resistance=_FLOAT,  # ohm
        ratio=_PER_CABLE,
        sign=_PER_CABLE,  # -1 where the motor's own way lets the cable out
        current_limit=_PER_CABLE,
        current_pole=_FLOAT,  # rad/s
        cell_pole=_FLOAT,  # rad/s
        cell_gain=(_FLOAT, (CABLES + 1,)),
        cell_offset=(_FLOAT, (CABLES + 1,)),  # N
        encoder_gain=_PER_CABLE,  # 1, or 0 for one that is frozen
        encoder_offset=_PER_CABLE,  # rad at the drum
        slipping=_FLOAT,  # 1 while any cable slips off its drum
        slip_rate=_PER_CABLE,  # m/s, of cable that slips off its drum
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
        opening=_FLOAT,  # share of the step before the first drift: 1/2, or 1 (see kernel.advance)
        # Never read: see `tonus.sim.plant.compiled`.
        **{f"sources_{sources(Path(__file__).parent)}": _FLOAT},
    )
)
