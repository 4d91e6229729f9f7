"""What guards a run: the envelope, faults and their isolation, the ways to stop, the firewall."""
