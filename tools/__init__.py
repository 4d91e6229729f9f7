"""The `tonus` command line, logs and reports; the only room that may use all others."""

import os

# One thread for linear algebra, set before numpy is first imported: a second busy thread in the
# daemon would move its wake-ups from 0.05 ms to milliseconds, and matrices of 6 x 8 gain nothing.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
