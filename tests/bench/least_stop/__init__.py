"""The least that physics allows after a torn cable: optimal stops, computed offline.

`make least-stop` solves every case and writes config/least_stop.yaml; docs/least_stop.md says how.
"""
