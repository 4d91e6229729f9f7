"""A CANopen node round an emulated device (CiA 301), and its data sheet (CiA 306)."""
