"""Where speed claims come from: ratios within one run. `make bench` prints the table and writes
bench.json."""
