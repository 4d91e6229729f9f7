"""The emulated EPOS4: its object dictionary, its errors, and the drive behind them."""
