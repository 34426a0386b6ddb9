"""Experiments and the command line."""

import os

# Before numpy is loaded: OpenBLAS starts threads for products of some 100 x 100 numbers, and waiting for them costs
# milliseconds where the processors are busy. Matrices of a tick are too small to gain from them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
