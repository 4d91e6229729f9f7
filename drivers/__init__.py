"""How bytes reach devices: fieldbuses, CiA 402 axes, force cells, the optical tracker.

Control sees none of it but `ProcessImage` and the `Fieldbus` door. Device units (increments, per
mille, hundredths of a newton) live in this room only.
"""
