"""What the loops say to the compiler, where they run as they are written and Cython is not installed."""

from contextlib import nullcontext

compiled = False
nogil = nullcontext()
